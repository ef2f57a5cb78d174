#include "server/optical/track/point_smoother.h"

#include <gtest/gtest.h>

#include <random>
#include <stdexcept>

namespace secondskin::server {
namespace {

constexpr std::int64_t kStep = 16'000'000;

std::vector<std::optional<Eigen::Vector3d>> smoothed(
    const std::vector<std::optional<Eigen::Vector3d>>& points) {
  PointSmoother smoother;
  std::vector<std::optional<Eigen::Vector3d>> out;
  for (std::size_t i = 0; i < points.size(); ++i) {
    out.push_back(smoother.update(static_cast<std::int64_t>(i) * kStep, points[i]));
  }
  return out;
}

TEST(PointSmoother, GivesTheMiddleOfItsWindow) {
  PointSmoother smoother;
  ASSERT_EQ(smoother.delay_frames(), 3U);
  std::vector<std::optional<Eigen::Vector3d>> line;
  for (int i = 0; i < 20; ++i) line.push_back(Eigen::Vector3d(0.01 * i, 1.0, -0.02 * i));
  const auto out = smoothed(line);
  for (std::size_t i = 0; i < 3; ++i) EXPECT_FALSE(out[i]);
  for (std::size_t i = 6; i < out.size(); ++i) {
    ASSERT_TRUE(out[i]);
    EXPECT_LT((*out[i] - *line[i - 3]).norm(), 1e-9);
  }
}

TEST(PointSmoother, WeighsNearValuesMostNotFarOnes) {
  // What the paper's wording would prefer, the spike, has to go.
  std::vector<std::optional<Eigen::Vector3d>> points(15, Eigen::Vector3d::Zero());
  points[7] = Eigen::Vector3d(0.5, 0.0, 0.0);
  for (const auto& point : smoothed(points)) {
    if (point) {
      EXPECT_LT(point->norm(), 1e-6);
    }
  }
}

TEST(PointSmoother, KeepsAStep) {
  std::vector<std::optional<Eigen::Vector3d>> points(20, Eigen::Vector3d::Zero());
  for (std::size_t i = 10; i < 20; ++i) points[i] = Eigen::Vector3d(0.3, 0.0, 0.0);
  const auto out = smoothed(points);
  for (std::size_t i = 6; i < 20; ++i) EXPECT_LT((*out[i] - *points[i - 3]).norm(), 1e-6);
}

TEST(PointSmoother, TakesNoiseOut) {
  std::mt19937 random(3);
  std::normal_distribution<double> normal(0.0, 0.005);
  PointSmoother smoother;
  double in = 0.0, out = 0.0;
  for (int i = 0; i < 2000; ++i) {
    const Eigen::Vector3d point(normal(random), normal(random), normal(random));
    in += point.squaredNorm();
    if (const auto s = smoother.update(i * kStep, point)) out += s->squaredNorm();
  }
  EXPECT_LT(out, 0.5 * in);
}

TEST(PointSmoother, GivesNothingWhereThereWasNothing) {
  std::vector<std::optional<Eigen::Vector3d>> points(15, Eigen::Vector3d(1.0, 2.0, 3.0));
  points[8].reset();
  const auto out = smoothed(points);
  EXPECT_FALSE(out[11]);
  ASSERT_TRUE(out[12]);
  EXPECT_LT((*out[12] - Eigen::Vector3d(1.0, 2.0, 3.0)).norm(), 1e-9);
}

TEST(PointSmoother, RefusesOptionsOutOfRange) {
  EXPECT_THROW(PointSmoother({.window = 4}), std::invalid_argument);
  EXPECT_THROW(PointSmoother({.sigma_time = 0.0}), std::invalid_argument);
}

}  // namespace
}  // namespace secondskin::server
