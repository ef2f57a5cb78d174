#include "coach/tactile/safe_range.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>
#include <numbers>
#include <random>

#include "motion/rotation.h"

namespace secondskin::coach {
namespace {

using testing::HasSubstr;

constexpr double kDegree = std::numbers::pi / 180.0;

std::filesystem::path written(const std::string& text) {
  const auto* test = testing::UnitTest::GetInstance()->current_test_info();
  const auto file = std::filesystem::path(testing::TempDir()) /
                    (std::string("secondskin_range_") + test->name() + ".toml");
  std::ofstream(file) << text;
  return file;
}

SafeRangeMonitor elbow_up_to(double most_deg) {
  return SafeRangeMonitor(
      {{{Joint::kLeftElbow, Movement::kFlexion, -20.0 * kDegree, most_deg * kDegree}}});
}

Pose flexed(double deg) {
  Pose pose(kJointCount);
  pose.q_PB[index(Joint::kLeftElbow)] =
      joint_rotation(Joint::kLeftElbow, {deg * kDegree, 0.0, 0.0});
  return pose;
}

JointVectors flexing(double deg_per_s) {
  JointVectors velocity = zero_vectors();
  velocity[index(Joint::kLeftElbow)] =
      deg_per_s * kDegree * canonical_anatomy()[index(Joint::kLeftElbow)].axis[0];
  return velocity;
}

TEST(SafeRange, ReadsLimitsInDegrees) {
  const auto range =
      SafeRange::load(written("[limits_deg.left_elbow]\nflexion = [0, "
                              "90]\n[limits_deg.right_hip]\nabduction = [-10.5, 20]\n"));
  ASSERT_EQ(range.limits.size(), 2u);
  EXPECT_EQ(range.limits[1].joint, Joint::kRightHip);
  EXPECT_EQ(range.limits[1].movement, Movement::kAbduction);
  EXPECT_DOUBLE_EQ(range.limits[1].minimum, -10.5 * kDegree);
  EXPECT_DOUBLE_EQ(range.limits[0].maximum, 90.0 * kDegree);
}

TEST(SafeRange, SaysFileLineAndFieldOfWhatIsWrong) {
  const std::vector<std::pair<std::string, std::string>> cases{
      {"x = 1\n", ":1: x: unknown"},
      {"[limits_deg.left_arm]\nflexion = [0, 1]\n", "left_arm: expected a canonical joint"},
      {"[limits_deg.left_elbow]\nbending = [0, 1]\n", ":2: bending: unknown"},
      {"[limits_deg.left_elbow]\nflexion = [90, 0]\n", ":2: flexion: expected two numbers"},
      {"[limits_deg.left_elbow]\nflexion = [0, nan]\n", ":2: flexion: expected two numbers"},
      {"[limits_deg.left_elbow]\nflexion = 90\n", ":2: flexion: expected two numbers"},
      {"[limits_deg.left_elbow]\n", "at least one limited movement"},
      {"", "limits_deg: missing"}};
  for (const auto& [text, what] : cases) {
    try {
      (void)SafeRange::load(written(text));
      ADD_FAILURE() << text;
    } catch (const std::runtime_error& error) {
      EXPECT_THAT(error.what(), HasSubstr(what));
    }
  }
}

TEST(SafeRange, AlarmsOutsideAndEndsInside) {
  auto monitor = elbow_up_to(90.0);
  EXPECT_FALSE(monitor.update(flexed(80.0), zero_vectors()).any);
  EXPECT_FALSE(monitor.update(flexed(89.9), zero_vectors()).any);
  const auto& alarm = monitor.update(flexed(95.0), zero_vectors());
  ASSERT_TRUE(alarm.any);
  EXPECT_NEAR(alarm.excess[index(Joint::kLeftElbow)], 5.0 * kDegree, 1e-6);
  EXPECT_TRUE(monitor.update(flexed(89.9), zero_vectors()).any);  // at the very edge: no flicker
  EXPECT_FALSE(monitor.update(flexed(88.0), zero_vectors()).any);
  EXPECT_TRUE(monitor.update(flexed(-25.0), zero_vectors()).any);
}

TEST(SafeRange, AlarmsBeforeTheRangeIsLeft) {
  auto monitor = elbow_up_to(90.0);
  EXPECT_FALSE(monitor.update(flexed(80.0), flexing(40.0)).any);  // 88 degrees in 0.2 s
  EXPECT_TRUE(monitor.update(flexed(80.0), flexing(100.0)).any);
  EXPECT_FALSE(monitor.update(flexed(80.0), flexing(-100.0)).any);
  Pose unseen = flexed(120.0);
  unseen.confidence[index(Joint::kLeftElbow)] = 0.0f;
  EXPECT_FALSE(monitor.update(unseen, zero_vectors()).any);
}

// Whatever joint, movement and pose: following the target a little brings the angle nearer.
TEST(SafeRange, PointsBackInside) {
  std::mt19937 generator(1);
  std::uniform_real_distribution<double> unit(0.0, 1.0);
  int alarms = 0;
  for (int draw = 0; draw < 3000; ++draw) {
    const auto joint = static_cast<Joint>(generator() % kJointCount);
    const auto movement = static_cast<Movement>(generator() % 3);
    const auto m = static_cast<std::size_t>(movement);
    const JointAnatomy& anatomy = canonical_anatomy()[index(joint)];
    if (anatomy.range[m].min == anatomy.range[m].max) continue;
    JointAngles angles{};
    for (std::size_t k = 0; k < 3; ++k) {
      const auto [low, high] = anatomy.range[k];
      angles[k] = low + (high - low) * (0.1 + 0.8 * unit(generator));
      angles[k] = std::clamp(angles[k], -1.2, 1.2);  // away from the conventions' poles
    }
    Pose pose(kJointCount);
    pose.q_PB[index(joint)] = joint_rotation(joint, angles);
    const double middle = angles[m] + (unit(generator) < 0.5 ? -0.5 : 0.5);
    SafeRangeMonitor monitor({{{joint, movement, middle - 0.3, middle + 0.3}}});
    const auto& alarm = monitor.update(pose, zero_vectors());
    ASSERT_TRUE(alarm.any);
    ++alarms;
    const Eigen::Vector3d step = 0.05 * alarm.target[index(joint)].normalized();
    const JointAngles after = joint_angles(joint, pose.q_PB[index(joint)] * quaternion_from(step));
    ASSERT_LT(std::abs(after[m] - middle), std::abs(angles[m] - middle) - 0.02)
        << anatomy.name << " " << m;
  }
  EXPECT_GT(alarms, 1000);
}

}  // namespace
}  // namespace secondskin::coach
