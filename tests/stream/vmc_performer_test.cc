#include "clients/stream/vmc_performer.h"

#include <gtest/gtest.h>

namespace secondskin::stream {
namespace {

using Eigen::Quaterniond;
using Eigen::Vector3d;

// Unity's rotations act on Unity's coordinates by the same formula as ours on ours.
Vector3d turned(const UnityTransform& at, const Vector3d& v) {
  const auto& r = at.rotation;
  return Quaterniond(r[3], r[0], r[1], r[2]) * v;
}

const UnityTransform& bone(const std::array<UnityTransform, kJointCount>& bones,
                           std::string_view name) {
  for (std::size_t j = 0; j < kJointCount; ++j) {
    if (kUnityBones[j] == name) return bones[j];
  }
  throw std::logic_error("no such bone");
}

void expect_rotation(const UnityTransform& at, double x, double y, double z, double w,
                     std::string_view what) {
  const auto& r = at.rotation;
  const double dot = r[0] * x + r[1] * y + r[2] * z + r[3] * w;
  EXPECT_NEAR(std::abs(dot), 1.0, 1e-6)
      << what << ": " << r[0] << " " << r[1] << " " << r[2] << " " << r[3];
}

Pose pose_with(Joint joint, const JointAngles& angles) {
  Pose pose(kJointCount);
  pose.q_PB[index(joint)] = joint_rotation(joint, angles);
  return pose;
}

constexpr double kQuarter = 0.5 * std::numbers::pi;
const double kHalf = std::sqrt(0.5);

TEST(Vmc, HasNoRotationsInTheTPose) {
  const auto bones = unity_bones(canonical_skeleton(), t_pose());
  for (std::size_t j = 0; j < kJointCount; ++j) {
    expect_rotation(bones[j], 0, 0, 0, 1, kUnityBones[j]);
  }
}

// Unity: x right, y up, z forward. The T-pose's left arm points to -x, its right arm to +x.
TEST(Vmc, PlacesBonesAsUnityHasThem) {
  const Skeleton body = canonical_skeleton();
  Pose pose = t_pose();
  pose.p_WR = {2.0, 0.5, 0.9};  // forward, left, up
  const auto bones = unity_bones(body, pose);
  EXPECT_EQ(bone(bones, "Hips").position, (std::array<float, 3>{-0.5F, 0.9F, 2.0F}));
  const auto forearm = bone(bones, "LeftLowerArm").position;
  EXPECT_LT(forearm[0], -0.2F);
  EXPECT_NEAR(forearm[1], 0.0F, 1e-6F);
  EXPECT_GT(bone(bones, "RightLowerArm").position[0], 0.2F);
  EXPECT_LT(bone(bones, "RightLowerLeg").position[1], -0.3F);
  EXPECT_GT(bone(bones, "LeftToes").position[2], 0.1F);
  EXPECT_GT(bone(bones, "RightUpperLeg").position[0], 0.05F);
}

// By hand: the right arm raised forward by 90 degrees points to +z, its palm, which faced the
// thigh, faces left (-x), its thumb up. From the T-pose (arm +x, palm -y, thumb +z) that turns
// x to z, z to y and y to x: a third of a turn, quaternion -(1, 1, 1)/2 with w = 1/2.
TEST(Vmc, ShowsTheRightArmRaisedForward) {
  const auto bones =
      unity_bones(canonical_skeleton(), pose_with(Joint::kRightShoulder, {kQuarter, 0, 0}));
  const auto& arm = bone(bones, "RightUpperArm");
  expect_rotation(arm, -0.5, -0.5, -0.5, 0.5, "RightUpperArm");
  EXPECT_LT((turned(arm, Vector3d::UnitX()) - Vector3d::UnitZ()).norm(), 1e-6);
  EXPECT_LT((turned(arm, -Vector3d::UnitY()) + Vector3d::UnitX()).norm(), 1e-6);
  expect_rotation(bone(bones, "RightLowerArm"), 0, 0, 0, 1, "RightLowerArm");
  // The left one hangs: from -x to -y is a quarter turn about z, positive as y goes to -x.
  expect_rotation(bone(bones, "LeftUpperArm"), 0, 0, kHalf, kHalf, "LeftUpperArm");
  EXPECT_LT((turned(bone(bones, "LeftUpperArm"), -Vector3d::UnitX()) + Vector3d::UnitY()).norm(),
            1e-6);
}

// Unity turns to the right for a positive angle about y: forward z goes to x.
TEST(Vmc, TurnsTheHeadToTheLeft) {
  const auto bones = unity_bones(canonical_skeleton(), pose_with(Joint::kHead, {0, 0, kQuarter}));
  expect_rotation(bone(bones, "Head"), 0, -kHalf, 0, kHalf, "Head");
  EXPECT_LT((turned(bone(bones, "Head"), Vector3d::UnitZ()) + Vector3d::UnitX()).norm(), 1e-6);
}

// A bent knee brings the shank (-y) back (-z): about x, positive as y goes to z.
TEST(Vmc, BendsTheKneeBackward) {
  const auto bones =
      unity_bones(canonical_skeleton(), pose_with(Joint::kLeftKnee, {kQuarter, 0, 0}));
  const auto& shank = bone(bones, "LeftLowerLeg");
  expect_rotation(shank, kHalf, 0, 0, kHalf, "LeftLowerLeg");
  EXPECT_LT((turned(shank, -Vector3d::UnitY()) + Vector3d::UnitZ()).norm(), 1e-6);
}

// The left elbow bent with the arm hanging: the hand comes forward. In the T-pose's frames, where
// the forearm lies along -x with its thumb to +z, it turns about y.
TEST(Vmc, BendsTheElbowForward) {
  const auto bones =
      unity_bones(canonical_skeleton(), pose_with(Joint::kLeftElbow, {kQuarter, 0, 0}));
  EXPECT_LT((turned(bone(bones, "LeftLowerArm"), -Vector3d::UnitX()) - Vector3d::UnitZ()).norm(),
            1e-6);
  expect_rotation(bone(bones, "LeftLowerArm"), 0, kHalf, 0, kHalf, "LeftLowerArm");
}

TEST(Vmc, SendsNothingWithoutABody) {
  VmcPerformer performer;
  EXPECT_TRUE(performer.encode({1, 1, Pose(kJointCount)}).empty());
}

TEST(Vmc, FitsIntoFramesOfEthernet) {
  VmcPerformer performer;
  performer.set_body(canonical_skeleton());
  const auto datagrams = performer.encode({1, 1, t_pose()});
  ASSERT_EQ(datagrams.size(), 2u);
  for (const auto& datagram : datagrams) EXPECT_LE(datagram.size(), 1472u);
}

}  // namespace
}  // namespace secondskin::stream
