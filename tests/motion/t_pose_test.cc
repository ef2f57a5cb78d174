#include "motion/t_pose.h"

#include <gtest/gtest.h>

#include <limits>
#include <random>

#include "motion/kinematics.h"
#include "motion/retarget.h"
#include "motion/rotation.h"
#include "motion/xsens_body.h"
#include "tests/motion/random_pose.h"

namespace secondskin {
namespace {

using Joints = std::array<TPoseSegment, kJointCount>;
using Eigen::Vector3d;

Joints segments_of(const Skeleton& body, const Pose& pose) {
  std::array<Eigen::Isometry3d, kJointCount> X_WB;
  Joints joints;
  to_t_pose_segments(body, pose, X_WB, joints);
  return joints;
}

Vector3d along(const Joints& at, Joint from, Joint to) {
  return (at[index(to)].p_WN - at[index(from)].p_WN).normalized();
}

TEST(TPose, HoldsTheArmsOutWithAllFramesParallelToTheWorld) {
  const Joints at = segments_of(canonical_skeleton(), t_pose());
  for (const TPoseSegment& segment : at) {
    EXPECT_LT(geodesic_distance(segment.q_WN, Eigen::Quaterniond::Identity()), 1e-12);
  }
  EXPECT_LT((along(at, Joint::kLeftShoulder, Joint::kLeftWrist) - Vector3d(0, 1, 0)).norm(), 1e-12);
  EXPECT_LT((along(at, Joint::kRightShoulder, Joint::kRightWrist) - Vector3d(0, -1, 0)).norm(),
            1e-12);
  EXPECT_LT((along(at, Joint::kLeftHip, Joint::kLeftKnee) - Vector3d(0, 0, -1)).norm(), 1e-12);
}

// At rest the palms face the thighs, y = 0; so in the T-pose they face down.
TEST(TPose, HoldsThePalmsDown) {
  const Skeleton body = canonical_skeleton();
  std::array<Eigen::Isometry3d, kJointCount> X_WB;
  const Pose pose = t_pose();
  forward_kinematics(body, pose.p_WR, pose.q_PB, X_WB);
  const Vector3d left_palm = X_WB[index(Joint::kLeftWrist)].linear() * Vector3d(0, -1, 0);
  const Vector3d right_palm = X_WB[index(Joint::kRightWrist)].linear() * Vector3d(0, 1, 0);
  EXPECT_LT((left_palm - Vector3d(0, 0, -1)).norm(), 1e-12);
  EXPECT_LT((right_palm - Vector3d(0, 0, -1)).norm(), 1e-12);
}

TEST(TPose, GivesAnyPoseBack) {
  const Skeleton body = canonical_skeleton(1.8);
  std::mt19937 random(7);
  for (int i = 0; i < 1000; ++i) {
    const Pose pose = random_pose(random, kJointCount);
    Pose back(kJointCount);
    from_t_pose_segments(segments_of(body, pose), back);
    EXPECT_LT((back.p_WR - pose.p_WR).norm(), 1e-12);
    for (std::size_t j = 0; j < kJointCount; ++j) {
      EXPECT_LT(geodesic_distance(back.q_PB[j], pose.q_PB[j]), 1e-7) << joint_name(Joint(j));
    }
  }
}

TEST(XsensBody, IsToldByASinglePose) {
  const Skeleton body = canonical_skeleton(1.62);
  std::mt19937 random(8);
  for (int i = 0; i < 100; ++i) {
    const Joints joints = segments_of(body, random_pose(random, kJointCount));
    std::array<TPoseSegment, kXsensSegmentCount> xsens;
    to_xsens(joints, xsens);
    const Skeleton told = xsens_skeleton(xsens);
    for (std::size_t j = 1; j < kJointCount; ++j) {
      EXPECT_LT((told[j].p_PB - body[j].p_PB).norm(), 1e-9) << told[j].name;
      EXPECT_LT((told[j].p_BE - body[j].p_BE).norm(), 2e-3) << told[j].name;
      EXPECT_EQ(told[j].parent, body[j].parent);
    }
    EXPECT_TRUE(is_canonical(told));
  }
}

// The trunk's bend between L5 and T12 lies in two joints there; unbent, both offsets add up.
TEST(XsensBody, AddsUpTheTwoLowerTrunkSegments) {
  const Skeleton body = canonical_skeleton();
  const Joints joints = segments_of(body, t_pose());
  std::array<TPoseSegment, kXsensSegmentCount> xsens;
  to_xsens(joints, xsens);
  const Eigen::Quaterniond bend(Eigen::AngleAxisd(0.5, Vector3d::UnitY()));
  const Vector3d pivot = xsens[kXsensL3].p_WN;
  xsens[kXsensL3].q_WN = bend;
  const std::size_t t12 = kXsensSegmentOf[index(Joint::kSpineMiddle)];
  for (std::size_t s = 0; s < kXsensSegmentCount; ++s) {
    if (s < t12 || s >= kXsensSegmentOf[index(Joint::kRightHip)]) continue;
    xsens[s] = {pivot + bend * (xsens[s].p_WN - pivot), bend * xsens[s].q_WN};
  }
  const Skeleton told = xsens_skeleton(xsens);
  for (std::size_t j = 1; j < kJointCount; ++j) {
    EXPECT_LT((told[j].p_PB - body[j].p_PB).norm(), 1e-9) << told[j].name;
  }
}

TEST(XsensBody, RefusesLegsOfNobody) {
  std::array<TPoseSegment, kXsensSegmentCount> xsens;
  EXPECT_THROW((void)xsens_skeleton(xsens), std::runtime_error);
  to_xsens(segments_of(canonical_skeleton(), t_pose()), xsens);
  xsens[4].p_WN.x() = std::numeric_limits<double>::quiet_NaN();
  EXPECT_THROW((void)xsens_skeleton(xsens), std::runtime_error);
}

// What a file with the same names would be mapped to.
TEST(XsensBody, AgreesWithTheJointMapOfItsFiles) {
  std::vector<Segment> segments;
  for (std::size_t s = 0; s < kXsensSegmentCount; ++s) {
    Segment segment;
    segment.name = std::string(kXsensSegmentNames[s]);
    if (s > 0) segment.parent = s - 1;
    segments.push_back(segment);
  }
  const Skeleton skeleton(segments);
  const auto map = JointMap::load(SECONDSKIN_SOURCE_DIR "/joint_maps/xsens_segments.toml");
  for (std::size_t j = 0; j < kJointCount; ++j) {
    EXPECT_EQ(map.find(Joint(j), skeleton), kXsensSegmentOf[j]) << joint_name(Joint(j));
  }
}

}  // namespace
}  // namespace secondskin
