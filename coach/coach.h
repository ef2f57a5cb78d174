#pragma once

#include <memory>
#include <optional>

#include "coach/align/aligner.h"
#include "coach/correct/solver_thread.h"
#include "coach/plan/feedback_schedule.h"
#include "coach/score/repetition_scorer.h"
#include "coach/tactile/tactile_mapper.h"

/// The coach's stages in a chain: a pose in; where it is, what to correct, what to vibrate out.
///
/// Pure but for the CorrectionSource, behind which the solver thinks on its own thread; given the
/// same poses and the same results at the same frames, the outputs are the same bit for bit. That
/// is how a recording is replayed.
namespace secondskin::coach {

struct CoachSettings {
  double tolerance_scale = 1.0;  ///< of the reference's tolerances
  std::uint32_t max_cues = 2;    ///< joints cued at once
};

/// A solver result is used for at most this long: the body has moved on [s].
inline constexpr double kLongestUse = 0.25;

/// The tactors' lifetime: without a newer command everything is off after it [s]. Longer than two
/// periods of the slowest useful source (30 Hz), short enough that a dead coach is felt for less
/// than 100 ms.
inline constexpr double kCommandLifetime = 0.060;

/// Corrections are asked for at most this often: people cannot follow faster [s].
inline constexpr double kCorrectionPeriod = 1.0 / 15.0;

/// What concerns the learner's skin and body rather than the exercise.
struct TactileSetup {
  bool duration_scaled = false;  ///< cues last longer, not stronger, as the error grows
  bool endless = false;    ///< cues last as long as their error, without a pause for the answer
  SafeRange safe_range;    ///< watched whatever the reference; empty for none
  ExposureState exposure;  ///< what the skin bore before
};

struct CoachOutput {
  AlignmentEstimate alignment;
  JointVectors error = zero_vectors();  ///< at the aligned reference time
  CorrectionResult correction;          ///< the one in use
  bool handed_over = false;             ///< it came into use at this frame
  wire::BoardState tactors{};
  std::optional<RepetitionScore> repetition;  ///< one that ended at this frame
};

class Coach {
 public:
  /// @param solver  outlives the coach
  Coach(std::shared_ptr<const Reference> reference, BodyMap map, const CoachSettings& settings,
        CorrectionSource& solver, TactileSetup tactile = {});

  /// Takes the next pose. No allocation; never waits for the solver.
  void step(const StampedPose& pose, CoachOutput& out) noexcept;

  /// Hands the solver the problem that the last step() came upon, if it did. Call it after each
  /// step once the outputs are on their way: the solver wakes at once and then competes for the
  /// processor.
  void pose_problem() noexcept;

  /// A paused coach follows and scores nothing, and everything is off, alarms too.
  void pause(bool paused) noexcept { paused_ = paused; }
  bool paused() const noexcept { return paused_; }

  /// A muted coach follows and scores as ever, but cues nothing, not even an alarm (an
  /// emergency stop is in force).
  void mute(bool muted) noexcept { muted_ = muted; }

  /// What may be cued from the next step on; everything at first. Neither following nor scoring
  /// nor the safe range's alarm is touched.
  void feedback(Feedback feedback) { feedback_ = std::move(feedback); }

  /// A resting coach follows, scores and corrects nothing; the safe range is watched.
  void rest(bool resting) noexcept { resting_ = resting; }

  /// Ends the repetition under way, if enough of it was done.
  std::optional<RepetitionScore> finish() noexcept { return scorer_.finish(); }

  const Reference& reference() const noexcept { return *reference_; }
  /// At the reference time of the last step.
  const std::array<double, kJointCount>& tolerance() const noexcept { return tolerance_; }
  std::span<const Cue> cues() const noexcept { return mapper_.cues(); }
  std::uint64_t cues_given() const noexcept { return mapper_.cues_given(); }
  const std::array<std::uint64_t, kJointCount>& cues_by_joint() const noexcept {
    return mapper_.cues_by_joint();
  }
  const ExposureState& exposure() const noexcept { return mapper_.exposure(); }
  std::uint64_t problems_posed() const noexcept { return posed_; }

 private:
  void estimate_velocity(const StampedPose& pose) noexcept;
  void confirm(const CorrectionResult& result) noexcept;
  void set_tolerance(double reference_time) noexcept;
  wire::BoardState cue(std::int64_t stamp_ns, bool following, const JointVectors& error,
                       const SafeRangeAlarm* alarm) noexcept;

  std::shared_ptr<const Reference> reference_;
  double tolerance_scale_ = 1.0;
  std::array<double, kJointCount> tolerance_{};
  Aligner aligner_;
  SafeRangeMonitor safe_range_;
  TactileMapper mapper_;
  RepetitionScorer scorer_;
  CorrectionSource* solver_;
  CorrectionProblem problem_;    ///< reused, so that posing one allocates nothing
  AlignmentEstimate alignment_;  ///< the last one
  CorrectionResult in_use_;
  JointSet confirmed_;  ///< of its targets
  Feedback feedback_;
  std::int64_t in_use_since_ns_ = 0;
  JointVectors velocity_ = zero_vectors();
  Pose last_pose_;
  std::int64_t last_stamp_ns_ = 0;
  std::int64_t last_posed_ns_ = 0;
  std::uint64_t posed_ = 0;
  bool to_pose_ = false;
  bool paused_ = false;
  bool resting_ = false;
  bool muted_ = false;
};

/// What identifies a reference's content: a hash of its poses, weights and tolerances.
std::uint64_t fingerprint(const Reference& reference) noexcept;

}  // namespace secondskin::coach
