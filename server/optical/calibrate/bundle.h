#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <span>
#include <vector>

#include "server/optical/calibrate/factorisation.h"
#include "server/optical/projector.h"

/// Bundle adjustment of projectors and wand places: the values in counts, the wand's known lengths
/// and a weak prior on each projector's optics, robustly (Triggs et al. 2000, "Bundle Adjustment: A
/// Modern Synthesis").
namespace secondskin::server {

/// The wand's detectors at one instant.
struct BundleFrame {
  std::vector<std::size_t> detectors;            ///< those that were placed
  std::vector<Eigen::Vector3d> points;           ///< where [m]
  std::vector<std::vector<Sighting>> sightings;  ///< what each received, synchronised
};

struct BundleSettings {
  NominalOptics optics;
  double focal_sigma = 0.1;      ///< how far a projector's focal may be from nominal, relative
  double middle_sigma = 20.0;    ///< and its middle [counts]
  double value_sigma = 0.4;      ///< of a synchronised value [counts]
  double length_sigma = 0.5e-3;  ///< of the wand's lengths as they were measured [m]
  int iterations = 40;
};

/// Moves projectors and points to the least robust cost; place and orientation of the whole stay
/// about where they were. Calibrated projectors only; a projector without sightings stays.
/// @param lengths  between detectors a and b: lengths(a, b) [m]
/// @return whether the solver ended with a usable solution.
bool adjust(ProjectorRig& rig, std::vector<BundleFrame>& frames, const Eigen::MatrixXd& lengths,
            const BundleSettings& settings);

/// How far the calibration's own uncertainty moves triangulated points: the RMS of the error that
/// is left when the whole is moved rigidly, propagated through the normal equations at the
/// solution. [m]
/// @param probes  frames whose points are asked about
double predicted_error(const ProjectorRig& rig, const std::vector<BundleFrame>& frames,
                       const BundleSettings& settings, std::span<const BundleFrame> probes);

}  // namespace secondskin::server
