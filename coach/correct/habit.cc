#include "coach/correct/habit.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace secondskin::coach {
namespace {

// Of what is known, the share that the newest repetition has.
constexpr double kNewest = 0.4;
// Progress beyond this between two frames is a jump [s].
constexpr double kLongestStep = 0.25;

}  // namespace

Habit::Habit(double duration) noexcept
    : step_(std::max(duration, 1e-3) / (kPlaces - 1)),
      last_(std::numeric_limits<double>::quiet_NaN()) {
  mean_.fill(zero_vectors());
}

Habit::Between Habit::between(double reference_time) const noexcept {
  const double at = std::clamp(reference_time / step_, 0.0, static_cast<double>(kPlaces - 1));
  const auto place = std::min(static_cast<std::size_t>(at), kPlaces - 2);
  return {place, at - static_cast<double>(place)};
}

void Habit::note(double reference_time, const JointVectors& error) noexcept {
  if (!std::isfinite(reference_time)) return;
  const double progress = reference_time - last_;
  last_ = reference_time;
  if (!(progress > 0.0 && progress < kLongestStep)) return;
  // A pass over a place, during which its hat's area goes by, takes in kNewest.
  static const double rate = -std::log1p(-kNewest);
  const Between b = between(reference_time);
  for (std::size_t side = 0; side < 2; ++side) {
    const double hat = side == 0 ? 1.0 - b.share : b.share;
    const double gain = -std::expm1(-rate * hat * progress / step_);
    JointVectors& mean = mean_[b.place + side];
    for (std::size_t j = 0; j < kJointCount; ++j) {
      if (error[j].allFinite()) mean[j] += gain * (error[j] - mean[j]);
    }
    known_[b.place + side] += gain * (1.0 - known_[b.place + side]);
  }
}

Eigen::Vector3d Habit::at(double reference_time, std::size_t joint) const noexcept {
  const Between b = between(reference_time);
  return (1.0 - b.share) * mean_[b.place][joint] + b.share * mean_[b.place + 1][joint];
}

double Habit::known(double reference_time) const noexcept {
  const Between b = between(reference_time);
  return (1.0 - b.share) * known_[b.place] + b.share * known_[b.place + 1];
}

}  // namespace secondskin::coach
