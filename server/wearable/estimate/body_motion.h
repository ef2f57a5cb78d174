#pragma once

#include <array>

#include "server/wearable/estimate/body_state.h"

/// Where a segment is and how it moves, as functions of the state, with their derivatives: the F
/// and J of section 5.2. docs/wearable-filter.md derives the matrices.
///
/// Frames: W the world; j a joint on the path from the root to a segment, p the segment before it.
namespace secondskin::server {

inline constexpr std::size_t kLongestPath = 10;

/// A joint on the way to a segment, in W.
struct JointMotion {
  std::size_t segment = 0;
  int group = 0;
  Eigen::Matrix3d R = Eigen::Matrix3d::Identity();     ///< R_WB
  Eigen::Vector3d p = Eigen::Vector3d::Zero();         ///< of its centre [m]
  Eigen::Vector3d v = Eigen::Vector3d::Zero();         ///< [m/s]
  Eigen::Vector3d a = Eigen::Vector3d::Zero();         ///< [m/s^2]
  Eigen::Vector3d own_w = Eigen::Vector3d::Zero();     ///< of the segment in its parent [rad/s]
  Eigen::Vector3d w = Eigen::Vector3d::Zero();         ///< of the segment in W [rad/s]
  Eigen::Vector3d dw = Eigen::Vector3d::Zero();        ///< [rad/s^2]
  Eigen::Vector3d parent_w = Eigen::Vector3d::Zero();  ///< of the segment before [rad/s]
  Eigen::Vector3d parent_dw = Eigen::Vector3d::Zero();
};

/// The way to a segment at a time before or after the state's.
struct PathMotion {
  double time = 0.0;
  std::size_t size = 0;
  std::array<JointMotion, kLongestPath> joints;
  const JointMotion& end() const noexcept { return joints[size - 1]; }
};

/// @param fixed  rotations of the joints that the state does not hold; one per segment
void evaluate(const Skeleton& skeleton, const BodyLayout& layout, const BodyState& state,
              std::span<const Eigen::Quaterniond> fixed, std::size_t segment, double time,
              PathMotion& path) noexcept;

/// A point that is fixed to the path's last segment, in W.
struct PointMotion {
  Eigen::Vector3d p, v, a;
};
PointMotion point(const PathMotion& path, const Eigen::Vector3d& p_BQ) noexcept;

/// Derivatives of a point's position, velocity or acceleration by one joint of the path: of its
/// rotation's error, rate and acceleration, each 3 x 3, written in the joint's own frame.
struct JointBlock {
  Eigen::Matrix3d rotation = Eigen::Matrix3d::Zero();
  Eigen::Matrix3d rate = Eigen::Matrix3d::Zero();
  Eigen::Matrix3d acceleration = Eigen::Matrix3d::Zero();
};
JointBlock position_block(const JointMotion& joint, const PointMotion& point) noexcept;
JointBlock velocity_block(const JointMotion& joint, const PointMotion& point) noexcept;
JointBlock acceleration_block(const JointMotion& joint, const PointMotion& point) noexcept;

/// Derivative of R_WB^T f for a vector f(state) of W whose own derivative is `block`, with R_WB of
/// a segment at or beyond the joint; still to be multiplied by R_WB^T from the left.
void turn_along(const JointMotion& joint, const Eigen::Vector3d& f, JointBlock& block) noexcept;

/// The same of the last segment's angular velocity: R_WB^T w_WB, before R_WB^T.
JointBlock rate_block(const JointMotion& joint) noexcept;

}  // namespace secondskin::server
