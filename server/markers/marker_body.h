#pragma once

#include <string>
#include <vector>

#include "motion/markers.h"
#include "server/markers/marker_set.h"

/// A wearer's own body and where the markers sit on it, found from a trial by bundle adjustment:
/// lengths, places and poses together, with what anatomy expects as the prior. docs/skeleton.md has
/// the model. Frames: W the world, z up; B a canonical segment.
namespace secondskin::server {

/// One marker of the trial on the wearer.
struct Attachment {
  std::size_t marker = 0;  ///< its index among the trial's markers
  std::string name;        ///< as in the trial
  Joint segment{};
  Eigen::Vector3d p_BM = Eigen::Vector3d::Zero();  ///< [m]
  double sigma = 0.008;  ///< of each coordinate: skin and measurement together [m]
};

/// The wearer. Immutable once calibrated; serves any number of fits.
struct MarkerBody {
  Skeleton skeleton;  ///< canonical, the wearer's lengths
  std::vector<Attachment> attachments;
};

/// How one marker fared in the calibration.
struct MarkerReport {
  std::string name;
  double visible = 0.0;   ///< share of the trial's frames
  double residual = 0.0;  ///< RMS distance from its place on the fitted body [m]
  std::string suspicion;  ///< empty, or what looks wrong with it. Where the body fits much better
                          ///< with two markers' names exchanged, both are taken for each other,
                          ///< and it says so
};

struct BodyCalibration {
  MarkerBody body;
  std::vector<MarkerReport> markers;  ///< one per attachment
  double residual = 0.0;              ///< RMS over all markers and frames [m]
  bool stood_upright = false;         ///< whether a moment of upright standing gave the zero of the
                                      ///< angles; else the average body did
};

/// @param trial     any movement; more movement makes better joint centres
/// @param standing  optionally a trial of the same markers on the same wearer that stands upright
/// @throws std::runtime_error naming what is missing: too few of the set's markers, no frame that
///         shows enough of them, a body upside down (wrong up axis), no person's size (wrong unit),
///         markers that are on no body of this kind.
BodyCalibration calibrate_body(const MarkerSet& set, const MarkerMotion& trial,
                               const MarkerMotion* standing = nullptr);

}  // namespace secondskin::server
