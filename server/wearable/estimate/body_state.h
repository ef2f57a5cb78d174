#pragma once

#include <Eigen/Geometry>
#include <span>
#include <vector>

#include "server/wearable/estimate/body_layout.h"

/// The filter's state and how time changes it. docs/wearable-filter.md has the equations.
///
/// Rotations are unit quaternions; their errors are rotation vectors in the segment's own frame,
/// q = q_estimate * exp(error), so that nothing is singular.
namespace secondskin::server {

/// A joint's rotation and its derivatives in the segment's frame.
struct GroupState {
  Eigen::Quaterniond q = Eigen::Quaterniond::Identity();  ///< q_PB (q_WR of the root)
  Eigen::Vector3d w = Eigen::Vector3d::Zero();            ///< w_PB_B [rad/s]
  Eigen::Vector3d dw = Eigen::Vector3d::Zero();           ///< its derivative [rad/s^2]
};

struct BoardState {
  Eigen::Quaterniond q_BS = Eigen::Quaterniond::Identity();  ///< mounting
  Eigen::Vector3d gyro_bias = Eigen::Vector3d::Zero();
  Eigen::Vector3d accel_bias = Eigen::Vector3d::Zero();
};

struct BodyState {
  Eigen::Vector3d p = Eigen::Vector3d::Zero();  ///< p_WR [m]
  Eigen::Vector3d v = Eigen::Vector3d::Zero();
  Eigen::Vector3d a = Eigen::Vector3d::Zero();
  std::vector<GroupState> groups;
  std::vector<BoardState> boards;
  double sound = 1.0;  ///< true speed of sound over the assumed one
};

/// How the error of one group's rotation after a time follows from the errors before:
/// e(t) = turn * e + jacobian * (t * e_w + t^2 / 2 * e_dw).
struct GroupTransition {
  Eigen::Matrix3d turn;
  Eigen::Matrix3d jacobian;
};

/// A group a time later (or, if negative, earlier) at constant acceleration.
GroupState after(const GroupState& group, double time) noexcept;
GroupTransition transition(const GroupState& group, double time) noexcept;

/// Covariance of (value, rate, acceleration) after a time under white jerk of spectral density 1:
/// the Q of docs/wearable-filter.md.
Eigen::Matrix3d white_jerk(double time) noexcept;

/// Carries the whole state forward.
void propagate(BodyState& state, double time) noexcept;

/// state = state (+) error, with the columns of the layout.
void correct(const BodyLayout& layout, std::span<const double> error, BodyState& state) noexcept;

/// error with state = estimate (+) error; the inverse of correct().
void difference(const BodyLayout& layout, const BodyState& state, const BodyState& estimate,
                std::span<double> error) noexcept;

}  // namespace secondskin::server
