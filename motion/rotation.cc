#include "motion/rotation.h"

#include <cmath>
#include <numbers>

namespace secondskin {
namespace {

// Below this the power series are exact to double precision where the closed forms lose digits.
constexpr double kSmallAngle = 1e-4;

}  // namespace

Eigen::Vector3d rotation_vector(const Eigen::Quaterniond& q) noexcept {
  // q and -q are one orientation; the one with w >= 0 is the shorter way.
  const double sign = q.w() < 0.0 ? -1.0 : 1.0;
  const double w = sign * q.w();
  const Eigen::Vector3d v = sign * q.vec();
  const double sine = v.norm();  // sin(angle / 2)
  if (sine < kSmallAngle) return v * (2.0 / w) * (1.0 - sine * sine / (3.0 * w * w));
  return v * (2.0 * std::atan2(sine, w) / sine);
}

Eigen::Quaterniond quaternion_from(const Eigen::Vector3d& rotation_vector) noexcept {
  const double squared = rotation_vector.squaredNorm();
  const double angle = std::sqrt(squared);
  const double half_sinc =
      angle < kSmallAngle ? 0.5 - squared / 48.0 : std::sin(0.5 * angle) / angle;
  const Eigen::Vector3d v = half_sinc * rotation_vector;
  return {std::cos(0.5 * angle), v.x(), v.y(), v.z()};
}

double geodesic_distance(const Eigen::Quaterniond& a, const Eigen::Quaterniond& b) noexcept {
  const Eigen::Quaterniond d = a.conjugate() * b;
  return 2.0 * std::atan2(d.vec().norm(), std::abs(d.w()));
}

double twist_angle(const Eigen::Quaterniond& q, const Eigen::Vector3d& axis) noexcept {
  const double sine = q.vec().dot(axis);
  const double angle =
      q.w() < 0.0 ? 2.0 * std::atan2(-sine, -q.w()) : 2.0 * std::atan2(sine, q.w());
  return angle > -std::numbers::pi ? angle : std::numbers::pi;
}

Eigen::Matrix3d right_jacobian(const Eigen::Vector3d& v) noexcept {
  const double squared = v.squaredNorm();
  const double angle = std::sqrt(squared);
  const Eigen::Matrix3d cross = cross_matrix(v);
  const double a = angle < 1e-3 ? 0.5 - squared / 24.0 : (1.0 - std::cos(angle)) / squared;
  const double b =
      angle < 1e-3 ? 1.0 / 6.0 - squared / 120.0 : (angle - std::sin(angle)) / (squared * angle);
  return Eigen::Matrix3d::Identity() - a * cross + b * cross * cross;
}

Eigen::Matrix3d right_jacobian_inverse(const Eigen::Vector3d& rotation_vector) noexcept {
  const double squared = rotation_vector.squaredNorm();
  const double angle = std::sqrt(squared);
  // Sola's (1 + cos a) / (2 a sin a) is cot(a / 2) / (2 a), which is regular at a = pi.
  const double factor = angle < 1e-2 ? 1.0 / 12.0 + squared / 720.0 + squared * squared / 30240.0
                                     : 1.0 / squared - 0.5 / (angle * std::tan(0.5 * angle));
  const Eigen::Matrix3d cross = cross_matrix(rotation_vector);
  return Eigen::Matrix3d::Identity() + 0.5 * cross + factor * cross * cross;
}

}  // namespace secondskin
