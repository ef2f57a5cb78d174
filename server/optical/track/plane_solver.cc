#include "server/optical/track/plane_solver.h"

#include <Eigen/LU>
#include <algorithm>
#include <cassert>
#include <cmath>

namespace secondskin::server {
namespace {

// A direction that the planes see a million times worse than the others is open. In the normal
// matrix that is a determinant 1e-12 of that of evenly spread planes.
constexpr double kOpen = 1e-12;

struct Solution {
  PlanePoint point;
  Eigen::Matrix3d inverse;  // (A'A)^-1
};

// The least squares point of the planes that take(i) says.
template <class Take>
std::optional<Solution> solve(std::span<const Plane> planes, const Take& take) noexcept {
  Eigen::Matrix3d N = Eigen::Matrix3d::Zero();
  Eigen::Vector3d c = Eigen::Vector3d::Zero();
  std::size_t rows = 0;
  for (std::size_t i = 0; i < planes.size(); ++i) {
    if (!take(i)) continue;
    N += planes[i].a * planes[i].a.transpose();
    c += planes[i].a * planes[i].b;
    ++rows;
  }
  if (rows < kFewestPlanes) return std::nullopt;
  const double scale = N.trace() / 3.0;
  if (!(N.determinant() > kOpen * scale * scale * scale)) return std::nullopt;  // NaN ends here too
  Solution s;
  s.inverse = N.inverse();
  s.point.p_W = s.inverse * c;
  double squares = 0.0;
  for (std::size_t i = 0; i < planes.size(); ++i) {
    if (!take(i)) continue;
    const double r = planes[i].a.dot(s.point.p_W) - planes[i].b;
    squares += r * r;
  }
  if (!std::isfinite(squares)) return std::nullopt;
  s.point.residual_norm = std::sqrt(squares);
  s.point.sigma = std::sqrt(s.inverse.trace() * squares / static_cast<double>(rows - 3));
  s.point.rows = rows;
  return s;
}

}  // namespace

std::optional<PlanePoint> intersect(std::span<const Plane> planes) noexcept {
  const auto s = solve(planes, [](std::size_t) { return true; });
  if (!s) return std::nullopt;
  return s->point;
}

std::optional<PlanePoint> intersect_filtered(std::span<const Plane> planes, double limit,
                                             std::span<std::uint8_t> used) noexcept {
  assert(used.size() == planes.size());
  std::fill(used.begin(), used.end(), std::uint8_t{1});
  while (true) {
    const auto s = solve(planes, [&](std::size_t i) { return used[i] != 0; });
    if (!s) return std::nullopt;
    if (s->point.residual_norm < limit) return s->point;
    if (s->point.rows <= kFewestPlanes) return std::nullopt;
    std::size_t worst = planes.size();
    double most = -1.0;
    for (std::size_t i = 0; i < planes.size(); ++i) {
      if (used[i] == 0) continue;
      const double r = planes[i].a.dot(s->point.p_W) - planes[i].b;
      const double open = 1.0 - planes[i].a.dot(s->inverse * planes[i].a);
      if (open < 1e-9) continue;  // without this row the others leave a direction open
      if (const double gain = r * r / open; gain > most) {
        most = gain;
        worst = i;
      }
    }
    if (worst == planes.size()) return std::nullopt;
    used[worst] = 0;
  }
}

}  // namespace secondskin::server
