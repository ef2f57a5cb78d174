#include "bus/pose_messages.h"

#include <gtest/gtest.h>

#include <limits>

#include "motion/anatomy.h"
#include "motion/rotation.h"

namespace secondskin::bus {
namespace {

StampedPose some_pose() {
  StampedPose pose{.frame = 41, .stamp_ns = 1'700'000'000'123'456'789, .pose = Pose(kJointCount)};
  pose.pose.p_WR = {1.25, -0.5, 0.93};
  for (std::size_t i = 0; i < kJointCount; ++i) {
    pose.pose.q_PB[i] = quaternion_from({0.1 * static_cast<double>(i), -0.2, 0.05});
    pose.pose.confidence[i] = static_cast<float>(i) / kJointCount;
  }
  return pose;
}

TEST(PoseMessages, KeepEveryNumberOfAPose) {
  const auto before = some_pose();
  msg::SkeletonPose message;
  to_message(before, 7, message);
  StampedPose after;
  ASSERT_TRUE(from_message(message, after));
  EXPECT_EQ(after.frame, before.frame);
  EXPECT_EQ(after.stamp_ns, before.stamp_ns);
  EXPECT_EQ(after.pose.p_WR, before.pose.p_WR);
  for (std::size_t i = 0; i < kJointCount; ++i) {
    EXPECT_EQ(after.pose.q_PB[i].coeffs(), before.pose.q_PB[i].coeffs());
    EXPECT_EQ(after.pose.confidence[i], before.pose.confidence[i]);
  }
}

TEST(PoseMessages, RefuseNumbersThatAreNone) {
  msg::SkeletonPose message;
  StampedPose pose;
  for (const double bad :
       {std::numeric_limits<double>::quiet_NaN(), std::numeric_limits<double>::infinity(), 0.0}) {
    to_message(some_pose(), 7, message);
    message.orientations()[3].w(bad);
    message.orientations()[3].x(bad);
    message.orientations()[3].y(bad);
    message.orientations()[3].z(bad);
    EXPECT_FALSE(from_message(message, pose)) << bad;
  }
  to_message(some_pose(), 7, message);
  message.root_position().y(std::numeric_limits<double>::quiet_NaN());
  EXPECT_FALSE(from_message(message, pose));
}

TEST(PoseMessages, RefuseListsOfDifferentLength) {
  msg::SkeletonPose message;
  to_message(some_pose(), 7, message);
  message.confidences().pop_back();
  StampedPose pose;
  EXPECT_FALSE(from_message(message, pose));
}

TEST(SkeletonMessages, KeepTheBody) {
  const Skeleton before = canonical_skeleton(1.62);
  msg::SkeletonDefinition message;
  to_message(before, "test", 62.5, message);
  const Skeleton after = to_skeleton(message);
  ASSERT_EQ(after.size(), before.size());
  for (std::size_t i = 0; i < before.size(); ++i) {
    EXPECT_EQ(after[i].name, before[i].name);
    EXPECT_EQ(after[i].parent, before[i].parent);
    EXPECT_EQ(after[i].p_PB, before[i].p_PB);
    EXPECT_EQ(after[i].p_BE, before[i].p_BE);
    EXPECT_EQ(after[i].mass_fraction, before[i].mass_fraction);
  }
  EXPECT_EQ(skeleton_id(after), skeleton_id(before));
  EXPECT_NE(skeleton_id(after), skeleton_id(canonical_skeleton(1.63)));
}

TEST(SkeletonMessages, NameTheJointThatIsWrong) {
  msg::SkeletonDefinition message;
  to_message(canonical_skeleton(), "test", 62.5, message);
  message.joints()[4].parent(17);
  try {
    to_skeleton(message);
    FAIL() << "a parent after its child was taken";
  } catch (const std::runtime_error& error) {
    EXPECT_NE(std::string(error.what()).find("neck"), std::string::npos) << error.what();
  }
}

}  // namespace
}  // namespace secondskin::bus
