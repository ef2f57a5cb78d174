#include "coach/align/aligner.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <optional>
#include <stdexcept>
#include <vector>

#include "coach/align/fit_record.h"
#include "coach/align/global_search.h"
#include "coach/align/learner_stream.h"
#include "coach/align/likeness.h"
#include "coach/align/pose_features.h"
#include "coach/align/position_filter.h"
#include "coach/align/posture_offset.h"
#include "coach/align/reference_measure.h"

namespace secondskin::coach {
namespace {

constexpr double kDegree = std::numbers::pi / 180.0;
constexpr double square(double x) { return x * x; }

// The rules of docs/alignment.md, section 4. Angles are RMS over the joints; shares are of the
// path, the way that the joints go in the whole reference.
constexpr double kPoseFloor = 3.0 * kDegree;  // error of a learner who does the same [rad]

// Near the expert, or on his way. Correlations of the joints' ways (likeness.h).
constexpr double kAlike = 0.85, kHardlyAlike = 0.7;  // of late: on his way; no longer astray for it
constexpr double kStrange = 0.6;                // of late: less, and not near, is another motion
constexpr double kAttemptAlike = 0.81;          // of the least alike limb over the whole attempt
constexpr double kFarthest = 25.0 * kDegree;    // farther off is not followed, however alike
constexpr double kLeastWay = 4.0 * kDegree;     // of the expert: less says nothing about likeness
constexpr double kMeanFit = 0.7;                // of the lost distance's square, along the path
constexpr double kBestFit = 9.0 * kDegree;      // in the best part of the attempt
constexpr double kRecentFit = 12.0 * kDegree;   // in the best part of the last time, or on average
constexpr double kOwnPosture = 30.0 * kDegree;  // farther from the start is not a posture

// How much of the path.
constexpr double kStartProgress = 0.03;         // the learner has set off
constexpr double kLateProgress = 0.2;           // likewise, when joining in the middle
constexpr double kLatestJoin = 0.6;             // who joins later has missed this repetition
constexpr double kCountedProgress = 1.0 / 3.0;  // it counts as under way
constexpr double kSkipProgress = 0.25;          // may be left out at once
constexpr double kShallowProgress = 0.9;        // likewise between alike poses: not as far
constexpr double kWholeProgress = 0.6;          // enough to have finished
constexpr double kLeaveProgress = 0.75;         // who goes back or away from here has finished
constexpr double kStopProgress = 0.9;           // who stops here has finished
constexpr double kTurnProgress = 0.05;          // so much back from there: likewise
constexpr double kRestProgress = 0.85;          // who rests here as at the end has finished
constexpr double kLeastDone = 0.12;             // done in fact, not only left out
constexpr double kNextProgress = 0.5;           // so much back at once may be the next repetition

// For how long [s].
constexpr double kErrorTime = 0.15, kVarianceTime = 1.0;  // memory of the pose error
constexpr double kFitTime = 1.5, kLeastFitTime = 1.0;     // memory of the fit, and enough of it
constexpr double kLostTime = 0.3, kGiveUpTime = 2.0;
constexpr double kPauseTime = 0.25, kStopTime = 0.3;
constexpr double kAtStartTime = 0.15;
constexpr double kSetOffTime = 0.7;  // between leaving the start and being followed
constexpr double kRestTime = 0.8;    // fitting without moving on
constexpr double kRelocateTime = 0.12, kJoinTime = 0.4;  // another place fits better
constexpr double kSetOff = 0.3, kLateSetOff = 1.0;  // of moving: enough, however long the reference
constexpr double kShortRest = 0.05;                 // resting
constexpr double kLeastLeft = 0.8;                  // of the reference: the end may be near
constexpr double kPostureTime = 0.15;               // memory of the posture at rest
constexpr double kWayTime = 6.0;                    // likewise on the way
constexpr double kDoubtTime = 1.0;                  // likewise when lost
constexpr double kLongestGap = 1.0;                 // after it the past says nothing

// Noise differs from frame to frame; a learner's own way, which is larger, does not: beyond
// kOwnWay an error counts for less than its square.
constexpr double kVarianceGain = 1.5;
constexpr double kOwnWay = 7.0 * kDegree;
constexpr double kPauseTempo = 0.12, kGoTempo = 0.25;
constexpr double kStandShare = 0.1;  // of the expert's speed here: slower is standing still
constexpr double kStartMix = 2.0;    // how often a start is expected while waiting [1/s]
constexpr double kJumpRate = 0.001, kWaitingJumpRate = 0.0005;  // of leaps in the window [1/s]

}  // namespace

struct Aligner::State {
  State(std::shared_ptr<const Reference> r, const AlignerOptions& options)
      : reference(std::move(r)),
        rate_hz(reference->motion.rate_hz),
        frames(reference->motion.poses.size()),
        features(*reference, 1),
        measure(features, rate_hz),
        filter(frames, rate_hz, options),
        attempt(*reference),
        recent(*reference),
        pose(filter.width()),
        cross(filter.width()),
        speed(filter.width()) {
    if (filter.width() < frames) search.emplace(*reference);
    first = features.orientations_at(0);
    last_pose = features.orientations_at(frames - 1);
    reset();
  }

  // ---- each frame -------------------------------------------------------------------------------

  void step(double time, double gap) noexcept {
    const double dt = std::min(gap, PositionFilter::kLongestStep);
    filter.predict(dt, waiting() ? kWaitingJumpRate : kJumpRate);
    if (waiting()) filter.mix_start(measure.start_zone, std::min(0.5, kStartMix * dt));
    const FrameCosts costs{pose, cross, speed};
    features.compare(current, filter.begin(), costs);
    filter.correct(
        costs, current,
        square(kPoseFloor) + kVarianceGain * variance * (1.0 + variance / square(kOwnWay)),
        std::clamp(dt * rate_hz, 0.1, 2.0));

    const PositionFilter::Estimate before = estimate;
    estimate = filter.estimate();
    const double at = estimate.position - static_cast<double>(filter.begin());
    const auto i = std::min(static_cast<std::size_t>(std::max(at, 0.0)), filter.width() - 1);
    const double here = std::max(0.0F, pose[i]);
    here_square = here;
    expert_speed_square = speed[i];
    error_square += (1.0 - std::exp(-dt / kErrorTime)) * (here - error_square);
    confidence = std::exp2(-error_square / measure.lost_square) * estimate.concentration;
    variance +=
        (1.0 - std::exp(-dt / kVarianceTime)) * (std::min(here, measure.lost_square) - variance);

    if (!waiting()) {
      attempt_fit.add(std::sqrt(here), dt);
      recent_fit.fade(std::exp(-dt / kFitTime));
      recent_fit.add(std::sqrt(here), dt);
      attempt.add(current, estimate.position, dt);
    }
    recent.fade(std::exp(-dt / kFitTime));
    recent.add(current, estimate.position, dt);
    if (const Likeness::Value v = recent.value(); v.expert > kLeastWay) agreement = v.correlation;

    learn_posture(dt);
    advance(before.position, here, dt);
    decide(dt);
    if (search) look_elsewhere(time);
    if (!waiting()) filter.follow();
  }

  // How the learner's joints are held: at rest where the start is expected, slowly on the way.
  void learn_posture(double dt) noexcept {
    if (waiting()) {
      if (!rests() ||
          features.distance_square(current.measured, current.weight, first) > square(kOwnPosture))
        return;
      posture.learn(current, first, static_cast<float>(1.0 - std::exp(-dt / kPostureTime)));
    } else if (phase == Phase::kMoving && error_square < measure.lost_square) {
      const double at = std::clamp(estimate.position + 0.5, 0.0, static_cast<double>(frames - 1));
      posture.learn(current, features.orientations_at(static_cast<std::size_t>(at)),
                    static_cast<float>(dt / kWayTime));
    } else if (phase == Phase::kLost) {
      posture.forget(static_cast<float>(dt / kDoubtTime));
    }
  }

  bool rests() const noexcept {
    return current.has_velocity && current.speed_square < square(measure.resting_speed);
  }

  bool waiting() const noexcept { return phase == Phase::kWaiting || phase == Phase::kFinished; }

  bool attempting() const noexcept { return phase == Phase::kMoving || phase == Phase::kPaused; }

  // Near the expert, or on his way though farther off than the expert's own poses are apart.
  bool fits() const noexcept {
    return error_square < measure.match_square ||
           (agreement > kAlike && error_square < square(kFarthest));
  }
  bool fits_now() const noexcept {
    return here_square < measure.match_square ||
           (agreement > kAlike && here_square < square(kFarthest));
  }
  bool astray_now() const noexcept {
    return error_square > measure.lost_square &&
           !(agreement > kHardlyAlike && error_square < square(kFarthest));
  }

  // How much of the path was done without a jump.
  void advance(double before, double here, double dt) noexcept {
    const double moved = estimate.position - before;
    const double most = 3.0 * dt * rate_hz + 3.0;
    const double done = measure.path_at(estimate.position) - measure.path_at(before);
    if (std::fabs(moved) > most) {
      progress = 0.0;
      const bool between_alike = measure.alike(before, estimate.position);
      // Where the end looks like the start the learner has gone on to the next repetition.
      passing = attempting() && between_alike && furthest > kLeaveProgress * measure.whole() &&
                done < -kNextProgress * measure.whole() && counts();
      if (!between_alike) {
        agreement = 0.0;
        recent.clear();
      }
      if (done > 0.0) {  // a short part left out, or done so differently that it was not recognised
        const double most_left_out = between_alike && fits_now() ? kShallowProgress : kSkipProgress;
        if (done < most_left_out * measure.whole()) {
          covered += done;
          if (done > kSkipProgress * measure.whole()) shallow = true;
        }
      } else if (estimate.position >= static_cast<double>(measure.start_zone)) {
        covered = std::min(covered, measure.path_at(estimate.position));
        furthest = std::min(furthest, measure.path_at(estimate.position));
      }  // a jump to the start is decide()'s: the end of this attempt or of the repetition
      return;
    }
    if (!fits()) progress = 0.0;
    progress = std::max(0.0, progress + done);
    if (attempting()) {
      covered += done;
      if (done > 0.0) {
        walked += done;
        fit_path += done;
        fit_sum += done * here;
      }
    }
  }

  void decide(double dt) noexcept {
    in_phase += dt;
    if (passing) {
      passing = false;
      repetition = ++finished;
      const PositionFilter::Estimate there = estimate;
      enter(Phase::kFinished, true);
      estimate = there;
      since_start = 0.0;
    }
    switch (phase) {
      case Phase::kFinished:
        if (in_phase > kLostTime && distance_to_end() > measure.match_square)
          enter(Phase::kWaiting);
        wait(dt);
        break;
      case Phase::kWaiting:
        wait(dt);
        break;
      case Phase::kMoving:
      case Phase::kPaused:
        go_on(dt);
        break;
      case Phase::kLost:
        found = (another ? error_square < square(kRecentFit) : fits()) ? found + dt : 0.0;
        if (found > kLostTime &&
            (progress > kStartProgress * measure.whole() || found > kRestTime)) {
          enter(estimate.position < static_cast<double>(measure.start_zone) ? Phase::kWaiting
                                                                            : Phase::kMoving);
        } else if (in_phase > kGiveUpTime) {
          enter(Phase::kWaiting);
        }
        break;
    }
    if (attempting() && covered > kCountedProgress * measure.whole()) {
      repetition = finished + 1;
    }
  }

  // Until the learner moves along the reference.
  void wait(double dt) noexcept {
    const double beyond = estimate.position - static_cast<double>(measure.start_zone);
    const bool fits = this->fits();
    const bool at_start_or_end =
        beyond <= 0.0 ||
        (measure.path_at(estimate.position) > kLatestJoin * measure.whole() && looks_like(first));
    if (fits && at_start_or_end) {
      since_start = 0.0;
      home = current.measured;
    }
    since_start += dt;
    // From the start when it was there a moment ago, even if the way here fitted badly.
    const double way = beyond / rate_hz;
    const bool from_start = since_start < 2.0 * way + kSetOffTime && since_start > 0.4 * way;
    const double done = measure.path_at(estimate.position);
    const double needed =
        from_start ? std::min(kStartProgress * measure.whole(), kSetOff * measure.speed)
                   : std::min(kLateProgress * measure.whole(), kLateSetOff * measure.speed);
    if (fits && beyond > 0.0 && done < kLatestJoin * measure.whole() && progress > needed) {
      covered = from_start ? done : progress;
      enter(Phase::kMoving);
    }
  }

  // Until the end, a way back to the start, a pause or a loss.
  void go_on(double dt) noexcept {
    const double whole = measure.whole();
    const double done = measure.path_at(estimate.position);
    const bool fits = this->fits();
    const bool fits_now = this->fits_now();
    const bool in_start = estimate.position < static_cast<double>(measure.start_zone);
    const bool in_end = estimate.position >= static_cast<double>(measure.end_zone);
    still = estimate.tempo < kPauseTempo || stands() ? still + dt : 0.0;
    astray = astray_now() ? astray + dt : 0.0;
    at_start = in_start && fits && fits_now ? at_start + dt : 0.0;
    if (fits && fits_now && done >= furthest) {
      furthest = done;
      end_position = estimate.position;
    }
    const bool strange = recent_fit.time() > kLeastFitTime && recent.time() > kLeastFitTime &&
                         !recent_fit.fits(kRecentFit) && agreement < kStrange;

    const bool nearly = furthest > kStopProgress * whole;
    // Rests near the end, in a pose that is the last one's or his own first one.
    resting = rests() ? resting + dt : 0.0;
    const double left = static_cast<double>(frames - 1) - estimate.position;
    const bool ends = resting > kShortRest && left < kLeastLeft * rate_hz && fits_now &&
                      ((done > kRestProgress * whole && looks_like(last_pose)) ||
                       (measure.cyclic && done > kLeaveProgress * whole &&
                        features.distance_square(current.measured, current.weight, home) <
                            square(measure.radius)));
    if ((in_end && fits_now) || ends || (nearly && still > kStopTime) ||
        (nearly && done < furthest - kTurnProgress * whole)) {
      finish();  // at the end, or stopped or turned back just before it
    } else if (astray > kLostTime || at_start > kAtStartTime) {
      if (furthest > kLeaveProgress * whole) {
        finish();  // went on to the next or to something else a little before the end
      } else {
        enter(astray > kLostTime ? Phase::kLost : Phase::kWaiting);
      }
    } else if (strange) {
      refuse();
    } else if (phase == Phase::kMoving && still > kPauseTime) {
      enter(Phase::kPaused);
    } else if (phase == Phase::kPaused && still == 0.0 && estimate.tempo > kGoTempo) {
      enter(Phase::kMoving);
    }
  }

  // The reference moves here, the learner does not.
  bool stands() const noexcept {
    return current.has_velocity && current.speed_square < square(kStandShare) * expert_speed_square;
  }

  // Another motion that resembles this one.
  void refuse() noexcept {
    enter(Phase::kLost);
    another = true;
  }

  // Enough of the path, the way the expert goes or near him.
  bool counts() const noexcept {
    return covered > kWholeProgress * measure.whole() && walked > kLeastDone * measure.whole() &&
           !is_another() &&
           (alike() || (!shallow && fit_sum <= kMeanFit * measure.lost_square * fit_path));
  }
  bool alike() const noexcept { return attempt.value().least > kAttemptAlike; }
  bool is_another() const noexcept {
    return !alike() && !attempt_fit.fits(kBestFit) && fit_sum > square(kRecentFit) * fit_path;
  }

  void finish() noexcept {
    if (is_another()) {
      refuse();
      covered = walked = furthest = fit_path = fit_sum = 0.0;
      attempt_fit.clear();
      attempt.clear();
    } else if (counts()) {
      ++finished;
      repetition = finished;
      enter(Phase::kFinished);
    } else {
      enter(Phase::kWaiting);
    }
  }

  void enter(Phase next, bool stay = false) noexcept {
    if (next == Phase::kWaiting || next == Phase::kFinished) {
      if (!waiting() && !stay) {
        filter.start(measure.start_zone);
        estimate = filter.estimate();
        since_start = kGiveUpTime;
      }
      covered = progress = 0.0;
      furthest = walked = fit_path = fit_sum = 0.0;
      repetition = finished;  // an attempt that was given up is none
      attempt_fit.clear();
      attempt.clear();
      shallow = false;
    }
    if (!attempting()) {
      another = false;
      recent_fit.clear();
    }
    phase = next;
    in_phase = still = astray = at_start = found = 0.0;
  }

  // A pose of the expert that fits about as well as where the learner is.
  bool looks_like(const std::array<JointFeature, kJointCount>& expert) const noexcept {
    return features.distance_square(current.orientation, current.weight, expert) <
           square(std::sqrt(here_square) + measure.radius);
  }
  double distance_to_end() const noexcept {
    return features.distance_square(current.orientation, current.weight, last_pose);
  }

  // Goes where the whole reference fits better than the window, if that lasts.
  void look_elsewhere(double time) noexcept {
    GlobalSearch::Found f;
    if (!search->update(current, time, estimate.position, f)) return;
    const bool better =
        f.cost < measure.match_square && f.cost < 0.5 * f.here &&
        std::sqrt(f.here) > std::sqrt(f.cost) + 4.0 * kDegree &&
        (!waiting() || (f.speed > 2.0 * kStillSpeed &&
                        measure.path_at(f.position) < kLatestJoin * measure.whole()));
    if (!better) {
      elsewhere_since = time;
      return;
    }
    if (time - elsewhere_since < (waiting() ? kJoinTime : kRelocateTime)) return;
    elsewhere_since = time;
    filter.relocate(f.position);
    estimate = filter.estimate();
    error_square = f.cost;
    covered = std::min(covered, measure.path_at(estimate.position));
    enter(Phase::kMoving);
  }

  AlignmentEstimate result(double dt) noexcept {
    AlignmentEstimate out;
    out.phase = phase;
    out.repetition = repetition;
    out.tempo = estimate.tempo;
    out.confidence = std::clamp(confidence, 0.0, 1.0);
    if (phase == Phase::kPaused) out.tempo = std::min(out.tempo, kPauseTempo);
    double position = estimate.position;
    if (phase == Phase::kWaiting) {
      if (since_start >= kGiveUpTime)
        position = std::min(position, static_cast<double>(measure.start_zone));
      out.tempo = 0.0;
    } else if (phase == Phase::kFinished) {
      end_position = std::min(end_position + dt * rate_hz, static_cast<double>(frames - 1));
      position = end_position;
      out.tempo = 0.0;
    }
    out.reference_time = std::clamp(position, 0.0, static_cast<double>(frames - 1)) / rate_hz;
    return out;
  }

  void forget() noexcept {
    stream.clear();
    if (search) search->reset();
  }

  void reset() noexcept {
    filter.start(measure.start_zone);
    posture.clear();
    agreement = resting = 0.0;
    passing = shallow = false;
    home = first;
    forget();
    has_last = false;
    estimate = filter.estimate();
    phase = Phase::kWaiting;
    error_square = measure.lost_square;
    variance = confidence = 0.0;
    in_phase = still = astray = at_start = found = 0.0;
    covered = progress = end_position = furthest = 0.0;
    walked = fit_path = fit_sum = 0.0;
    since_start = kGiveUpTime;
    elsewhere_since = 0.0;
    finished = repetition = 0;
    another = false;
    attempt_fit.clear();
    recent_fit.clear();
    attempt.clear();
    recent.clear();
    last = {};
    posture.clear();
  }

  std::shared_ptr<const Reference> reference;
  double rate_hz;
  std::size_t frames;
  ReferenceFeatures features;
  ReferenceMeasure measure;
  PositionFilter filter;
  PostureOffset posture;
  Likeness attempt, recent;  // over the attempt, and fading
  std::optional<GlobalSearch> search;
  std::vector<float> pose, cross, speed;          // costs of the window's frames
  double agreement = 0.0;                         // with the expert's way, of late: a correlation
  std::array<JointFeature, kJointCount> first{};  // the expert's first pose
  std::array<JointFeature, kJointCount> last_pose{};
  bool shallow = false;                          // in this attempt: not as far as the expert
  bool passing = false;                          // on to the next repetition without a break
  std::array<JointFeature, kJointCount> home{};  // the learner's own start pose

  LearnerStream stream;
  LearnerFeatures current;

  bool has_last = false;
  std::int64_t first_ns = 0, last_ns = 0;
  AlignmentEstimate last;
  PositionFilter::Estimate estimate;
  double here_square = 0.0;          // pose error at the estimate
  double error_square = 0.0;         // fast mean of the squared pose error at the estimate
  double expert_speed_square = 0.0;  // at the estimate
  double confidence = 0.0;
  double variance = 0.0;  // slow mean of the same
  Phase phase = Phase::kWaiting;
  double resting = 0.0;
  double in_phase = 0.0, still = 0.0, astray = 0.0, at_start = 0.0, found = 0.0;  // [s]
  double covered = 0.0;                  // of the path in this attempt
  double progress = 0.0;                 // of the path since the last jump or misfit
  double walked = 0.0;                   // of the path, without jumps
  double since_start = 0.0;              // the learner was seen in the start's neighbourhood [s]
  double fit_path = 0.0, fit_sum = 0.0;  // of the squared pose error along the path
  double furthest = 0.0;                 // of the path, among what fitted in this attempt
  double end_position = 0.0;             // there; once finished it runs on [frames]
  FitRecord attempt_fit, recent_fit;     // of the squared pose error's root at the estimate
  bool another = false;                  // lost because this is another motion
  double elsewhere_since = 0.0;          // another place has fitted better [s]
  std::uint32_t finished = 0, repetition = 0;
  std::uint64_t dropped = 0;
};

Aligner::Aligner(std::shared_ptr<const Reference> reference, const AlignerOptions& options) {
  if (!reference || reference->motion.poses.empty()) {
    throw std::invalid_argument("aligner: the reference has no poses");
  }
  if (!is_canonical(reference->motion.skeleton)) {
    throw std::invalid_argument("aligner: the reference is not on the canonical skeleton");
  }
  if (!(options.window > 0.0) || !(options.min_tempo > 0.0) ||
      !(options.max_tempo > options.min_tempo)) {
    throw std::invalid_argument(
        "aligner: window and tempi must be positive, min_tempo < max_tempo");
  }
  state_ = std::make_unique<State>(std::move(reference), options);
}
Aligner::~Aligner() = default;
Aligner::Aligner(Aligner&&) noexcept = default;

AlignmentEstimate Aligner::update(std::int64_t stamp_ns, const Pose& learner) noexcept {
  State& s = *state_;
  if (learner.q_PB.size() != kJointCount || learner.confidence.size() != kJointCount ||
      !learner.is_valid() || (s.has_last && stamp_ns <= s.last_ns)) {
    ++s.dropped;
    return s.last;
  }
  if (!s.has_last) s.first_ns = stamp_ns;
  const double time = static_cast<double>(stamp_ns - s.first_ns) * 1e-9;
  const double gap =
      s.has_last ? static_cast<double>(stamp_ns - s.last_ns) * 1e-9 : 1.0 / s.rate_hz;
  if (gap > kLongestGap) s.forget();
  if (!s.stream.take(time, learner, s.features.weight(), s.posture, s.current)) {
    ++s.dropped;
    return s.last;
  }
  s.has_last = true;
  s.last_ns = stamp_ns;
  s.step(time, gap);
  s.last = s.result(gap);
  return s.last;
}

void Aligner::reset() noexcept { state_->reset(); }

std::uint64_t Aligner::dropped() const noexcept { return state_->dropped; }

}  // namespace secondskin::coach
