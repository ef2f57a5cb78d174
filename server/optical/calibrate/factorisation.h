#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "server/optical/projector.h"

/// Places and projectors from nothing but what unknown points received: the start of a wand
/// calibration without any guess.
///
/// A 1-D projector is a 2 x 4 matrix, so points and matrices are a rank-4 factorisation up to a
/// projective map of space. It is found by variable projection on the algebraic residuals with a
/// weak wish for equal depths (Hong and Zach, "pOSE: Pseudo Object Space Error for
/// Initialization-Free Bundle Adjustment", CVPR 2018), from random starts; a projector's known
/// field and middle then give the absolute dual quadric (Triggs 1997), whose rank-3 factor makes
/// the map a similarity. What remains unknown is scale, place, and which of the two mirror images
/// is true: a 1-D projector cannot tell them apart. docs/projector-calibration.md derives it.
namespace secondskin::server {

/// One point's value from one projector.
struct Sighting {
  std::size_t projector;
  double value;  ///< [counts]
};

/// What a projector is by design; each one differs a little.
struct NominalOptics {
  double focal = 477.7;   ///< dv / dtan(angle) in the middle: 256 counts over 30 degrees (2.3)
  double middle = 127.5;  ///< the value on its axis: of 256 stripes, from 0 [counts]
};

/// Projectors and points in a frame that differs from the world by a similarity and perhaps a
/// mirror.
struct Reconstruction {
  ProjectorRig rig;                                    ///< empty where a projector saw too little
  std::vector<std::optional<Eigen::Vector3d>> points;  ///< one a point given; empty where it has
                                                       ///< fewer than four of these projectors
  double residual = 0.0;                               ///< median of |value - predicted| [counts]
};

/// @param points      per point its sightings; those with fewer than four are left out
/// @param projectors  how many there are; one with fewer than 20 sightings is left out
/// @param guess       a first start before the random ones; null for none
/// @param seed        of the random starts: equal seeds give equal results
/// @return nothing when no start led to points in front of all projectors.
std::optional<Reconstruction> factorise(std::span<const std::vector<Sighting>> points,
                                        std::size_t projectors, const NominalOptics& optics,
                                        const ProjectorRig* guess, std::uint64_t seed);

}  // namespace secondskin::server
