#pragma once

#include <array>
#include <vector>

#include "motion/anatomy.h"
#include "motion/motion.h"

/// A recorded motion as a curve that has velocities and accelerations everywhere.
///
/// Motion capture is noisy: its second differences are not accelerations. The poses are low-passed
/// (Gaussian) and become the control points of uniform cubic B-splines: of the root's position, and
/// of each joint's quaternion in R^4, normalised afterwards, so that position and orientation are
/// twice continuously differentiable and every derivative is exact. With r the curve in R^4:
///   q = r / |r|,  w = 2 Im(r* r') / |r|^2,  dw/dt = 2 Im(r* r'') / |r|^2 - 2 w (r . r') / |r|^2.
///
/// Frames: W the world, z up; B a segment; P its parent.
namespace secondskin::sim {

/// Values of the four cubic B-splines that reach a point, and their derivatives in u, 0 <= u < 1.
struct SplineWeights {
  explicit SplineWeights(double u) noexcept;
  std::array<double, 4> value, first, second;
};

/// A segment's state of motion, all in W.
struct SegmentMotion {
  Eigen::Isometry3d X_WB = Eigen::Isometry3d::Identity();
  Eigen::Vector3d v = Eigen::Vector3d::Zero();      ///< of B's origin [m/s]
  Eigen::Vector3d a = Eigen::Vector3d::Zero();      ///< of B's origin [m/s^2]
  Eigen::Vector3d w = Eigen::Vector3d::Zero();      ///< angular velocity [rad/s]
  Eigen::Vector3d alpha = Eigen::Vector3d::Zero();  ///< angular acceleration [rad/s^2]
};
using BodyMotion = std::array<SegmentMotion, kJointCount>;

class SmoothMotion {
 public:
  /// The body first stands for `rest` seconds in the canonical rest pose at x = y = 0 facing +x,
  /// moves into the motion's first pose within `blend` seconds, and then goes as the motion does,
  /// which is turned about the vertical and moved on the floor to fit. The motion speeds up from
  /// standing and slows down to it over half a second.
  /// @param cutoff_hz  of the Gaussian, where it halves the power
  /// @throws std::invalid_argument unless the motion is canonical and has poses, and times are >= 0
  SmoothMotion(const Motion& canonical, double rest, double blend, double cutoff_hz = 12.0);

  double duration() const noexcept { return duration_; }
  const Skeleton& skeleton() const noexcept { return skeleton_; }
  /// Height of the floor: of the lowest point of the feet in the motion's first pose [m].
  double floor() const noexcept { return floor_; }

  /// The pose at a time [s], held at both ends. No allocation when `out` has the size.
  void pose_at(double time, Pose& out) const;
  /// How every segment moves. No allocation.
  void at(double time, BodyMotion& out) const noexcept;

 private:
  struct Control {
    Eigen::Vector3d p_WR;
    std::array<Eigen::Vector4d, kJointCount> q;  ///< x, y, z, w
  };
  struct Span {
    std::size_t first;
    SplineWeights weights;
  };
  Span span(double time) const noexcept;

  Skeleton skeleton_;
  double floor_ = 0.0;
  double duration_ = 0.0;
  std::vector<Control> controls_;  ///< one before time 0, two after the end
};

}  // namespace secondskin::sim
