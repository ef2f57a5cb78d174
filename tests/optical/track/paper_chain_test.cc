#include "server/optical/track/paper_chain.h"

#include <gtest/gtest.h>

#include <stdexcept>

#include "ring_rig.h"

namespace secondskin::server {
namespace {

const Eigen::Vector3d kPlace(0.2, -0.3, 1.1);

ProjectorFrame still_frame(const ProjectorRig& rig, std::uint64_t cycle) {
  std::mt19937 random(static_cast<unsigned>(cycle));
  ProjectorFrame frame(1, 16);
  read_values(
      rig, [](double) { return kPlace; }, cycle, 0.3, random, 0, sees_front, frame);
  return frame;
}

TEST(PaperChain, WaitsForFourFramesOfTheFuture) {  // 2.3: approximately 64 ms at 62.5 Hz
  const ProjectorRig rig = ring_rig();
  EXPECT_EQ(PaperChain(rig, 1).delay_frames(), 4U);
  EXPECT_EQ(PaperChain(rig, 1, {.value_filter = std::nullopt}).delay_frames(), 3U);
  EXPECT_EQ(PaperChain(rig, 1, {.smoother = std::nullopt}).delay_frames(), 1U);
  EXPECT_EQ(
      PaperChain(rig, 1, {.value_filter = std::nullopt, .smoother = std::nullopt}).delay_frames(),
      0U);
}

TEST(PaperChain, FindsAStillDetectorWithAnyStageOff) {
  const ProjectorRig rig = ring_rig();
  for (int off = 0; off < 8; ++off) {
    PaperChainOptions options;
    if ((off & 1) != 0) options.value_filter.reset();
    if ((off & 2) != 0) options.row_removal = false;
    if ((off & 4) != 0) options.smoother.reset();
    PaperChain chain(rig, 1, options);
    MarkerFrame out(1);
    for (std::uint64_t k = 0; k < 30; ++k) {
      chain.update(still_frame(rig, k), out);
      EXPECT_EQ(out.visible[0], k >= chain.delay_frames() ? 1 : 0) << off << " " << k;
      if (out.visible[0] != 0) {
        EXPECT_LT((out.p_WM[0] - kPlace).norm(), 0.02) << off << " " << k;
        EXPECT_GE(out.residual[0], 0.0F);
      }
    }
  }
}

TEST(PaperChain, OutputBelongsToTheFrameDelayFramesBefore) {
  const ProjectorRig rig = ring_rig();
  const auto path = [](double t) { return Eigen::Vector3d(0.5 * t - 0.3, 0.1, 1.0); };
  PaperChain chain(rig, 1);
  std::mt19937 random(4);
  ProjectorFrame frame(1, 16);
  MarkerFrame out;
  double sum = 0.0;
  int n = 0;
  for (std::uint64_t k = 0; k < 60; ++k) {
    read_values(rig, path, k, 0.0, random, 0, sees_all, frame);
    chain.update(frame, out);
    if (k < 20) continue;
    sum += out.p_WM[0].x() - path((static_cast<double>(k) - 4.0 + 0.5) * 0.016).x();
    ++n;
  }
  EXPECT_NEAR(sum / n, 0.0, 0.003);  // a frame is 8 mm
}

TEST(PaperChain, TakesAWildValueOut) {
  const ProjectorRig rig = ring_rig();
  PaperChain chain(rig, 1, {.value_filter = std::nullopt, .smoother = std::nullopt});
  MarkerFrame out;
  ProjectorFrame frame = still_frame(rig, 0);
  frame.values[1] = static_cast<std::uint8_t>(frame.values[1] / 3);
  chain.update(frame, out);
  ASSERT_EQ(out.visible[0], 1);
  EXPECT_LT((out.p_WM[0] - kPlace).norm(), 0.03);
}

TEST(PaperChain, CountsLostCyclesAndFramesOfAnotherSizeAsEmpty) {
  const ProjectorRig rig = ring_rig();
  PaperChain chain(rig, 1);
  MarkerFrame out;
  for (std::uint64_t k = 0; k < 20; ++k) chain.update(still_frame(rig, k), out);
  ASSERT_EQ(out.visible[0], 1);
  chain.update(still_frame(rig, 24), out);  // the point of cycle 20, which was lost
  EXPECT_EQ(out.visible[0], 0);
  for (std::uint64_t k = 25; k < 40; ++k) chain.update(still_frame(rig, k), out);
  ASSERT_EQ(out.visible[0], 1);
  ProjectorFrame other(2, 3);
  for (std::uint64_t k = 40; k < 45; ++k) {
    other.cycle = k;
    chain.update(other, out);
  }
  EXPECT_EQ(out.visible[0], 0);
  ASSERT_EQ(out.p_WM.size(), 1U);
}

TEST(PaperChain, BeginsAnewWhenTheCyclesDo) {
  const ProjectorRig rig = ring_rig();
  PaperChain chain(rig, 1);
  MarkerFrame out;
  for (std::uint64_t k = 100; k < 120; ++k) chain.update(still_frame(rig, k), out);
  ASSERT_EQ(out.visible[0], 1);
  for (std::uint64_t k = 0; k < 4; ++k) {
    chain.update(still_frame(rig, k), out);
    EXPECT_EQ(out.visible[0], 0) << k;
  }
  chain.update(still_frame(rig, 4), out);
  EXPECT_EQ(out.visible[0], 1);
}

TEST(PaperChain, RefusesOptionsOutOfRange) {
  EXPECT_THROW(PaperChain(ring_rig(), 1, {.variance_limit = 0.0}), std::invalid_argument);
}

}  // namespace
}  // namespace secondskin::server
