#pragma once

#include <cstdint>
#include <memory>

#include "coach/reference.h"

/// Where in the reference is the learner, now? Online time warping of the live poses against the
/// reference: causal, at constant cost a frame, by weighted angular distance of the joints, so body
/// size, place and facing direction do not matter. docs/alignment.md has the equations.
namespace secondskin::coach {

enum class Phase : std::uint8_t { kWaiting, kMoving, kPaused, kFinished, kLost };

struct AlignmentEstimate {
  double reference_time = 0.0;  ///< [s]
  double tempo = 1.0;           ///< reference seconds a second; 1: as the expert, 0: standing still
  double confidence = 0.0;      ///< 0 to 1
  Phase phase = Phase::kWaiting;
  /// The one under way, from a third of it on, or the last one finished; 0 before the first. Goes
  /// back by one when the one under way is given up.
  std::uint32_t repetition = 0;
};

struct AlignerOptions {
  double window = 2.5;  ///< half width of the search about the last estimate [s]
  double min_tempo = 0.5, max_tempo = 2.0;
};

class Aligner {
 public:
  Aligner(std::shared_ptr<const Reference> reference, const AlignerOptions& options = {});
  ~Aligner();
  Aligner(Aligner&&) noexcept;

  /// Takes the next pose and says where it is. No allocation; constant cost. Poses may be dropped
  /// and stamps may jitter; a stamp not later than the last one repeats the last estimate. Joints
  /// with confidence 0 are left out of the distance; a pose that is not valid counts as dropped.
  [[nodiscard]] AlignmentEstimate update(std::int64_t stamp_ns, const Pose& learner) noexcept;

  /// Back to waiting for a start, repetition 0.
  void reset() noexcept;

  std::uint64_t dropped() const noexcept;  ///< poses refused so far

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace secondskin::coach
