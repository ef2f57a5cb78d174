#include "coach/align/aligner.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <numeric>
#include <optional>
#include <stdexcept>
#include <vector>

#include "coach/align/global_search.h"
#include "coach/align/pose_features.h"
#include "coach/align/position_filter.h"

namespace secondskin::coach {
namespace {

constexpr double kDegree = std::numbers::pi / 180.0;
constexpr double square(double x) { return x * x; }

// The rules of docs/alignment.md, section 4. Angles are RMS over the joints; shares are of the
// path, the way that the joints go in the whole reference.
constexpr double kStillSpeed = 8.0 * kDegree;  // up to this the expert stands still [rad/s]
constexpr double kPoseFloor = 3.0 * kDegree;   // error of a learner who does the same [rad]

// Neighbourhoods of the start's and the end's pose, and of the reference as a whole. Shares are of
// the typical distance between two of the reference's poses.
constexpr double kZone = 6.0 * kDegree, kZoneShare = 0.15;
constexpr double kLostShare = 0.9;  // farther off is another motion
constexpr double kLeastLost = 15.0 * kDegree, kMostLost = 30.0 * kDegree;
constexpr double kMatchShare = 0.85;  // of the lost distance: near enough to begin
constexpr double kMeanFit = 0.7;      // of its square: farther off on average was another motion
constexpr double kBestFit = 12.0 * kDegree;  // farther off even in the best part was one, too
constexpr double kBestShare = 0.3;           // of the time: the best part

// How much of the path.
constexpr double kStartProgress = 0.03;         // the learner has set off
constexpr double kLateProgress = 0.2;           // likewise, when joining in the middle
constexpr double kLatestJoin = 0.6;             // who joins later has missed this repetition
constexpr double kCountedProgress = 1.0 / 3.0;  // it counts as under way
constexpr double kSkipProgress = 0.25;          // may be left out at once
constexpr double kWholeProgress = 0.6;          // enough to have finished
constexpr double kLeaveProgress = 0.75;         // who goes back or away from here has finished
constexpr double kStopProgress = 0.9;           // who stops here has finished
constexpr double kTurnProgress = 0.05;          // so much back from there: likewise
constexpr double kEndProgress = 0.95;           // the end's neighbourhood begins after it

// For how long [s].
constexpr double kErrorTime = 0.15, kVarianceTime = 1.0;  // memory of the pose error
constexpr double kFitTime = 1.5, kLeastFitTime = 1.0;     // memory of the fit, and enough of it
constexpr double kLostTime = 0.3, kGiveUpTime = 2.0;
constexpr double kPauseTime = 0.25, kStopTime = 0.5;
constexpr double kAtStartTime = 0.15;
constexpr double kSetOffTime = 0.7;  // between leaving the start and being followed
constexpr double kRestTime = 0.8;    // fitting without moving on
constexpr double kRelocateTime = 0.12, kJoinTime = 0.4;  // another place fits better
constexpr double kLongestGap = 1.0;                      // after it the past says nothing

// Noise differs from frame to frame; a learner's own way, which is larger, does not: beyond
// kOwnWay an error counts for less than its square.
constexpr double kVarianceGain = 1.5;
constexpr double kOwnWay = 7.0 * kDegree;
constexpr double kPauseTempo = 0.12, kGoTempo = 0.25;
constexpr double kStandShare = 0.1;  // of the expert's speed here: slower is standing still
constexpr double kStartMix = 2.0;    // how often a start is expected while waiting [1/s]
constexpr double kJumpRate = 0.001, kWaitingJumpRate = 0.0005;  // of leaps in the window [1/s]

// For how long the learner was how far from the expert.
class FitHistogram {
 public:
  void clear() noexcept { time_.fill(0.0); }

  void fade(double keep) noexcept {
    for (double& t : time_) t *= keep;
  }

  void add(double distance, double dt) noexcept {
    time_[std::min(kBins - 1, static_cast<std::size_t>(distance / kBin))] += dt;
  }

  double time() const noexcept { return std::accumulate(time_.begin(), time_.end(), 0.0); }

  /// Whether the best part of the time is all nearer than this.
  bool fits(double distance) const noexcept {
    const auto end = static_cast<std::ptrdiff_t>(distance / kBin);
    return std::accumulate(time_.begin(), time_.begin() + end, 0.0) >= kBestShare * time();
  }

 private:
  static constexpr double kBin = 1.0 * kDegree;
  static constexpr std::size_t kBins = 40;
  static_assert(kBestFit < kBin * kBins);
  std::array<double, kBins> time_{};
};

}  // namespace

struct Aligner::State {
  State(std::shared_ptr<const Reference> r, const AlignerOptions& options)
      : reference(std::move(r)),
        rate_hz(reference->motion.rate_hz),
        frames(reference->motion.poses.size()),
        features(*reference, 1),
        filter(frames, rate_hz, options),
        pose(filter.width()),
        cross(filter.width()),
        speed(filter.width()) {
    if (filter.width() < frames) search.emplace(*reference);
    measure_reference();
    reset();
  }

  // ---- the reference's measures -----------------------------------------------------------------

  void measure_reference() {
    // Typical distance of two of its poses: the scale on which "elsewhere" is told from "there".
    double sum = 0.0;
    std::size_t pairs = 0;
    const std::size_t step = std::max<std::size_t>(1, frames / 64);
    for (std::size_t a = 0; a < frames; a += step) {
      for (std::size_t b = 0; b < a; b += step, ++pairs) sum += features.distance_square(a, b);
    }
    const double typical = pairs > 0 ? std::sqrt(sum / static_cast<double>(pairs)) : 0.0;
    lost_square = square(std::clamp(kLostShare * typical, kLeastLost, kMostLost));
    match_square = square(kMatchShare) * lost_square;

    // Path length of the moving parts: the measure of how much of the motion was done.
    path.resize(frames, 0.0);
    const auto lag = static_cast<std::size_t>(std::lround(0.1 * rate_hz));
    for (std::size_t i = 1; i < frames; ++i) {
      const std::size_t a = i > lag ? i - lag : 0;
      const double v = std::sqrt(std::max(0.0F, features.distance_square(a, i))) * rate_hz /
                       static_cast<double>(i - a);
      path[i] = path[i - 1] + std::max(0.0, v - kStillSpeed) / rate_hz;
    }
    const double radius = square(std::max(kZone, kZoneShare * typical));
    start_zone = 1;
    while (start_zone < frames && features.distance_square(0, start_zone) < radius) ++start_zone;
    end_zone = frames - 1;
    while (end_zone > 0 && features.distance_square(frames - 1, end_zone - 1) < radius &&
           path[end_zone - 1] > kEndProgress * path.back()) {
      --end_zone;
    }
    if (end_zone < start_zone) {  // hardly any motion: halves
      start_zone = std::max<std::size_t>(1, frames / 2);
      end_zone = std::min(frames - 1, start_zone);
    }
  }

  double path_at(double position) const noexcept {
    const double p = std::clamp(position, 0.0, static_cast<double>(frames - 1));
    const auto i = static_cast<std::size_t>(p);
    if (i + 1 >= frames) return path.back();
    const double u = p - static_cast<double>(i);
    return path[i] + u * (path[i + 1] - path[i]);
  }

  // ---- the learner's features -------------------------------------------------------------------

  struct Past {
    double time;
    std::array<JointFeature, kJointCount> orientation;
    std::array<bool, kJointCount> known;
  };
  static constexpr std::size_t kHistory = 32;
  static constexpr double kHistoryStep = 0.004;  // [s]; all of it reaches beyond the lag

  // False when no joint can be compared.
  bool take(double time, const Pose& learner) noexcept {
    const Past* before = nullptr;
    double nearest = 0.5 * kVelocityLag;
    for (std::size_t i = 0; i < history_size; ++i) {
      const double off = std::fabs(time - history[i].time - kVelocityLag);
      if (off < nearest) {
        nearest = off;
        before = &history[i];
      }
    }
    Past now;
    now.time = time;
    double total = 0.0;
    for (std::size_t j = 0; j < kJointCount; ++j) {
      const auto joint = static_cast<Joint>(j);
      current.weight[j] = 0.0F;
      now.known[j] = learner.confidence[j] > 0.0F;
      now.orientation[j] = current.orientation[j] = joint_feature(joint, learner.q_PB[j]);
      current.velocity[j] = {};
      if (!now.known[j] || features.weight()[j] <= 0.0F) continue;
      if (before != nullptr) {
        if (!before->known[j]) continue;  // back since less than the lag
        current.velocity[j] =
            feature_velocity(joint, before->orientation[j], current.orientation[j],
                             static_cast<float>(time - before->time));
      }
      current.weight[j] = features.weight()[j] * std::min(learner.confidence[j], 1.0F);
      total += current.weight[j];
    }
    if (history_size == 0 || time - history[history_last].time >= kHistoryStep) {
      history_last = history_size == 0 ? 0 : (history_last + 1) % kHistory;
      history_size = std::min(history_size + 1, kHistory);
      history[history_last] = now;
    }
    if (total <= 0.0) return false;
    double squares = 0.0;
    current.speed_square = 0.0F;
    for (std::size_t j = 0; j < kJointCount; ++j) {
      current.weight[j] = static_cast<float>(current.weight[j] / total);
      squares += square(current.weight[j]);
      const auto& v = current.velocity[j];
      current.speed_square += current.weight[j] * (v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
    }
    current.joints = static_cast<float>(1.0 / squares);
    current.has_velocity = before != nullptr;
    return true;
  }

  // ---- each frame -------------------------------------------------------------------------------

  void step(double time, double gap) noexcept {
    const double dt = std::min(gap, PositionFilter::kLongestStep);
    filter.predict(dt, waiting() ? kWaitingJumpRate : kJumpRate);
    if (waiting()) filter.mix_start(start_zone, std::min(0.5, kStartMix * dt));
    const FrameCosts costs{pose, cross, speed};
    features.compare(current, filter.begin(), costs);
    filter.correct(costs, current,
                   square(kPoseFloor) +
                       kVarianceGain * variance * (1.0 + variance / square(kOwnWay)),
                   std::clamp(dt * rate_hz, 0.1, 2.0));

    const PositionFilter::Estimate before = estimate;
    estimate = filter.estimate();
    const double at = estimate.position - static_cast<double>(filter.begin());
    const auto i = std::min(static_cast<std::size_t>(std::max(at, 0.0)), filter.width() - 1);
    const double here = std::max(0.0F, pose[i]);
    here_square = here;
    expert_speed_square = speed[i];
    error_square += (1.0 - std::exp(-dt / kErrorTime)) * (here - error_square);
    confidence = std::exp2(-error_square / lost_square) * estimate.concentration;
    variance += (1.0 - std::exp(-dt / kVarianceTime)) * (std::min(here, lost_square) - variance);

    if (!waiting()) {
      attempt_fit.add(std::sqrt(here), dt);
      recent_fit.fade(std::exp(-dt / kFitTime));
      recent_fit.add(std::sqrt(here), dt);
    }

    advance(before.position, here, dt);
    decide(dt);
    if (search) look_elsewhere(time);
    if (!waiting()) filter.follow();
  }

  bool waiting() const noexcept { return phase == Phase::kWaiting || phase == Phase::kFinished; }

  // How much of the path was done without a jump.
  void advance(double before, double here, double dt) noexcept {
    const double moved = estimate.position - before;
    const double most = 3.0 * dt * rate_hz + 3.0;
    const double done = path_at(estimate.position) - path_at(before);
    if (std::fabs(moved) > most) {
      progress = 0.0;
      if (done > 0.0) {  // a short part left out, or done so differently that it was not recognised
        if (done < kSkipProgress * path.back()) covered += done;
      } else if (estimate.position >= static_cast<double>(start_zone)) {
        covered = std::min(covered, path_at(estimate.position));
      }  // a jump to the start is decide()'s: the end of this attempt or of the repetition
      return;
    }
    if (error_square > match_square) progress = 0.0;
    progress = std::max(0.0, progress + done);
    if (phase == Phase::kMoving || phase == Phase::kPaused) {
      covered += done;
      if (done > 0.0) {
        fit_path += done;
        fit_sum += done * here;
      }
    }
  }

  void decide(double dt) noexcept {
    in_phase += dt;
    switch (phase) {
      case Phase::kFinished:
        if (in_phase > kLostTime && distance_to_end() > match_square) enter(Phase::kWaiting);
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
        found = error_square < (another ? square(kBestFit) : match_square) ? found + dt : 0.0;
        if (found > kLostTime && (progress > kStartProgress * path.back() || found > kRestTime)) {
          enter(estimate.position < static_cast<double>(start_zone) ? Phase::kWaiting
                                                                    : Phase::kMoving);
        } else if (in_phase > kGiveUpTime) {
          enter(Phase::kWaiting);
        }
        break;
    }
    if ((phase == Phase::kMoving || phase == Phase::kPaused) &&
        covered > kCountedProgress * path.back()) {
      repetition = finished + 1;
    }
  }

  // Until the learner moves along the reference.
  void wait(double dt) noexcept {
    const double beyond = estimate.position - static_cast<double>(start_zone);
    const bool fits = error_square < match_square;
    if (fits && beyond <= 0.0) since_start = 0.0;
    since_start += dt;
    // From the start when it was there a moment ago, even if the way here fitted badly.
    const double way = beyond / rate_hz;
    const bool from_start = since_start < 2.0 * way + kSetOffTime && since_start > 0.4 * way;
    const double done = path_at(estimate.position);
    const double needed = (from_start ? kStartProgress : kLateProgress) * path.back();
    if (fits && beyond > 0.0 && done < kLatestJoin * path.back() && progress > needed) {
      covered = from_start ? done : progress;
      enter(Phase::kMoving);
    }
  }

  // Until the end, a way back to the start, a pause or a loss.
  void go_on(double dt) noexcept {
    const double whole = path.back();
    const double done = path_at(estimate.position);
    const bool fits = error_square < match_square;
    const bool fits_now = here_square < match_square;
    const bool in_start = estimate.position < static_cast<double>(start_zone);
    const bool in_end = estimate.position >= static_cast<double>(end_zone);
    still = estimate.tempo < kPauseTempo || stands() ? still + dt : 0.0;
    astray = error_square > lost_square ? astray + dt : 0.0;
    at_start = in_start && fits && fits_now ? at_start + dt : 0.0;
    if (fits && done >= furthest) {
      furthest = done;
      end_position = estimate.position;
    }
    const bool strange = recent_fit.time() > kLeastFitTime && !recent_fit.fits(kBestFit);

    const bool nearly = furthest > kStopProgress * whole;
    if ((in_end && fits_now) || (nearly && still > kStopTime) ||
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

  void finish() noexcept {
    if (!attempt_fit.fits(kBestFit)) {
      refuse();
    } else if (covered > kWholeProgress * path.back() && fit_sum <= kMeanFit * lost_square * fit_path) {
      ++finished;
      repetition = finished;
      enter(Phase::kFinished);
    } else {
      enter(Phase::kWaiting);
    }
  }

  void enter(Phase next) noexcept {
    if (next == Phase::kWaiting || next == Phase::kFinished) {
      if (!waiting()) {
        filter.start(start_zone);
        estimate = filter.estimate();
        since_start = kGiveUpTime;
      }
      covered = progress = 0.0;
      furthest = fit_path = fit_sum = 0.0;
      repetition = finished;  // an attempt that was given up is none
      attempt_fit.clear();
    }
    if (phase != Phase::kMoving && phase != Phase::kPaused) {
      another = false;
      recent_fit.clear();
    }
    phase = next;
    in_phase = still = astray = at_start = found = 0.0;
  }

  double distance_to_end() noexcept {
    float pose_end = 0.0F, cross_end = 0.0F, speed_end = 0.0F;
    features.compare(current, frames - 1, {{&pose_end, 1}, {&cross_end, 1}, {&speed_end, 1}});
    return pose_end;
  }

  // Goes where the whole reference fits better than the window, if that lasts.
  void look_elsewhere(double time) noexcept {
    GlobalSearch::Found f;
    if (!search->update(current, time, estimate.position, f)) return;
    const bool better = f.cost < match_square && f.cost < 0.5 * f.here &&
                        std::sqrt(f.here) > std::sqrt(f.cost) + 4.0 * kDegree &&
                        (!waiting() || (f.speed > 2.0 * kStillSpeed &&
                                        path_at(f.position) < kLatestJoin * path.back()));
    if (!better) {
      elsewhere_since = time;
      return;
    }
    if (time - elsewhere_since < (waiting() ? kJoinTime : kRelocateTime)) return;
    elsewhere_since = time;
    filter.relocate(f.position);
    estimate = filter.estimate();
    error_square = f.cost;
    covered = std::min(covered, path_at(estimate.position));
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
        position = std::min(position, static_cast<double>(start_zone));
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
    history_size = 0;
    history_last = 0;
    if (search) search->reset();
  }

  void reset() noexcept {
    filter.start(start_zone);
    forget();
    has_last = false;
    estimate = filter.estimate();
    phase = Phase::kWaiting;
    error_square = lost_square;
    variance = confidence = 0.0;
    in_phase = still = astray = at_start = found = 0.0;
    covered = progress = end_position = furthest = 0.0;
    fit_path = fit_sum = 0.0;
    since_start = kGiveUpTime;
    elsewhere_since = 0.0;
    finished = repetition = 0;
    another = false;
    attempt_fit.clear();
    recent_fit.clear();
    last = {};
  }

  std::shared_ptr<const Reference> reference;
  double rate_hz;
  std::size_t frames;
  ReferenceFeatures features;
  PositionFilter filter;
  std::optional<GlobalSearch> search;
  std::vector<float> pose, cross, speed;  // costs of the window's frames
  std::vector<double> path;
  double lost_square = 0.0, match_square = 0.0;
  std::size_t start_zone = 1, end_zone = 0;

  LearnerFeatures current;
  std::array<Past, kHistory> history;
  std::size_t history_size = 0, history_last = 0;

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
  double in_phase = 0.0, still = 0.0, astray = 0.0, at_start = 0.0, found = 0.0;  // [s]
  double covered = 0.0;                  // of the path in this attempt
  double progress = 0.0;                 // of the path since the last jump or misfit
  double since_start = 0.0;              // the learner was seen in the start's neighbourhood [s]
  double fit_path = 0.0, fit_sum = 0.0;  // of the squared pose error along the path
  double furthest = 0.0;                 // of the path, among what fitted in this attempt
  double end_position = 0.0;             // there; once finished it runs on [frames]
  FitHistogram attempt_fit, recent_fit;  // of the squared pose error's root at the estimate
  bool another = false;                  // lost because this is another motion
  double elsewhere_since = 0.0;  // another place has fitted better [s]
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
  if (!s.take(time, learner)) {
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
