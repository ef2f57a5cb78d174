#include "sim/wearable/acoustic_shadow.h"

#include <algorithm>
#include <cmath>

namespace secondskin::sim {
namespace {

struct Closest {
  double s;         // on the way, 0 at its beginning, 1 at its end
  double distance;  // of way and axis [m]
};

// Closest points of two line segments. Ericson, "Real-Time Collision Detection" (2005), 5.1.9.
Closest closest(const Eigen::Vector3d& p1, const Eigen::Vector3d& d1, const Eigen::Vector3d& p2,
                const Eigen::Vector3d& d2) noexcept {
  const Eigen::Vector3d r = p1 - p2;
  const double a = std::max(d1.squaredNorm(), 1e-12), e = std::max(d2.squaredNorm(), 1e-12);
  const double b = d1.dot(d2), c = d1.dot(r), f = d2.dot(r);
  const double denominator = a * e - b * b;
  double s = denominator > 1e-12 ? std::clamp((b * f - c * e) / denominator, 0.0, 1.0) : 0.0;
  double t = (b * s + f) / e;
  if (t < 0.0) {
    t = 0.0;
    s = std::clamp(-c / a, 0.0, 1.0);
  } else if (t > 1.0) {
    t = 1.0;
    s = std::clamp((b - c) / a, 0.0, 1.0);
  }
  return {s, (r + s * d1 - t * d2).norm()};
}

double distance_to_axis(const Eigen::Vector3d& p, const Limb& limb) noexcept {
  const Eigen::Vector3d axis = limb.p_WE - limb.p_WA;
  const double length2 = std::max(axis.squaredNorm(), 1e-12);
  const double t = std::clamp((p - limb.p_WA).dot(axis) / length2, 0.0, 1.0);
  return (p - limb.p_WA - t * axis).norm();
}

}  // namespace

Shadow acoustic_shadow(const Eigen::Vector3d& p_WU, const Eigen::Vector3d& p_WS,
                       std::span<const Limb> limbs, double wavelength) noexcept {
  Shadow shadow;
  const Eigen::Vector3d way = p_WS - p_WU;
  const double length = way.norm();
  if (!(length > 0.0)) return shadow;
  // Beyond this, ITU-R P.526 has no loss: nu = -0.78.
  const double widest = 0.78 * std::sqrt(wavelength * length / 8.0);
  for (const Limb& limb : limbs) {
    const Eigen::Vector3d axis = limb.p_WE - limb.p_WA;
    const Closest at = closest(p_WU, way, limb.p_WA, axis);
    if (at.s <= 0.0 || at.s >= 1.0 || at.distance > limb.radius + widest) continue;
    const double radius =
        std::min({limb.radius, distance_to_axis(p_WU, limb), distance_to_axis(p_WS, limb)});
    const double height = radius - at.distance;
    const double before = at.s * length, after = (1.0 - at.s) * length;
    const double nu = height * std::sqrt(2.0 * length / (wavelength * before * after));
    if (nu <= -0.78) continue;
    // J(nu) = 6.9 + 20 lg(sqrt((nu - 0.1)^2 + 1) + nu - 0.1) dB.
    const double x = nu - 0.1;
    shadow.amplitude *= std::min(1.0, std::pow(10.0, -6.9 / 20.0) / (std::sqrt(x * x + 1.0) + x));
    if (height > 0.0) {
      shadow.detour += std::hypot(before, height) + std::hypot(after, height) - length;
    }
  }
  return shadow;
}

}  // namespace secondskin::sim
