#include "coach/score/posture.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>
#include <random>

#include "coach/reference.h"
#include "motion/rotation.h"

namespace secondskin::coach {
namespace {

constexpr double kDegree = std::numbers::pi / 180.0;
const JointSet kAll = JointSet().set();

std::size_t feature(std::string_view name) {
  for (std::size_t f = 0; f < kPostureCount; ++f) {
    if (posture_features()[f].name == name) return f;
  }
  ADD_FAILURE() << name;
  return 0;
}

Pose random_pose(std::mt19937& random) {
  std::normal_distribution<double> normal(0.0, 0.4);
  Pose pose(kJointCount);
  for (auto& q : pose.q_PB) q = quaternion_from({normal(random), normal(random), normal(random)});
  return pose;
}

TEST(Posture, OfStandingIsUprightAndSymmetric) {
  const Posture posture = posture_of(Pose(kJointCount), kAll);
  for (std::size_t f = 0; f < kPostureCount; ++f) {
    const std::string_view name = posture_features()[f].name;
    const double expected = name == "depth" ? 1.0
                            : name.ends_with("_up") && !name.ends_with("s_up")
                                ? -0.5 * std::numbers::pi
                                : 0.0;
    EXPECT_NEAR(posture[f], expected, 1e-7) << name;
  }
}

TEST(Posture, SaysWhatAPhysiotherapistSees) {
  Pose pose(kJointCount);
  for (const Joint hip : {Joint::kLeftHip, Joint::kRightHip}) {
    pose.q_PB[index(hip)] = joint_rotation(hip, {90.0 * kDegree, 0.0, 0.0});
  }
  for (const Joint knee : {Joint::kLeftKnee, Joint::kRightKnee}) {
    pose.q_PB[index(knee)] = joint_rotation(knee, {90.0 * kDegree, 0.0, 0.0});
  }
  pose.q_PB[index(Joint::kSpineLower)] =
      joint_rotation(Joint::kSpineLower, {20.0 * kDegree, 0.0, 0.0});
  pose.q_PB[index(Joint::kLeftShoulder)] =
      joint_rotation(Joint::kLeftShoulder, {0.0, 30.0 * kDegree, 0.0});
  const Posture posture = posture_of(pose, kAll);
  EXPECT_NEAR(posture[feature("depth")], 0.5, 1e-9);  // sitting: the shanks alone
  EXPECT_NEAR(posture[feature("left_thigh_forward")], 90.0 * kDegree, 1e-6);
  EXPECT_NEAR(posture[feature("right_shank_forward")], 0.0, 1e-9);
  EXPECT_NEAR(posture[feature("trunk_forward")], 20.0 * kDegree, 1e-9);
  EXPECT_NEAR(posture[feature("left_upper_arm_left")], 30.0 * kDegree, 1e-9);
  EXPECT_NEAR(posture[feature("upper_arms_left")], 30.0 * kDegree, 1e-9);
  EXPECT_NEAR(posture[feature("thighs_forward")], 0.0, 1e-9);
}

TEST(Posture, IsExchangedByAMirror) {
  std::mt19937 random(1);
  for (int i = 0; i < 1000; ++i) {
    const Pose pose = random_pose(random);
    const Posture here = posture_of(pose, kAll);
    const Posture there = posture_of(secondskin::mirrored(pose), kAll);
    for (std::size_t f = 0; f < kPostureCount; ++f) {
      const PostureFeature& of = posture_features()[f];
      EXPECT_NEAR(there[of.mirrored], of.mirrored_sign * here[f], 1e-6) << of.name;
    }
  }
}

TEST(Posture, DoesNotDependOnHeadingOrPlace) {
  std::mt19937 random(2);
  for (int i = 0; i < 1000; ++i) {
    Pose pose = random_pose(random);
    const Posture here = posture_of(pose, kAll);
    pose.q_PB[0] = Eigen::AngleAxisd(0.1 * i, Eigen::Vector3d::UnitZ()) * pose.q_PB[0];
    pose.p_WR = Eigen::Vector3d(i, 2.0, -i);
    const Posture there = posture_of(pose, kAll);
    for (std::size_t f = 0; f < kPostureCount; ++f) EXPECT_NEAR(there[f], here[f], 1e-6);
  }
}

TEST(Posture, IsUnknownWhereAJointOfTheChainIsNotMeasured) {
  Pose pose(kJointCount);
  pose.confidence[index(Joint::kLeftShoulder)] = 0.0F;
  Posture posture = posture_of(pose, kAll);
  EXPECT_TRUE(std::isnan(posture[feature("left_upper_arm_up")]));
  EXPECT_TRUE(std::isnan(posture[feature("left_forearm_left")]));
  EXPECT_TRUE(std::isnan(posture[feature("forearms_left")]));
  EXPECT_FALSE(std::isnan(posture[feature("right_forearm_left")]));
  // A joint that the expert does not have either counts as straight.
  JointSet needed = kAll;
  needed.reset(index(Joint::kLeftShoulder));
  posture = posture_of(pose, needed);
  EXPECT_FALSE(std::isnan(posture[feature("left_forearm_left")]));
}

// Standing with one hip flexed by so much all the time.
Motion flexed(double degrees) {
  Motion motion{canonical_skeleton(), kReferenceRate, std::vector<Pose>(61, Pose(kJointCount))};
  for (Pose& pose : motion.poses) {
    pose.q_PB[index(Joint::kLeftHip)] =
        joint_rotation(Joint::kLeftHip, {degrees * kDegree, 0.0, 0.0});
  }
  return motion;
}

// docs/scoring.md, equation 4: four of prior with half of the 10 degrees, n - 1 of the experts'.
TEST(PostureModel, PoolsTheExpertsSpreadWithTheTolerance) {
  const Reference one = make_reference("one", flexed(10.0));
  const std::size_t f = feature("left_thigh_forward");
  const PostureModel alone = posture_model(one.motion, {}, one.weight, one.tolerance);
  EXPECT_NEAR(alone.mean[30][f], 10.0 * kDegree, 1e-6);
  EXPECT_NEAR(alone.spread[30][f], 5.0 * kDegree, 1e-9);
  EXPECT_NEAR(alone.spread[30][feature("thighs_forward")], std::sqrt(50.0) * kDegree, 1e-9);

  const std::vector<Motion> experts{flexed(0.0), flexed(10.0), flexed(20.0)};
  const Reference three = make_reference("three", experts);
  ASSERT_FALSE(three.posture.empty());
  EXPECT_NEAR(three.posture.mean[30][f], 10.0 * kDegree, 1e-6);
  EXPECT_NEAR(three.posture.spread[30][f], std::sqrt((4.0 * 25.0 + 200.0) / 6.0) * kDegree, 1e-6);
  // They differ all the time alike, so not in what changed since the start.
  EXPECT_NEAR(three.posture.spread_from_start[30][f], std::sqrt(4.0 * 25.0 / 6.0) * kDegree, 1e-6);
  EXPECT_NEAR(three.posture.range[f], 0.0, 1e-9);
}

TEST(PostureModel, IsMirroredWithItsReference) {
  const std::vector<Motion> experts{flexed(0.0), flexed(10.0)};
  const Reference mirror = mirrored(make_reference("two", experts));
  EXPECT_NEAR(mirror.posture.mean[30][feature("right_thigh_forward")], 5.0 * kDegree, 1e-6);
  EXPECT_NEAR(mirror.posture.mean[30][feature("left_thigh_forward")], 0.0, 1e-6);
  EXPECT_NEAR(mirror.posture.mean[30][feature("thighs_forward")], -5.0 * kDegree, 1e-6);
  EXPECT_GT(mirror.posture.spread[30][feature("right_thigh_forward")],
            mirror.posture.spread[30][feature("left_thigh_forward")]);
}

}  // namespace
}  // namespace secondskin::coach
