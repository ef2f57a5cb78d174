#include "coach/tactile/calibration.h"

#include <algorithm>
#include <cmath>

namespace secondskin::coach {
namespace {

constexpr double kRatio = 1.2;         // amplitude JND 17-21 %
constexpr std::size_t kReversals = 6;  // of which the last kAveraged count
constexpr std::size_t kAveraged = 4;
constexpr int kOftenEnough = 2;  // at an end of the range
constexpr int kMostTrials = 40;  // somebody who answers at random
constexpr unsigned kCatchOneIn = 6;

}  // namespace

ThresholdStaircase::ThresholdStaircase(double floor, double ceiling, std::uint32_t seed)
    : floor_(floor),
      ceiling_(std::max(floor, ceiling)),
      top_(static_cast<int>(std::ceil(std::log(ceiling_ / floor_) / std::log(kRatio) - 1e-9))),
      step_((top_ + 1) / 2),
      random_(seed) {
  reversals_.reserve(kReversals);
}

double ThresholdStaircase::level_of(int step) const noexcept {
  return std::min(ceiling_, floor_ * std::pow(kRatio, step));
}

std::optional<double> ThresholdStaircase::next() noexcept {
  if (known_) return std::nullopt;
  catching_ = random_() % kCatchOneIn == 0;
  return catching_ ? 0.0 : level_of(step_);
}

void ThresholdStaircase::answer(bool felt) noexcept {
  if (known_) return;
  if (catching_) {
    ++catch_trials_;
    if (felt) ++false_alarms_;
    return;
  }
  ++trials_;
  if (!felt) {
    felt_in_a_row_ = 0;
    move(+1);
  } else if (++felt_in_a_row_ == 2) {
    felt_in_a_row_ = 0;
    move(-1);
  }
  if (known_ || trials_ < kMostTrials) return;
  known_ = true;
  threshold_ = level_of(step_);
}

void ThresholdStaircase::move(int direction) noexcept {
  if (direction_ != 0 && direction != direction_) {
    stride_ = 1;
    reversals_.push_back(level_of(step_));
  }
  direction_ = direction;
  const int wanted = step_ + direction * stride_;
  if (reversals_.size() == kReversals) {
    double sum = 0.0;
    for (std::size_t i = kReversals - kAveraged; i < kReversals; ++i) {
      sum += std::log(reversals_[i]);
    }
    known_ = true;
    threshold_ = std::clamp(std::exp(sum / kAveraged), floor_, ceiling_);
  } else if ((step_ == 0 && direction < 0) || (step_ == top_ && direction > 0)) {
    known_ = ++at_end_ == kOftenEnough;
    threshold_ = direction < 0 ? floor_ : ceiling_ * kRatio;
  } else {
    at_end_ = 0;
  }
  step_ = std::clamp(wanted, 0, top_);
}

std::optional<double> ComfortRamp::next() const noexcept {
  if (known_) return std::nullopt;
  return level_;
}

void ComfortRamp::answer(bool too_strong) noexcept {
  if (known_) return;
  if (!too_strong) comfortable_ = level_;
  known_ = too_strong || level_ >= ceiling_;
  level_ = std::min(ceiling_, level_ * kRatio);
}

WhichOneTest::WhichOneTest(const std::vector<std::size_t>& channels, std::uint32_t presentations,
                           std::uint32_t seed) {
  for (std::uint32_t i = 0; i < presentations; ++i) {
    order_.insert(order_.end(), channels.begin(), channels.end());
  }
  std::mt19937 random(seed);
  for (std::size_t i = order_.size(); i > 1; --i) std::swap(order_[i - 1], order_[random() % i]);
}

std::optional<std::size_t> WhichOneTest::next() const noexcept {
  if (done_ == order_.size()) return std::nullopt;
  return order_[done_];
}

void WhichOneTest::answer(std::size_t channel) noexcept {
  if (done_ == order_.size() || channel >= wire::kTactorCount) return;
  ++confusion_[order_[done_++]][channel];
}

double clear_level(double threshold, double ceiling) noexcept {
  return std::sqrt(threshold * ceiling);
}

}  // namespace secondskin::coach
