#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <optional>

#include "coach/align/aligner.h"
#include "coach/correct/correction.h"

/// How well was it done: errors per repetition and joint, and one total. docs/scoring.md.
namespace secondskin::coach {

struct JointScore {
  double rms = 0.0;      ///< of the angular error [rad]
  double peak = 0.0;     ///< [rad]
  double in_band = 0.0;  ///< share of the time with the error inside the tolerance, 0 to 1
};

struct RepetitionScore {
  std::uint32_t repetition = 0;  ///< from 1
  std::int64_t start_ns = 0;
  std::int64_t end_ns = 0;
  double total = 0.0;  ///< 0 to 100, higher is better
  std::uint32_t cues = 0;
  std::array<JointScore, kJointCount> joints{};
};

class RepetitionScorer {
 public:
  explicit RepetitionScorer(std::shared_ptr<const Reference> reference);

  /// Takes each frame in turn; gives the score of a repetition at the frame that ended it.
  /// @param error  from joint_errors at the aligned reference time
  /// @param cues_given  onsets so far, from the tactile mapper
  [[nodiscard]] std::optional<RepetitionScore> update(std::int64_t stamp_ns,
                                                      const AlignmentEstimate& alignment,
                                                      const JointVectors& error,
                                                      std::uint64_t cues_given) noexcept;

  /// Ends the one under way, if enough of the reference (half) was covered.
  [[nodiscard]] std::optional<RepetitionScore> finish() noexcept;

 private:
  RepetitionScore complete() noexcept;
  void clear() noexcept;

  std::shared_ptr<const Reference> reference_;
  struct Sums {
    double square = 0.0, peak = 0.0, in_band = 0.0, excess = 0.0;
  };
  std::array<Sums, kJointCount> sums_{};
  std::uint64_t frames_ = 0;
  std::uint32_t repetitions_ = 0;  ///< completed so far
  std::int64_t start_ns_ = 0, last_ns_ = 0;
  double covered_from_ = 0.0, covered_to_ = 0.0;
  std::uint64_t cues_at_start_ = 0, cues_now_ = 0;
};

}  // namespace secondskin::coach
