#pragma once

#include <cstddef>
#include <vector>

#include "coach/align/pose_features.h"

/// What the aligner knows of a reference beforehand: its path, the way that the joints go in it,
/// the neighbourhoods of its start and end, and the scales on which near is told from far.
/// docs/alignment.md, section 4. Immutable. Distances are RMS over the joints [rad].
namespace secondskin::coach {

/// Up to this the expert stands still [rad/s].
inline constexpr double kStillSpeed = 0.1396;  // 8 degrees a second

struct ReferenceMeasure {
  explicit ReferenceMeasure(const ReferenceFeatures& features, double rate_hz);

  double path_at(double position) const noexcept;  ///< @param position  [frames], clamped
  double whole() const noexcept { return path.back(); }

  /// Whether the expert's poses at two positions [frames] look much the same.
  bool alike(double a, double b) const noexcept;

  const ReferenceFeatures& features;
  double rate_hz;
  std::size_t frames;
  std::vector<double> path;    ///< by frame, from 0 [rad]
  double lost_square = 0.0;    ///< farther off is elsewhere [rad^2]
  double match_square = 0.0;   ///< near enough to begin [rad^2]
  double radius = 0.0;         ///< of the start's and the end's neighbourhood
  std::size_t start_zone = 1;  ///< frames before it look like the first
  std::size_t end_zone = 0;    ///< frames from it on look like the last
  bool cyclic = false;         ///< ends as it began
  double speed = 0.0;          ///< mean over the moving parts [rad/s]
  double resting_speed = 0.0;  ///< a learner slower than this rests [rad/s]
};

}  // namespace secondskin::coach
