#pragma once

#include <array>
#include <span>
#include <vector>

#include "motion/anatomy.h"
#include "motion/motion.h"

/// One motion out of several performances of it: DTW barycentre averaging (Petitjean et al. 2011,
/// Pattern Recognition 44:678) with means on SO(3). docs/alignment.md, section 6.
namespace secondskin::coach {

struct ExpertAverage {
  Motion motion;  ///< at the rate asked for; timing is the mean of the experts' timings
  /// Standard deviation of the experts' orientations from the mean, by frame and joint [rad]; of
  /// the pelvis that of its tilt. 0 for a joint that fewer than two experts show.
  std::vector<std::array<double, kJointCount>> spread;
};

/// A joint that an expert does not show (confidence 0) is averaged over the others. Place and
/// heading are the first expert's, and so is the skeleton.
/// @param experts  canonical, whole performances of the same motion; at least one
/// @param weight   how much each joint counts when the performances are warped onto each other
/// @throws std::invalid_argument for none, or one that is not canonical.
ExpertAverage average_experts(std::span<const Motion> experts,
                              const std::array<double, kJointCount>& weight, double rate_hz);

/// Where in b each frame of a is, by full dynamic time warping of the whole of both (slopes 0 to
/// infinity), smoothed over 0.1 s. Poses and velocities are compared. Monotone.
/// @returns frames of b, one for each of a.
std::vector<double> warp_onto(const Motion& a, const Motion& b,
                              const std::array<double, kJointCount>& weight);

}  // namespace secondskin::coach
