#include "motion/motion.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <stdexcept>

#include "random_pose.h"

namespace secondskin {
namespace {

// A bar that turns about z at 1 rad/s while it moves along x at 2 m/s, ten poses a second.
Motion turning_bar(std::size_t poses) {
  Motion motion{Skeleton({Segment{.name = "bar", .parent = {}}}), 10.0, {}};
  for (std::size_t i = 0; i < poses; ++i) {
    const double t = 0.1 * static_cast<double>(i);
    Pose pose(1);
    pose.p_WR.x() = 2.0 * t;
    pose.q_PB[0] = quaternion_from({0, 0, t});
    motion.poses.push_back(pose);
  }
  return motion;
}

TEST(Motion, LastsFromTheFirstPoseToTheLast) {
  EXPECT_DOUBLE_EQ(turning_bar(11).duration(), 1.0);
  EXPECT_DOUBLE_EQ(turning_bar(1).duration(), 0.0);
}

TEST(Interpolate, MovesAtConstantSpeedBetweenThePoses) {
  const Motion motion = turning_bar(11);
  Pose out(1);
  for (const double u : {0.0, 0.25, 0.5, 1.0}) {
    interpolate(motion.poses[2], motion.poses[7], u, out);
    EXPECT_NEAR(out.p_WR.x(), 0.4 + u, 1e-12);
    EXPECT_NEAR(rotation_vector(out.q_PB[0]).z(), 0.2 + 0.5 * u, 1e-12);
  }
}

TEST(Interpolate, TakesTheShorterWayAndTheSmallerConfidence) {
  std::mt19937 generator(6);
  for (int i = 0; i < 1000; ++i) {
    Pose a = random_pose(generator, 1), b = random_pose(generator, 1), out(1);
    a.confidence[0] = 0.25F;
    b.q_PB[0].coeffs() *= i % 2 == 0 ? 1.0 : -1.0;
    interpolate(a, b, 0.3, out);
    const double whole = geodesic_distance(a.q_PB[0], b.q_PB[0]);
    EXPECT_NEAR(geodesic_distance(a.q_PB[0], out.q_PB[0]), 0.3 * whole, 1e-9);
    EXPECT_NEAR(geodesic_distance(out.q_PB[0], b.q_PB[0]), 0.7 * whole, 1e-9);
    EXPECT_EQ(out.confidence[0], 0.25F);
  }
}

TEST(Sample, HoldsBothEndsAndNeverReadsOutside) {
  const Motion motion = turning_bar(11);
  Pose out;
  for (const double t : {-1.0, -1e300, std::numeric_limits<double>::quiet_NaN()}) {
    sample(motion, t, out);
    EXPECT_DOUBLE_EQ(out.p_WR.x(), 0.0);
  }
  for (const double t : {1.0, 1.05, 1e300, std::numeric_limits<double>::infinity()}) {
    sample(motion, t, out);
    EXPECT_NEAR(out.p_WR.x(), 2.0, 1e-12);
  }
  sample(motion, 0.55, out);
  EXPECT_NEAR(out.p_WR.x(), 1.1, 1e-12);
  EXPECT_NEAR(rotation_vector(out.q_PB[0]).z(), 0.55, 1e-12);
}

TEST(Resample, KeepsTheMotionAndItsDurationAtAnotherRate) {
  const Motion motion = turning_bar(11);
  for (const double rate : {10.0, 62.5, 120.0, 3.0}) {
    const Motion other = resample(motion, rate);
    EXPECT_DOUBLE_EQ(other.rate_hz, rate);
    EXPECT_EQ(other.poses.size(), static_cast<std::size_t>(std::floor(rate + 1e-6)) + 1);
    for (std::size_t i = 0; i < other.poses.size(); ++i) {
      const double t = static_cast<double>(i) / rate;
      EXPECT_NEAR(other.poses[i].p_WR.x(), 2.0 * t, 1e-9);
      EXPECT_NEAR(rotation_vector(other.poses[i].q_PB[0]).z(), t, 1e-9);
    }
  }
}

// 29 / 100 * 100 is less than 29 in floating point.
TEST(Resample, DoesNotLoseTheLastPoseToRounding) {
  Motion motion = turning_bar(30);
  motion.rate_hz = 100.0;
  EXPECT_EQ(resample(motion, 100.0).poses.size(), 30U);
}

TEST(Resample, RefusesARateThatIsNone) {
  const Motion motion = turning_bar(3);
  for (const double rate : {0.0, -1.0, std::numeric_limits<double>::quiet_NaN(),
                            std::numeric_limits<double>::infinity(), 1e300}) {
    EXPECT_THROW(resample(motion, rate), std::invalid_argument) << rate;
  }
}

TEST(Slice, IsTheAskedPosesAndRefusesWrongRanges) {
  const Motion motion = turning_bar(11);
  const Motion part = slice(motion, 3, 6);
  ASSERT_EQ(part.poses.size(), 3U);
  EXPECT_NEAR(part.poses[0].p_WR.x(), 0.6, 1e-12);
  EXPECT_NEAR(part.poses[2].p_WR.x(), 1.0, 1e-12);
  EXPECT_EQ(slice(motion, 0, 11).poses.size(), 11U);
  EXPECT_THROW(slice(motion, 3, 3), std::out_of_range);
  EXPECT_THROW(slice(motion, 6, 3), std::out_of_range);
  EXPECT_THROW(slice(motion, 0, 12), std::out_of_range);
}

}  // namespace
}  // namespace secondskin
