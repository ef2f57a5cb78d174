#include "coach/score/repetition_scorer.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <utility>

namespace secondskin::coach {
namespace {

// An error of this many tolerances beyond the tolerance costs a joint all of that instant.
constexpr double kWorstExcess = 3.0;
// A deviation of one spread is any expert's; one of five costs all.
constexpr double kFreeSpreads = 1.0;
constexpr double kWorstSpreads = 5.0;
// Less of the reference than this is no repetition.
constexpr double kLeastCovered = 0.5;

// Equation 3.
double cost(double deviation, double spread) noexcept {
  return std::clamp((std::fabs(deviation) / spread - kFreeSpreads) / (kWorstSpreads - kFreeSpreads),
                    0.0, 1.0);
}

double joint_cost(double error, double tolerance) noexcept {
  return std::clamp((error - tolerance) / (kWorstExcess * tolerance), 0.0, 1.0);
}

double between(double a, double b, double u) noexcept { return (1.0 - u) * a + u * b; }

const Reference& checked(const std::shared_ptr<const Reference>& reference) {
  if (!reference) throw std::invalid_argument("repetition scorer: no reference");
  return *reference;
}

}  // namespace

PostureScorer::PostureScorer(const Reference& reference)
    : model_(!reference.posture.empty()
                 ? reference.posture
                 : posture_model(reference.motion, {}, reference.weight, reference.tolerance)) {
  if (model_.mean.size() != reference.motion.poses.size()) {
    throw std::invalid_argument("repetition scorer: the reference's posture is another motion's");
  }
  for (std::size_t f = 0; f < kPostureCount; ++f) {
    for (const JointSet& side : posture_features()[f].own) {
      const JointSet shown = side & model_.needed;
      if (side.any() && shown.none()) {  // nothing to compare with
        weight_[f] = 0.0;
        break;
      }
      for (std::size_t j = 0; j < kJointCount; ++j) {
        if (shown[j]) weight_[f] = std::max(weight_[f], reference.weight[j]);
      }
    }
  }
}

void PostureScorer::update(double time, double reference_time, const Pose& pose) noexcept {
  const Posture posture = posture_of(pose, model_.needed);
  const double at =
      std::clamp(reference_time * kReferenceRate, 0.0, static_cast<double>(model_.mean.size() - 1));
  const auto before = static_cast<std::size_t>(at);
  const std::size_t after = std::min(before + 1, model_.mean.size() - 1);
  const double u = at - static_cast<double>(before);
  for (std::size_t f = 0; f < kPostureCount; ++f) {
    const double deviation = posture[f] - between(model_.mean[before][f], model_.mean[after][f], u);
    if (!std::isfinite(deviation)) continue;
    Sums& s = sums_[f];
    if (time <= kStartTime) {
      s.start += deviation;
      s.start_count += 1.0;
    }
    const double start = s.start_count > 0.0 ? s.start / s.start_count : deviation;
    s.deviation += cost(deviation, between(model_.spread[before][f], model_.spread[after][f], u));
    s.change += cost(deviation - start, between(model_.spread_from_start[before][f],
                                                model_.spread_from_start[after][f], u));
    s.least = s.count > 0.0 ? std::min(s.least, posture[f]) : posture[f];
    s.greatest = s.count > 0.0 ? std::max(s.greatest, posture[f]) : posture[f];
    s.count += 1.0;
  }
}

std::optional<double> PostureScorer::lost(Criterion criterion) const noexcept {
  double weights = 0.0, costs = 0.0;
  for (std::size_t f = 0; f < kPostureCount; ++f) {
    const Sums& s = sums_[f];
    if (posture_features()[f].criterion != criterion || !(s.count > 0.0)) continue;
    weights += weight_[f];
    costs += weight_[f] / 3.0 *
             ((s.deviation + s.change) / s.count +
              cost(s.greatest - s.least - model_.range[f], model_.range_spread[f]));
  }
  return weights > 0.0 ? std::optional(costs / weights) : std::nullopt;
}

double PostureScorer::weight(Criterion criterion) const noexcept {
  double most = 0.0;
  for (std::size_t f = 0; f < kPostureCount; ++f) {
    if (posture_features()[f].criterion == criterion) most = std::max(most, weight_[f]);
  }
  return most;
}

void PostureScorer::clear() noexcept { sums_ = {}; }

RepetitionScorer::RepetitionScorer(std::shared_ptr<const Reference> reference)
    : reference_(std::move(reference)),
      posture_(checked(reference_)),
      movement_(checked(reference_)) {}

std::optional<RepetitionScore> RepetitionScorer::update(std::int64_t stamp_ns, const Pose& pose,
                                                        const AlignmentEstimate& alignment,
                                                        const JointVectors& error,
                                                        std::uint64_t cues_given) noexcept {
  cues_now_ = cues_given;
  switch (alignment.phase) {
    case Phase::kWaiting:  // given up, or not begun
      clear();
      return std::nullopt;
    case Phase::kFinished: {
      last_ns_ = stamp_ns;
      // The aligner knows that enough of the path was done; time says nothing where a motion rests.
      return frames_ > 0 ? std::optional(complete()) : std::nullopt;
    }
    case Phase::kLost:
      return std::nullopt;
    case Phase::kMoving:
    case Phase::kPaused:
      break;
  }
  // Begun again without having finished: what was done so far is no repetition.
  if (frames_ > 0 &&
      covered_to_ - alignment.reference_time > kLeastCovered * reference_->motion.duration()) {
    clear();
  }
  if (frames_ == 0) {
    start_ns_ = stamp_ns;
    covered_from_ = covered_to_ = alignment.reference_time;
    cues_at_start_ = cues_given;
  }
  ++frames_;
  last_ns_ = stamp_ns;
  covered_from_ = std::min(covered_from_, alignment.reference_time);
  covered_to_ = std::max(covered_to_, alignment.reference_time);
  const double time = 1e-9 * static_cast<double>(stamp_ns - start_ns_);
  posture_.update(time, alignment.reference_time, pose);
  movement_.update(time, alignment.reference_time, pose);
  for (std::size_t j = 0; j < kJointCount && j < pose.confidence.size(); ++j) {
    const double e = error[j].norm();
    if (!(pose.confidence[j] > 0.0F) || !std::isfinite(e)) continue;
    const double tolerance = reference_->tolerance_at(alignment.reference_time, j);
    Sums& s = sums_[j];
    if (time <= kStartTime) {
      s.start += error[j];
      s.start_count += 1.0;
    }
    const double change = s.start_count > 0.0 ? (error[j] - s.start / s.start_count).norm() : 0.0;
    s.count += 1.0;
    s.square += e * e;
    s.peak = std::max(s.peak, e);
    if (e <= tolerance) s.in_band += 1.0;
    s.cost += 0.5 * (joint_cost(e, tolerance) + joint_cost(change, tolerance));
  }
  return std::nullopt;
}

std::optional<RepetitionScore> RepetitionScorer::finish() noexcept {
  const bool enough =
      frames_ > 0 && covered_to_ - covered_from_ >= kLeastCovered * reference_->motion.duration();
  if (!enough) {
    clear();
    return std::nullopt;
  }
  return complete();
}

RepetitionScore RepetitionScorer::complete() noexcept {
  RepetitionScore score;
  score.repetition = ++repetitions_;
  score.start_ns = start_ns_;
  score.end_ns = last_ns_;
  score.cues =
      static_cast<std::uint32_t>(cues_now_ > cues_at_start_ ? cues_now_ - cues_at_start_ : 0);
  double weights = 0.0, cost = 0.0, most = 0.0;
  for (std::size_t j = 0; j < kJointCount; ++j) {
    const Sums& s = sums_[j];
    if (!(s.count > 0.0)) continue;
    score.joints[j] = {.measured = true,
                       .rms = std::sqrt(s.square / s.count),
                       .peak = s.peak,
                       .in_band = s.in_band / s.count,
                       .timing_error = movement_.timing_error(j),
                       .smoothness = movement_.smoothness(j),
                       .range = movement_.range(j),
                       .reference_range = movement_.reference_range(j)};
    weights += reference_->weight[j];
    most = std::max(most, reference_->weight[j]);
    cost += reference_->weight[j] * s.cost / s.count;
  }
  if (weights > 0.0) score.lost[kCriterionCount] = cost / weights;
  weights = cost = 0.0;
  for (std::size_t c = 0; c <= kCriterionCount; ++c) {
    const double weight = c < kCriterionCount ? posture_.weight(static_cast<Criterion>(c)) : most;
    if (c < kCriterionCount) score.lost[c] = posture_.lost(static_cast<Criterion>(c));
    if (!score.lost[c]) continue;
    weights += weight;
    cost += weight * *score.lost[c];
  }
  score.total = weights > 0.0 ? 100.0 * (1.0 - cost / weights) : 0.0;
  clear();
  return score;
}

void RepetitionScorer::clear() noexcept {
  if (frames_ == 0) return;  // nothing was added
  sums_ = {};
  posture_.clear();
  movement_.clear();
  frames_ = 0;
}

}  // namespace secondskin::coach
