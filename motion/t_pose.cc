#include "motion/t_pose.h"

#include <fmt/format.h>

#include <stdexcept>

#include "motion/body_shape.h"
#include "motion/kinematics.h"

namespace secondskin {
namespace {

constexpr double kShortestLeg = 0.2, kLongestLeg = 1.5;  // thigh and shank [m]

std::size_t parent_of(std::size_t joint) noexcept {
  return index(canonical_anatomy()[joint].parent);
}

bool is_arm(Joint joint, Joint shoulder) noexcept {
  return index(joint) >= index(shoulder) && index(joint) <= index(shoulder) + 2;
}

// The segment's distal end is this joint's place: the next one of the same limb or of the trunk.
std::optional<std::size_t> next_of(std::size_t joint) noexcept {
  for (std::size_t child = joint + 1; child < kJointCount; ++child) {
    if (parent_of(child) == joint) return child;
  }
  return std::nullopt;
}

}  // namespace

Eigen::Quaterniond t_pose_rotation(Joint joint) noexcept {
  constexpr JointAngles kAbducted{0.0, 0.5 * std::numbers::pi, 0.0};
  static const auto left = joint_rotation(Joint::kLeftShoulder, kAbducted);
  static const auto right = joint_rotation(Joint::kRightShoulder, kAbducted);
  if (is_arm(joint, Joint::kLeftShoulder)) return left;
  if (is_arm(joint, Joint::kRightShoulder)) return right;
  return Eigen::Quaterniond::Identity();
}

Pose t_pose() {
  Pose pose(kJointCount);
  for (const Joint shoulder : {Joint::kLeftShoulder, Joint::kRightShoulder}) {
    pose.q_PB[index(shoulder)] = t_pose_rotation(shoulder);
  }
  return pose;
}

void to_t_pose_segments(const Skeleton& canonical, const Pose& pose,
                        std::span<Eigen::Isometry3d> X_WB,
                        std::span<TPoseSegment> segments) noexcept {
  forward_kinematics(canonical, pose.p_WR, pose.q_PB, X_WB);
  for (std::size_t j = 0; j < kJointCount; ++j) {
    const Eigen::Quaterniond q_WB(X_WB[j].linear());
    segments[j].p_WN = X_WB[j].translation();
    segments[j].q_WN = (q_WB * t_pose_rotation(static_cast<Joint>(j)).conjugate()).normalized();
  }
}

void from_t_pose_segments(std::span<const TPoseSegment> segments, Pose& pose) noexcept {
  std::array<Eigen::Quaterniond, kJointCount> q_WB;
  for (std::size_t j = 0; j < kJointCount; ++j) {
    q_WB[j] = segments[j].q_WN * t_pose_rotation(static_cast<Joint>(j));
    pose.q_PB[j] = j == 0 ? q_WB[0] : q_WB[parent_of(j)].conjugate() * q_WB[j];
    pose.q_PB[j].normalize();
  }
  pose.p_WR = segments[0].p_WN;
}

Skeleton skeleton_from_t_pose(std::span<const Eigen::Vector3d> p_MN) {
  std::vector<Segment> segments = canonical_skeleton().segments();
  for (std::size_t j = 1; j < kJointCount; ++j) {
    if (!p_MN[j].allFinite()) {
      throw std::runtime_error(
          fmt::format("body: the place of {} in its parent is not finite", segments[j].name));
    }
    const auto parent = static_cast<Joint>(parent_of(j));
    segments[j].p_PB = t_pose_rotation(parent).conjugate() * p_MN[j];
  }
  for (const Joint knee : {Joint::kLeftKnee, Joint::kRightKnee}) {
    const double leg = p_MN[index(knee)].norm() + p_MN[index(knee) + 1].norm();
    if (leg < kShortestLeg || leg > kLongestLeg) {
      throw std::runtime_error(
          fmt::format("body: thigh and shank at {} are {:.3g} m long, expected {} to {}",
                      joint_name(knee), leg, kShortestLeg, kLongestLeg));
    }
  }
  const Skeleton average = canonical_skeleton();
  const double ratio = average_stature(Skeleton(segments)) / average_stature(average);
  for (std::size_t j = 0; j < kJointCount; ++j) {
    Segment& s = segments[j];
    const double usual = average[j].p_BE.norm();
    const auto next = next_of(j);
    s.p_BE = next ? segments[*next].p_PB : Eigen::Vector3d(ratio * s.p_BE);
    if (usual > 0.0) s.p_BC *= s.p_BE.norm() / usual;
  }
  return Skeleton(std::move(segments));
}

}  // namespace secondskin
