#pragma once

#include <Eigen/Core>
#include <optional>
#include <span>
#include <vector>

#include "server/optical/calibrate/factorisation.h"
#include "server/optical/projector.h"

namespace secondskin::server {

/// A place that explains its sightings.
struct Triangulation {
  Eigen::Vector3d p_W;
  std::size_t fitting = 0;  ///< sightings within kFits of it
};

/// A sighting fits a place when it is no further from it than this [counts].
inline constexpr double kFits = 3.0;

/// The point of least squares in counts, one or two wild sightings left out where enough remain:
/// at least four fit, and all but two. For calibration; the tracker has its own.
std::optional<Triangulation> triangulate(const ProjectorRig& rig,
                                         std::span<const Sighting> sightings);

}  // namespace secondskin::server
