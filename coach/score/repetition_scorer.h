#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <optional>

#include "coach/align/aligner.h"
#include "coach/correct/correction.h"
#include "coach/score/joint_movement.h"
#include "coach/score/posture.h"

/// How well was it done: figures per repetition and joint, and one total. docs/scoring.md.
namespace secondskin::coach {

/// Without meaning for a joint that was never measured.
struct JointScore {
  bool measured = false;
  double rms = 0.0;      ///< of the angular error [rad]
  double peak = 0.0;     ///< [rad]
  double in_band = 0.0;  ///< share of the time with the error inside the tolerance, 0 to 1
  std::optional<double> timing_error;  ///< [s], positive: late; empty without movement
  std::optional<double> smoothness;    ///< spectral arc length; empty without movement
  double range = 0.0;                  ///< about the expert's main axis [rad]
  double reference_range = 0.0;        ///< the expert's own [rad]
};

struct RepetitionScore {
  std::uint32_t repetition = 0;  ///< from 1
  std::int64_t start_ns = 0;
  std::int64_t end_ns = 0;
  double total = 0.0;  ///< 0 to 100, higher is better
  /// Shares of it lost, 0 to 1, by Criterion; the last is for the joints by themselves. Empty where
  /// nothing of it was measured or has weight.
  std::array<std::optional<double>, kCriterionCount + 1> lost{};
  std::uint32_t cues = 0;
  std::array<JointScore, kJointCount> joints{};
};

/// The posture of a repetition against the experts': what each criterion loses. Sums only.
class PostureScorer {
 public:
  explicit PostureScorer(const Reference& reference);

  /// @param time  since the repetition began [s]
  void update(double time, double reference_time, const Pose& pose) noexcept;

  /// Mean cost of a criterion's features, 0 to 1; empty where none was measured or has weight.
  std::optional<double> lost(Criterion criterion) const noexcept;

  /// How much a criterion counts: as much as the joint of it that counts most.
  double weight(Criterion criterion) const noexcept;

  void clear() noexcept;

 private:
  struct Sums {
    double count = 0.0, deviation = 0.0, change = 0.0;  // the latter two are costs
    double least = 0.0, greatest = 0.0;
    double start = 0.0, start_count = 0.0;
  };
  PostureModel model_;
  std::array<double, kPostureCount> weight_{};
  std::array<Sums, kPostureCount> sums_{};
};

class RepetitionScorer {
 public:
  explicit RepetitionScorer(std::shared_ptr<const Reference> reference);

  /// Takes each frame in turn; gives the score of a repetition at the frame that ended it.
  /// @param pose   the learner's, canonical and valid
  /// @param error  from joint_errors at the aligned reference time
  /// @param cues_given  onsets so far, from the tactile mapper
  /// No allocation.
  [[nodiscard]] std::optional<RepetitionScore> update(std::int64_t stamp_ns, const Pose& pose,
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
    double count = 0.0, square = 0.0, peak = 0.0, in_band = 0.0, cost = 0.0;
    Eigen::Vector3d start = Eigen::Vector3d::Zero();  // errors of the first moments
    double start_count = 0.0;
  };
  std::array<Sums, kJointCount> sums_{};
  PostureScorer posture_;
  JointMovement movement_;
  std::uint64_t frames_ = 0;
  std::uint32_t repetitions_ = 0;  ///< completed so far
  std::int64_t start_ns_ = 0, last_ns_ = 0;
  double covered_from_ = 0.0, covered_to_ = 0.0;
  std::uint64_t cues_at_start_ = 0, cues_now_ = 0;
};

}  // namespace secondskin::coach
