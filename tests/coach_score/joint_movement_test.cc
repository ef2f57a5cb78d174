#include "coach/score/joint_movement.h"

#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <numbers>

namespace secondskin::coach {
namespace {

constexpr double kDegree = std::numbers::pi / 180.0;
constexpr std::size_t kKnee = index(Joint::kLeftKnee);
constexpr std::size_t kHip = index(Joint::kLeftHip);

using Angle = std::function<double(double)>;  // [rad] of the time [s]

Pose pose_with(double hip, double knee) {
  Pose pose(kJointCount);
  pose.q_PB[kHip] = joint_rotation(Joint::kLeftHip, {hip, 0.0, 0.0});
  pose.q_PB[kKnee] = joint_rotation(Joint::kLeftKnee, {knee, 0.0, 0.0});
  return pose;
}

Reference reference(double seconds, const Angle& hip, const Angle& knee) {
  Motion motion{canonical_skeleton(), kReferenceRate, {}};
  for (double t = 0.0; t <= seconds; t += 1.0 / kReferenceRate) {
    motion.poses.push_back(pose_with(hip(t), knee(t)));
  }
  return make_reference("movement", motion);
}

// A learner at 100 Hz who follows the reference in its own time.
JointMovement moved(const Reference& reference, double seconds, const Angle& hip,
                    const Angle& knee) {
  JointMovement movement(reference);
  for (double t = 0.0; t <= seconds; t += 0.01) movement.update(t, t, pose_with(hip(t), knee(t)));
  return movement;
}

double wave(double t) { return 30.0 * kDegree * (1.0 - std::cos(std::numbers::pi * t)); }
double still(double) { return 0.0; }

TEST(TimingError, IsTheLagOfAShiftedSine) {
  const Reference expert = reference(6.0, wave, wave);
  for (const double late : {-0.3, -0.12, -0.025, 0.0, 0.04, 0.12, 0.31}) {
    for (const double offset : {0.0, 10.0 * kDegree}) {
      const JointMovement movement = moved(expert, 6.0, wave, [&](double t) {
        return offset + wave(std::clamp(t - late, 0.0, 6.0));
      });
      ASSERT_TRUE(movement.timing_error(kKnee));
      EXPECT_NEAR(*movement.timing_error(kKnee), late, 0.01) << late << " " << offset;
      EXPECT_NEAR(*movement.timing_error(kHip), 0.0, 0.002);
    }
  }
}

TEST(TimingError, IsNothingWhereNothingMoves) {
  const JointMovement lazy = moved(reference(6.0, wave, wave), 6.0, wave, still);
  EXPECT_TRUE(lazy.timing_error(kHip));
  EXPECT_FALSE(lazy.timing_error(kKnee));
  EXPECT_FALSE(lazy.smoothness(kKnee));
  const JointMovement busy = moved(reference(6.0, wave, still), 6.0, wave, wave);
  EXPECT_FALSE(busy.timing_error(kKnee));
  EXPECT_TRUE(busy.smoothness(kKnee));
}

TEST(Range, IsAboutTheExpertsMainAxis) {
  const JointMovement half =
      moved(reference(6.0, wave, wave), 6.0, wave, [](double t) { return 0.5 * wave(t); });
  EXPECT_NEAR(half.reference_range(kKnee), 60.0 * kDegree, 0.1 * kDegree);
  EXPECT_NEAR(half.range(kKnee), 30.0 * kDegree, 0.1 * kDegree);
  EXPECT_NEAR(half.range(kHip), 60.0 * kDegree, 0.1 * kDegree);
}

// The integral of a bell-shaped speed: 60 degrees, standard deviation 0.15 s.
double bell(double t, double at) {
  return 60.0 * kDegree * 0.5 * std::erfc(-(t - at) / (0.15 * std::numbers::sqrt2));
}

// The spectrum of a Gaussian is one: V(f) / V(0) = 20^-(f / c)^2 with V(c) = 0.05, so the arc
// length over f / c from 0 to 1 is the integral of sqrt(1 + V'^2), whatever the width of the bell.
TEST(Smoothness, OfABellIsItsClosedForm) {
  double length = 0.0;
  constexpr int kSteps = 100000;
  for (int i = 0; i < kSteps; ++i) {
    const double u = (i + 0.5) / kSteps;
    const double slope = -2.0 * u * std::log(20.0) * std::pow(20.0, -u * u);
    length += std::sqrt(1.0 + slope * slope) / kSteps;
  }
  const Reference expert = reference(6.0, wave, wave);
  const auto one = moved(expert, 2.0, wave, [](double t) { return bell(t, 1.0); });
  ASSERT_TRUE(one.smoothness(kKnee));
  EXPECT_NEAR(*one.smoothness(kKnee), -length, 0.005);
}

// Balasubramanian et al. 2015: it falls with the number of submovements and with the pauses between
// them, and does not depend on how far the movement goes.
TEST(Smoothness, FallsWithSubmovementsAndPauses) {
  const Reference expert = reference(8.0, wave, wave);
  const auto of = [&](const Angle& knee) {
    return moved(expert, 8.0, wave, knee).smoothness(kKnee).value();
  };
  const double one = of([](double t) { return bell(t, 2.0); });
  EXPECT_NEAR(of([](double t) { return 1.5 * bell(t, 2.0); }), one, 1e-3);
  const double two = of([](double t) { return bell(t, 2.0) + bell(t, 2.6); });
  const double apart = of([](double t) { return bell(t, 2.0) + bell(t, 3.2); });
  const double three =
      of([](double t) { return 0.7 * (bell(t, 2.0) + bell(t, 3.2) + bell(t, 4.4)); });
  EXPECT_LT(two, one - 0.1);
  EXPECT_LT(apart, two - 0.1);
  EXPECT_LT(three, apart - 0.1);
}

TEST(JointMovement, ForgetsWhenCleared) {
  const Reference expert = reference(6.0, wave, wave);
  JointMovement movement = moved(expert, 6.0, wave, wave);
  const double smoothness = movement.smoothness(kKnee).value();
  movement.clear();
  EXPECT_FALSE(movement.smoothness(kKnee));
  EXPECT_FALSE(movement.timing_error(kKnee));
  for (double t = 0.0; t <= 6.0; t += 0.01) movement.update(t, t, pose_with(wave(t), wave(t)));
  EXPECT_DOUBLE_EQ(movement.smoothness(kKnee).value(), smoothness);
}

}  // namespace
}  // namespace secondskin::coach
