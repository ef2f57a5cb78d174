#pragma once

#include <memory>
#include <span>
#include <vector>

#include "coach/score/repetition_scorer.h"

/// Scores recordings with the scorer of the live coach.
namespace secondskin::coach {

struct OfflineScore {
  std::vector<RepetitionScore> repetitions;
  bool mirrored = false;  ///< done, and scored, as in a mirror: Reference::either_side allows it
};

/// As the live coach would have: the aligner finds the repetitions.
/// @param poses  canonical and in the order of their stamps, which start above 0
OfflineScore score_recording(const std::shared_ptr<const Reference>& reference,
                             std::span<const StampedPose> poses);

/// For a recording cut to exactly one repetition, however badly it was done: all of it is warped
/// onto all of the reference (warp_onto), each end to its end. None for fewer than two poses.
OfflineScore score_whole(const std::shared_ptr<const Reference>& reference,
                         std::span<const StampedPose> poses);

}  // namespace secondskin::coach
