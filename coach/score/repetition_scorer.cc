#include "coach/score/repetition_scorer.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <utility>

namespace secondskin::coach {
namespace {

// An error of this many tolerances beyond the tolerance costs a joint all of that instant.
constexpr double kWorstExcess = 3.0;
// Less of the reference than this is no repetition.
constexpr double kLeastCovered = 0.5;

}  // namespace

RepetitionScorer::RepetitionScorer(std::shared_ptr<const Reference> reference)
    : reference_(std::move(reference)) {
  if (!reference_) throw std::invalid_argument("repetition scorer: no reference");
}

std::optional<RepetitionScore> RepetitionScorer::update(std::int64_t stamp_ns,
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
  for (std::size_t j = 0; j < kJointCount; ++j) {
    const double e = error[j].norm();
    const double tolerance = reference_->tolerance_at(alignment.reference_time, j);
    Sums& s = sums_[j];
    s.square += e * e;
    s.peak = std::max(s.peak, e);
    if (e <= tolerance) {
      s.in_band += 1.0;
    } else {
      s.excess += std::min(1.0, (e - tolerance) / (kWorstExcess * tolerance));
    }
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
  const auto n = static_cast<double>(frames_);
  double weights = 0.0, cost = 0.0;
  for (std::size_t j = 0; j < kJointCount; ++j) {
    score.joints[j] = {std::sqrt(sums_[j].square / n), sums_[j].peak, sums_[j].in_band / n};
    weights += reference_->weight[j];
    cost += reference_->weight[j] * sums_[j].excess / n;
  }
  score.total = weights > 0.0 ? 100.0 * (1.0 - cost / weights) : 0.0;
  clear();
  return score;
}

void RepetitionScorer::clear() noexcept {
  sums_ = {};
  frames_ = 0;
}

}  // namespace secondskin::coach
