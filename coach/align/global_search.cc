#include "coach/align/global_search.h"

#include <algorithm>
#include <cmath>

namespace secondskin::coach {
namespace {

constexpr std::size_t kStride = 2;   // of the reference's frames: 30 Hz are enough to find a place
constexpr std::size_t kPiece = 360;  // frames compared at a time: 12 s of reference
constexpr double kMemory = 0.2;      // [s]
constexpr double kFastest = 2.0;     // tempo
constexpr float kVelocityWeight = 0.01F;  // [s^2]: 1 rad/s of wrong velocity is like 0.1 rad
constexpr float kMostMismatch = 0.05F;    // [rad^2], of a velocity that a leap made up

}  // namespace

GlobalSearch::GlobalSearch(const Reference& reference)
    : features_(reference, kStride),
      rate_hz_(reference.motion.rate_hz / kStride),
      pose_(kPiece),
      cross_(kPiece),
      speed_(kPiece),
      accumulated_(features_.size()),
      previous_(features_.size()) {}

void GlobalSearch::reset() noexcept {
  next_ = 0;
  passes_ = 0.0;
}

bool GlobalSearch::update(const LearnerFeatures& learner, double time, double here,
                          Found& found) noexcept {
  if (next_ == 0) {
    const double dt = time - last_pass_time_;
    if (dt > 2.0 * kMemory) passes_ = 0.0;
    learner_ = learner;
    pass_time_ = time;
    last_pass_time_ = time;
    reach_ = static_cast<std::size_t>(std::ceil(kFastest * std::min(dt, kMemory) * rate_hz_));
    keep_ = passes_ > 0.0 ? static_cast<float>(std::exp(-dt / kMemory)) : 0.0F;
    previous_.swap(accumulated_);
  }
  const std::size_t end = std::min(features_.size(), next_ + kPiece);
  extend(next_, end);
  next_ = end;
  if (end < features_.size()) return false;
  next_ = 0;
  passes_ += 1.0;

  const auto best = static_cast<std::size_t>(
      std::min_element(accumulated_.begin(), accumulated_.end()) - accumulated_.begin());
  const auto around = static_cast<std::ptrdiff_t>(here / kStride);
  const auto n = static_cast<std::ptrdiff_t>(features_.size());
  const std::ptrdiff_t from = std::clamp<std::ptrdiff_t>(around - 6, 0, n - 1);
  const std::ptrdiff_t to = std::clamp<std::ptrdiff_t>(around + 7, from + 1, n);
  found.cost = accumulated_[best];
  found.here = *std::min_element(accumulated_.begin() + from, accumulated_.begin() + to);
  found.position = (static_cast<double>(best) + (time - pass_time_) * rate_hz_) * kStride;
  found.speed = std::sqrt(static_cast<double>(learner_.speed_square));
  return true;
}

void GlobalSearch::extend(std::size_t begin, std::size_t end) noexcept {
  const std::size_t n = end - begin;
  features_.compare(learner_, begin, {{pose_.data(), n}, {cross_.data(), n}, {speed_.data(), n}});
  for (std::size_t i = 0; i < n; ++i) {
    // The velocity's distance at the tempo that explains it best.
    const float tempo = std::clamp(cross_[i] / (speed_[i] + 1e-3F), 0.0F, 2.0F);
    const float mismatch = learner_.speed_square + tempo * (tempo * speed_[i] - 2.0F * cross_[i]);
    pose_[i] += std::min(kVelocityWeight * mismatch, kMostMismatch);
  }
  for (std::size_t i = 0; i < n; ++i) {
    const std::size_t at = begin + i;
    const std::size_t from = at > reach_ ? at - reach_ : 0;
    float least = previous_[at];
    for (std::size_t j = from; j < at; ++j) least = std::min(least, previous_[j]);
    accumulated_[at] = keep_ * least + (1.0F - keep_) * pose_[i];
  }
}

}  // namespace secondskin::coach
