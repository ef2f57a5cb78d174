#include "server/optical/calibrate/triangulation.h"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <algorithm>
#include <array>
#include <cmath>

namespace secondskin::server {
namespace {

using Skip = std::array<std::size_t, 2>;
constexpr std::size_t kNone = static_cast<std::size_t>(-1);

bool skipped(const Skip& skip, std::size_t k) { return k == skip[0] || k == skip[1]; }

// 2.2.3, each row scaled to a distance, then Gauss-Newton on the counts.
std::optional<Triangulation> solve(const ProjectorRig& rig, std::span<const Sighting> sightings,
                                   const Skip& skip) {
  Eigen::Matrix3d A = Eigen::Matrix3d::Zero();
  Eigen::Vector3d b = Eigen::Vector3d::Zero();
  std::size_t n = 0;
  for (std::size_t k = 0; k < sightings.size(); ++k) {
    const auto& projector = rig.projectors[sightings[k].projector];
    if (!projector || skipped(skip, k)) continue;
    const Plane plane = projector->plane(sightings[k].value);
    const double w = 1.0 / plane.a.squaredNorm();
    A += w * plane.a * plane.a.transpose();
    b += w * plane.b * plane.a;
    ++n;
  }
  if (n < 4) return std::nullopt;
  Triangulation out;
  out.p_W = A.ldlt().solve(b);
  for (int iteration = 0; iteration < 5; ++iteration) {
    A.setZero();
    b.setZero();
    for (std::size_t k = 0; k < sightings.size(); ++k) {
      const auto& projector = rig.projectors[sightings[k].projector];
      if (!projector || skipped(skip, k)) continue;
      const Eigen::RowVector3d J = projector->gradient(out.p_W);
      const double r = projector->value(out.p_W) - sightings[k].value;
      A += J.transpose() * J;
      b += J.transpose() * r;
    }
    const Eigen::Vector3d step = A.ldlt().solve(b);
    if (!step.allFinite()) return std::nullopt;
    out.p_W -= step;
    if (step.squaredNorm() < 1e-12) break;
  }
  // Four planes that nearly share a line give no point: the worst direction's lever.
  if (Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d>(A, Eigen::EigenvaluesOnly).eigenvalues()[0] <
      1e-6 * A.trace()) {
    return std::nullopt;
  }
  for (const Sighting& s : sightings) {
    const auto& projector = rig.projectors[s.projector];
    if (projector && std::fabs(projector->value(out.p_W) - s.value) <= kFits) ++out.fitting;
  }
  return out;
}

}  // namespace

std::optional<Triangulation> triangulate(const ProjectorRig& rig,
                                         std::span<const Sighting> sightings) {
  const auto all = solve(rig, sightings, {kNone, kNone});
  if (!all) return std::nullopt;
  const auto n = static_cast<std::size_t>(
      std::count_if(sightings.begin(), sightings.end(),
                    [&](const Sighting& s) { return rig.projectors[s.projector].has_value(); }));
  if (all->fitting == n) return all;
  std::optional<Triangulation> best;
  // With one left out, the others must agree on more than a place alone: five at least.
  for (std::size_t out = 1; out <= 2 && n >= 5 + out - 1; ++out) {
    for (std::size_t i = 0; i < sightings.size(); ++i) {
      if (!rig.projectors[sightings[i].projector]) continue;
      for (std::size_t j = out == 1 ? kNone : i + 1; j == kNone || j < sightings.size(); ++j) {
        if (j != kNone && !rig.projectors[sightings[j].projector]) continue;
        const auto trial = solve(rig, sightings, {i, j});
        if (trial && trial->fitting >= n - out && (!best || trial->fitting > best->fitting)) {
          best = trial;
        }
        if (j == kNone) break;
      }
    }
    if (best) return best;
  }
  return best;
}

}  // namespace secondskin::server
