#pragma once

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <numbers>
#include <random>
#include <span>
#include <vector>

#include "server/optical/projector.h"
#include "server/optical/projector_frame.h"
#include "wire/photo_tag.h"

namespace secondskin::server {

/// Sixteen projectors in perpendicular pairs on a circle of 22 feet, 30 degrees wide, at 1 m, that
/// look at its middle (Second Skin, 2.3).
inline ProjectorRig ring_rig() {
  ProjectorRig rig;
  for (int i = 0; i < 16; ++i) {
    const double azimuth = 2.0 * std::numbers::pi * (i / 2) / 8.0;
    const Eigen::Vector3d z(-std::cos(azimuth), -std::sin(azimuth), 0.0);
    const Eigen::Vector3d up = Eigen::Vector3d::UnitZ(), side = up.cross(z);
    const Eigen::Vector3d x = i % 2 == 0 ? side : up;
    const Eigen::Vector3d p_WJ = -3.3528 * z + 1.0 * up;
    // h is the distance along z, v = 128 + 128 (x / h) / tan(15 degrees).
    Eigen::Matrix<double, 2, 4> P;
    P.row(1) << z.transpose(), -z.dot(p_WJ);
    P.row(0) << x.transpose(), -x.dot(p_WJ);
    P.row(0) *= 128.0 / std::tan(std::numbers::pi / 12.0);
    P.row(0) += 128.0 * P.row(1);
    rig.projectors.push_back(Projector{P / P(1, 3)});
  }
  return rig;
}

/// What a detector reads that sees the projectors that `sees` says.
/// @param path  where it is at a time from the beginning [s]
template <class Path, class Sees>
void read_values(const ProjectorRig& rig, const Path& path, std::uint64_t cycle, double sigma,
                 std::mt19937& random, std::size_t detector, const Sees& sees,
                 ProjectorFrame& frame) {
  std::normal_distribution<double> normal;
  frame.cycle = cycle;
  frame.stamp_ns = static_cast<std::int64_t>(cycle) * wire::cycle_ns(rig.size());
  for (std::size_t p = 0; p < rig.size(); ++p) {
    std::uint8_t& value = frame.values[detector * rig.size() + p];
    value = wire::kNoValue;
    if (!sees(p)) continue;
    const double time = 1e-9 * static_cast<double>(frame.stamp_ns + wire::value_time_ns(p));
    const double v = rig.projectors[p]->value(path(time)) + sigma * normal(random);
    value = static_cast<std::uint8_t>(std::clamp(std::lround(v), 1L, 254L));
  }
}

inline bool sees_all(std::size_t) { return true; }

/// Six projectors, three pairs side by side: what a detector on a body sees.
inline bool sees_front(std::size_t p) { return p < 4 || p >= 14; }

}  // namespace secondskin::server
