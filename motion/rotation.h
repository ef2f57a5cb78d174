#pragma once

#include <Eigen/Geometry>

/// Rotations on SO(3). Quaternions are Hamilton's, of unit length; rotation vectors are axis times
/// angle [rad] with an angle of at most pi.
namespace secondskin {

/// The rotation vector of a unit quaternion: log(q), the shorter way round. Exact near identity.
Eigen::Vector3d rotation_vector(const Eigen::Quaterniond& q) noexcept;

/// The unit quaternion of a rotation vector: exp(v).
Eigen::Quaterniond quaternion_from(const Eigen::Vector3d& rotation_vector) noexcept;

/// Geodesic distance of two orientations on SO(3), 0 to pi [rad].
double geodesic_distance(const Eigen::Quaterniond& a, const Eigen::Quaterniond& b) noexcept;

/// The part of q about the unit axis, as an angle in (-pi, pi] [rad] (swing-twist, q = swing *
/// twist).
double twist_angle(const Eigen::Quaterniond& q, const Eigen::Vector3d& axis) noexcept;

/// [v]x: cross_matrix(v) * u is v.cross(u).
inline Eigen::Matrix3d cross_matrix(const Eigen::Vector3d& v) noexcept {
  Eigen::Matrix3d m;
  m << 0.0, -v.z(), v.y(), v.z(), 0.0, -v.x(), -v.y(), v.x(), 0.0;
  return m;
}

/// The right Jacobian of SO(3) at v: d log(exp(v)^-1 exp(v + e)) / d e at e = 0. Sola et al. 2018,
/// equation 143.
Eigen::Matrix3d right_jacobian(const Eigen::Vector3d& rotation_vector) noexcept;

/// The inverse of the right Jacobian of SO(3) at v: d log(exp(v) exp(e)) / d e at e = 0.
/// Sola et al. 2018, "A micro Lie theory", equation 144.
Eigen::Matrix3d right_jacobian_inverse(const Eigen::Vector3d& rotation_vector) noexcept;

}  // namespace secondskin
