#pragma once

#include <Eigen/Geometry>
#include <span>

#include "motion/skeleton.h"

/// Forward kinematics, geometric Jacobians and the centre of mass. Nothing here allocates or
/// throws.
namespace secondskin {

/// Places every segment in the world, root first: X_WB = X_WP * [q_PB, p_PB].
/// @param p_WR  root position in W [m]
/// @param q_PB  unit orientation of each segment in its parent; one per segment
/// @param X_WB  out: pose of each segment in W; one per segment
/// O(segments).
void forward_kinematics(const Skeleton& skeleton, const Eigen::Vector3d& p_WR,
                        std::span<const Eigen::Quaterniond> q_PB,
                        std::span<Eigen::Isometry3d> X_WB) noexcept;

/// The geometric Jacobian of a point fixed in one segment.
///
/// Columns: 0-2 the root's position in W; then three a segment, the angular velocity w_PB_B of that
/// joint written in its own frame B (so that q_PB moves as q_PB * exp(w dt)). Rows: velocity of the
/// point in W [m/s].
/// @param segment  the segment the point is fixed to
/// @param p_BQ     the point in that segment's frame [m]
/// @param J        out: 3 x (3 + 3 * segments), sized by the caller; all of it is written
void position_jacobian(const Skeleton& skeleton, std::span<const Eigen::Isometry3d> X_WB,
                       std::size_t segment, const Eigen::Vector3d& p_BQ,
                       Eigen::Ref<Eigen::Matrix3Xd> J) noexcept;

/// As position_jacobian, for the segment's angular velocity in W [rad/s].
void orientation_jacobian(const Skeleton& skeleton, std::span<const Eigen::Isometry3d> X_WB,
                          std::size_t segment, Eigen::Ref<Eigen::Matrix3Xd> J) noexcept;

/// The whole body's centre of mass in W [m]: the mean of the segments' weighted by mass_fraction;
/// the root's origin for a skeleton without masses.
Eigen::Vector3d centre_of_mass(const Skeleton& skeleton,
                               std::span<const Eigen::Isometry3d> X_WB) noexcept;

}  // namespace secondskin
