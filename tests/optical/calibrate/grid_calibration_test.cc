#include "server/optical/calibrate/grid_calibration.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <random>
#include <stdexcept>

#include "tests/optical/calibrate/synthetic.h"

namespace secondskin::server {
namespace {

using testing::HasSubstr;

CalibrationGrid paper_grid() {
  CalibrationGrid grid;
  for (int k = 0; k < 12; ++k) {
    grid.p_W.emplace_back(-0.6 + 0.4 * (k % 4), -0.6 + 0.6 * (k / 4), 0.45);
  }
  grid.heights = {0.0, 36.0 * 0.0254};
  return grid;
}

// Readings of a grid whose detectors truly stand at `truth` but are told to the session as `told`.
GridCalibration read(const CalibrationGrid& told, const CalibrationGrid& truth,
                     const std::vector<Projector>& rig, int readings = 60) {
  std::mt19937 random(11);
  GridCalibration session(told, rig.size());
  for (std::size_t h = 0; h < truth.heights.size(); ++h) {
    for (int k = 0; k < readings; ++k) {
      ProjectorFrame frame(12, rig.size());
      for (std::size_t d = 0; d < 12; ++d) {
        const Eigen::Vector3d p = truth.p_W[d] + truth.heights[h] * Eigen::Vector3d::UnitZ();
        for (std::size_t i = 0; i < rig.size(); ++i) {
          frame.values[d * rig.size() + i] = test::receive(rig[i], p, {0.5, 0.05}, random);
        }
      }
      session.add(frame, h);
    }
  }
  return session;
}

TEST(GridCalibration, FindsAllProjectorsFromNoisyReadings) {
  const auto rig = test::make_rig();
  const auto result = read(paper_grid(), paper_grid(), rig).solve();
  ASSERT_TRUE(result) << result.error().text;
  for (std::size_t i = 0; i < rig.size(); ++i) {
    ASSERT_TRUE(result->rig.projectors[i]) << i;
    EXPECT_LT(result->projectors[i].residual, 0.4) << i;
    EXPECT_GT(result->projectors[i].residual_mm, 0.0);
    EXPECT_LT(result->projectors[i].residual_mm, 4.0);
    EXPECT_EQ(result->projectors[i].fitting, result->projectors[i].points);
  }
  EXPECT_LT(test::rig_error(rig, result->rig, false), 2e-3);
}

TEST(GridCalibration, TakesTheMeanOfManyRoundedReadings) {
  const auto rig = test::make_rig(2);
  const auto grid = paper_grid();
  const GridCalibration session = read(grid, grid, rig, 400);
  double square = 0.0;
  int n = 0;
  for (std::size_t d = 0; d < 12; ++d) {
    const auto v = session.value(d, 0, 0);
    if (!v) continue;
    square += std::pow(*v - rig[0].value(grid.p_W[d]), 2);
    ++n;
  }
  ASSERT_GT(n, 8);
  EXPECT_LT(std::sqrt(square / n), 0.08);
}

TEST(GridCalibration, NamesDetectorsThatWereExchanged) {
  const auto rig = test::make_rig();
  for (const auto& [a, b] : {std::pair{3, 7}, std::pair{0, 1}, std::pair{5, 11}}) {
    CalibrationGrid told = paper_grid();
    std::swap(told.p_W[static_cast<std::size_t>(a)], told.p_W[static_cast<std::size_t>(b)]);
    const auto result = read(told, paper_grid(), rig).solve();
    ASSERT_FALSE(result);
    EXPECT_EQ(result.error().kind, RefusalKind::kExchanged);
    EXPECT_THAT(result.error().text, HasSubstr("detectors " + std::to_string(a) + " and " +
                                               std::to_string(b) + " seem to be exchanged"));
  }
}

TEST(GridCalibration, NamesTwoPairsThatWereExchanged) {
  CalibrationGrid told = paper_grid();
  std::swap(told.p_W[2], told.p_W[9]);
  std::swap(told.p_W[4], told.p_W[7]);
  const auto result = read(told, paper_grid(), test::make_rig()).solve();
  ASSERT_FALSE(result);
  EXPECT_EQ(result.error().kind, RefusalKind::kExchanged);
  EXPECT_THAT(result.error().text, HasSubstr("2 and 9"));
  EXPECT_THAT(result.error().text, HasSubstr("4 and 7"));
}

TEST(GridCalibration, LeavesADarkProjectorOutAndSaysSo) {
  auto rig = test::make_rig();
  rig[6] = test::make_projector({3.35, 0.0, 1.2}, {1.0, 3.0, 1.2}, 0.0);  // looks past the grid
  const auto result = read(paper_grid(), paper_grid(), rig).solve();
  ASSERT_TRUE(result) << result.error().text;
  EXPECT_FALSE(result->rig.projectors[6]);
  ASSERT_TRUE(result->projectors[6].refused);
  EXPECT_EQ(result->projectors[6].refused->kind, RefusalKind::kTooFewPoints);
  EXPECT_TRUE(result->rig.projectors[7]);
}

TEST(GridCalibration, LeavesOutAProjectorThatWasTurnedBetweenTheHeights) {
  const auto rig = test::make_rig();
  const auto grid = paper_grid();
  std::mt19937 random(2);
  GridCalibration session(grid, rig.size());
  for (std::size_t h = 0; h < 2; ++h) {
    auto now = rig;
    if (h == 1) {
      now[4] = test::make_projector(test::centre_near(rig[4], {0, 0, 1}), {0, 0, 0.95}, 2.0);
    }
    for (int k = 0; k < 40; ++k) {
      ProjectorFrame frame(12, rig.size());
      for (std::size_t d = 0; d < 12; ++d) {
        for (std::size_t i = 0; i < rig.size(); ++i) {
          frame.values[d * rig.size() + i] = test::receive(
              now[i], grid.p_W[d] + grid.heights[h] * Eigen::Vector3d::UnitZ(), {}, random);
        }
      }
      session.add(frame, h);
    }
  }
  const auto result = session.solve();
  ASSERT_TRUE(result) << result.error().text;
  EXPECT_FALSE(result->rig.projectors[4]);
  ASSERT_TRUE(result->projectors[4].refused);
  EXPECT_EQ(result->projectors[4].refused->kind, RefusalKind::kDoesNotFit);
}

TEST(GridCalibration, IsRefusedAtOneHeight) {
  CalibrationGrid grid = paper_grid();
  grid.heights = {0.0};
  const auto result = read(grid, grid, test::make_rig()).solve();
  ASSERT_FALSE(result);
  EXPECT_EQ(result.error().kind, RefusalKind::kDegenerate);
  EXPECT_THAT(result.error().text, HasSubstr("second height"));
}

TEST(GridCalibration, IsRefusedWithoutReadings) {
  const auto result = GridCalibration(paper_grid(), 16).solve();
  ASSERT_FALSE(result);
  EXPECT_EQ(result.error().kind, RefusalKind::kTooFewPoints);
}

TEST(GridCalibration, RefusesFramesThatAreNotOfThisGrid) {
  GridCalibration session(paper_grid(), 16);
  EXPECT_THROW(session.add(ProjectorFrame(11, 16), 0), std::invalid_argument);
  EXPECT_THROW(session.add(ProjectorFrame(12, 15), 0), std::invalid_argument);
  EXPECT_THROW(session.add(ProjectorFrame(12, 16), 2), std::invalid_argument);
  EXPECT_THROW(GridCalibration({}, 16), std::invalid_argument);
}

}  // namespace
}  // namespace secondskin::server
