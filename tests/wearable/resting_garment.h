#pragma once

#include "tests/wearable/drawn_body.h"

/// What a garment measures on a body that stands in the canonical rest pose.
namespace secondskin::server {

inline Measurement resting_inertial(const Garment& garment, std::span<const Eigen::Isometry3d> X_BS,
                                    std::int64_t stamp_ns) {
  Measurement m;
  m.kind = MeasurementKind::kInertial;
  m.stamp_ns = stamp_ns;
  m.boards.resize(garment.boards.size());
  for (std::size_t b = 0; b < m.boards.size(); ++b) {
    m.boards[b].accel = X_BS[b].linear().transpose() * kGravity;
    m.boards[b].gyro_valid = m.boards[b].accel_valid = true;
  }
  return m;
}

}  // namespace secondskin::server
