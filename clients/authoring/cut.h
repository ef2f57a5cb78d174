#pragma once

#include <vector>

#include "motion/motion.h"

/// Where the repetitions are in a performance that nobody has described: no reference is needed.
/// docs/references.md has the equations. Pure; takes of a minute need a tenth of a second.
namespace secondskin::authoring {

/// A stretch of a motion [s].
struct Span {
  double start = 0.0;
  double end = 0.0;

  double duration() const noexcept { return end - start; }
};

struct Cutting {
  Span moving;                    ///< without the rest before and after
  std::vector<Span> repetitions;  ///< in order, not overlapping; one, `moving`, where none repeats
  /// How alike they are: 0 equal, 1 as far apart as any two poses of the motion are typically.
  double difference = 0.0;
};

/// Finds the movement that is repeated: the body leaves a posture and comes back to it, each time
/// in the same way; with pauses or without. What else is in the motion (walking off, another
/// exercise) is left out. A motion in which nobody moves is one repetition as a whole.
/// @throws std::invalid_argument unless the motion is canonical and lasts 0.5 s to kLongestTake.
Cutting cut(const Motion& canonical);

/// More would need a quadratic lot of memory.
inline constexpr double kLongestTake = 300.0;  ///< [s]
inline constexpr double kShortestTake = 0.5;   ///< [s]

}  // namespace secondskin::authoring
