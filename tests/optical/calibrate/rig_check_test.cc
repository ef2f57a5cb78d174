#include "server/optical/calibrate/rig_check.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <random>
#include <stdexcept>

#include "tests/optical/calibrate/synthetic.h"

namespace secondskin::server {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;

// Six detectors on a rigid frame, no two distances alike.
const std::vector<Eigen::Vector3d> kFrame{{0.0, 0.0, 0.0},   {0.5, 0.0, 0.0},  {0.0, 0.35, 0.1},
                                          {0.3, 0.45, 0.25}, {0.1, 0.1, 0.42}, {0.45, 0.3, -0.2}};

ProjectorRig as_rig(const std::vector<Projector>& projectors) {
  ProjectorRig rig;
  for (const Projector& p : projectors) rig.projectors.emplace_back(p);
  return rig;
}

std::vector<KnownDistance> distances(const std::vector<Eigen::Vector3d>& places) {
  std::vector<KnownDistance> out;
  for (std::size_t a = 0; a < places.size(); ++a) {
    for (std::size_t b = a + 1; b < places.size(); ++b) {
      out.push_back({a, b, (places[a] - places[b]).norm()});
    }
  }
  return out;
}

std::optional<RigReport> check(const ProjectorRig& rig, const std::vector<Projector>& truth,
                               const std::vector<KnownDistance>& known = {}) {
  RigCheck check(rig, kFrame.size(), known);
  const test::WavedWand body(kFrame);
  std::mt19937 random(3);
  for (std::uint64_t k = 200; k < 900; ++k) {
    check.add(
        test::wave_cycle(truth, body, k, 0.016 * static_cast<double>(k), {0.5, 0.02}, random));
  }
  return check.report();
}

TEST(RigCheck, FindsNothingWhereAllIsWell) {
  const auto truth = test::make_rig();
  const auto report = check(as_rig(truth), truth, distances(kFrame));
  ASSERT_TRUE(report);
  EXPECT_TRUE(report->findings.empty()) << report->findings.front();
  EXPECT_TRUE(report->exchanged_detectors.empty());
  EXPECT_LT(report->distance_rms, 3e-3);
  for (const auto& p : report->projectors) {
    EXPECT_EQ(p.state, ProjectorState::kGood);
    EXPECT_LT(p.residual, 0.5);
  }
}

TEST(RigCheck, NamesTwoProjectorsThatMoved) {
  const auto calibrated = test::make_rig();
  auto truth = calibrated;
  // A tripod turned by three degrees, one moved by 10 cm.
  for (const std::size_t i : {2U, 11U}) {
    Eigen::Isometry3d X = Eigen::Isometry3d::Identity();
    if (i == 2) {
      X.linear() = Eigen::AngleAxisd(test::radians(3.0), Eigen::Vector3d(1, 1, 1).normalized())
                       .toRotationMatrix();
    } else {
      X.translation() << 0.1, 0.1, -0.1;
    }
    truth[i].P = truth[i].P * X.matrix();
  }
  const auto report = check(as_rig(calibrated), truth);
  ASSERT_TRUE(report);
  for (std::size_t i = 0; i < 16; ++i) {
    EXPECT_EQ(report->projectors[i].state,
              i == 2 || i == 11 ? ProjectorState::kMoved : ProjectorState::kGood)
        << i;
  }
  EXPECT_THAT(report->findings, ElementsAre(HasSubstr("projector 2 seems to have moved"),
                                            HasSubstr("projector 11 seems to have moved")));
}

TEST(RigCheck, NamesProjectorsInEachOthersSlot) {
  const auto truth = test::make_rig();
  auto calibrated = truth;
  std::swap(calibrated[4], calibrated[9]);
  const auto report = check(as_rig(calibrated), truth);
  ASSERT_TRUE(report);
  EXPECT_EQ(report->projectors[4].state, ProjectorState::kExchanged);
  EXPECT_EQ(report->projectors[4].slot, 9U);
  EXPECT_EQ(report->projectors[9].state, ProjectorState::kExchanged);
  EXPECT_EQ(report->projectors[9].slot, 4U);
  EXPECT_THAT(report->findings, ElementsAre(HasSubstr("projectors 4 and 9")));
}

TEST(RigCheck, NamesDetectorsInEachOthersPlace) {
  const auto truth = test::make_rig();
  auto told = kFrame;
  std::swap(told[1], told[4]);
  const auto report = check(as_rig(truth), truth, distances(told));
  ASSERT_TRUE(report);
  EXPECT_THAT(report->exchanged_detectors, ElementsAre(std::pair<std::size_t, std::size_t>(1, 4)));
  EXPECT_THAT(report->findings, ElementsAre(HasSubstr("detectors 1 and 4 seem to be exchanged")));
}

TEST(RigCheck, SaysWhatItCannotTell) {
  const auto truth = test::make_rig();
  ProjectorRig rig = as_rig(truth);
  rig.projectors[3].reset();
  const auto report = check(rig, truth);
  ASSERT_TRUE(report);
  EXPECT_EQ(report->projectors[3].state, ProjectorState::kUncalibrated);
  EXPECT_TRUE(report->findings.empty());
  EXPECT_FALSE(RigCheck(rig, 6).report());
  EXPECT_THROW(RigCheck(rig, 6, {{0, 6, 0.3}}), std::invalid_argument);
  EXPECT_THROW(RigCheck(rig, 6, {{0, 1, 0.0}}), std::invalid_argument);
}

}  // namespace
}  // namespace secondskin::server
