#pragma once

#include <cstddef>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "server/optical/calibrate/value_sync.h"
#include "server/optical/projector.h"

/// Does a calibration still hold? From the values of anything that moves in the volume: a suit, the
/// wand, the grid.
///
/// Values are synchronised, places triangulated, and each projector compared with the places that
/// the others give. A projector that stands out is left out; then either its values belong to
/// another one's slot, or it has moved. Detectors that stand in each other's place in the
/// configuration show where distances between them are known.
namespace secondskin::server {

/// Two detectors on one rigid part.
struct KnownDistance {
  std::size_t a, b;
  double distance;  ///< [m]
};

enum class ProjectorState {
  kGood,
  kUnseen,        ///< too few values to tell
  kUncalibrated,  ///< not in the rig
  kMoved,         ///< its values fit no calibrated projector
  kExchanged      ///< its values are those of another slot
};

struct CheckedProjector {
  ProjectorState state = ProjectorState::kUnseen;
  std::size_t sightings = 0;  ///< values at places that the good projectors give
  double residual = 0.0;      ///< median of |value - predicted| [counts]
  std::size_t slot = 0;       ///< kExchanged: whose values it receives
};

struct RigReport {
  std::vector<CheckedProjector> projectors;  ///< by slot
  /// Pairs of detectors that stand in each other's place.
  std::vector<std::pair<std::size_t, std::size_t>> exchanged_detectors;
  double distance_rms = 0.0;          ///< of the known distances' medians [m]
  std::vector<std::string> findings;  ///< one sentence each; empty when all is well
};

/// Not for several threads at once.
class RigCheck {
 public:
  /// @param distances  may be empty
  /// @throws std::invalid_argument when a distance names no detector
  RigCheck(ProjectorRig rig, std::size_t detectors, std::vector<KnownDistance> distances = {});

  /// @throws as ValueSync::add()
  void add(const ProjectorFrame& frame);

  /// What all frames so far say; empty while there are too few places (kLeastPlaces).
  std::optional<RigReport> report() const;

  static constexpr std::size_t kLeastPlaces = 50;

 private:
  ProjectorRig rig_;
  std::size_t detectors_;
  std::vector<KnownDistance> distances_;
  ValueSync sync_;
  std::size_t stride_ = 1;  ///< of the synchronised frames every so many-th is kept
  std::size_t count_ = 0;
  std::vector<SyncedFrame> frames_;
};

}  // namespace secondskin::server
