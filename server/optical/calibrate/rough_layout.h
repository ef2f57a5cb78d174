#pragma once

#include <Eigen/Core>
#include <filesystem>
#include <vector>

#include "server/optical/calibrate/factorisation.h"
#include "server/optical/projector.h"

namespace secondskin::server {

/// Where a projector stands, as far as a tape measure tells.
struct RoughPlace {
  Eigen::Vector3d p_W;         ///< [m]
  Eigen::Vector3d looks_at_W;  ///< a point on its axis [m]
  /// Which way values rise, seen from the projector along its axis: 0 to the right, pi/2 upwards.
  /// [rad]
  double rising = 0.0;
};

/// A first guess at a rig, by slot; a help for the wand calibration.
struct RoughLayout {
  std::vector<RoughPlace> places;

  /// Reads a layout file (TOML): unit; [[projector]] in the order of the slots, each with
  /// position = [x, y, z], looks_at = [x, y, z], rising_deg.
  /// @throws std::runtime_error naming file, line, field and what was expected.
  static RoughLayout load(const std::filesystem::path& file);

  /// What such projectors would measure.
  ProjectorRig rig(const NominalOptics& optics) const;
};

}  // namespace secondskin::server
