#include "server/wearable/signal/ultrasound.h"

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <numbers>
#include <stdexcept>

namespace secondskin::server {
namespace {

// The Gaussian is cut where it has fallen to 3e-4.
constexpr double kCut = 4.0;
// Packets of the widest vector unit that Eigen may use.
constexpr std::size_t kPacket = 16;
// A quarter of exponentially distributed powers is below this share of their mean.
constexpr double kLowerQuartile = 0.2876820724517809;  // ln(4/3)
// The noise follows what is quieter fast, what is louder slowly: pulses fill slots, too.
constexpr double kQuieter = 0.2, kLouder = 0.02;
// A rise begins where the power is so little of its peak.
constexpr float kFoot = 0.02F;

}  // namespace

double speed_of_sound(double temperature_c) noexcept {
  return 331.3 * std::sqrt(1.0 + temperature_c / 273.15);
}

ArrivalFinder::ArrivalFinder(double sample_rate_hz, double carrier_hz, std::size_t slot_samples) {
  if (!(carrier_hz > kWidthHz && carrier_hz + kWidthHz < 0.5 * sample_rate_hz)) {
    throw std::invalid_argument("the sources' carrier does not fit the sampling rate");
  }
  // Half power at half the width: exp(-4 pi^2 sigma^2 f^2) = 1/2.
  const double sigma = std::sqrt(std::numbers::ln2) / (std::numbers::pi * kWidthHz) *
                       sample_rate_hz;  // [A/D samples]
  half_ = static_cast<std::size_t>(std::ceil(kCut * sigma));
  if (slot_samples < 8 * half_) throw std::invalid_argument("a slot is too short to be filtered");
  const std::size_t taps = (2 * half_ + 1 + kPacket - 1) / kPacket * kPacket;
  cosine_.assign(taps, 0.0F);
  sine_.assign(taps, 0.0F);
  double sum = 0.0;
  for (std::size_t i = 0; i <= 2 * half_; ++i) {
    const double t = static_cast<double>(i) - static_cast<double>(half_);
    sum += std::exp(-0.5 * t * t / (sigma * sigma));
  }
  for (std::size_t i = 0; i <= 2 * half_; ++i) {
    const double t = static_cast<double>(i) - static_cast<double>(half_);
    const double gain = 2.0 * std::exp(-0.5 * t * t / (sigma * sigma)) / sum;
    const double phase = 2.0 * std::numbers::pi * carrier_hz / sample_rate_hz * t;
    cosine_[i] = static_cast<float>(gain * std::cos(phase));
    sine_[i] = static_cast<float>(gain * std::sin(phase));
  }
  signal_.assign(half_ + slot_samples + kPacket, 0.0F);
  power_.assign((slot_samples - half_ - 1) / kStep + 1, 0.0F);
  sorted_ = power_;
}

void ArrivalFinder::forget() noexcept { std::fill(signal_.begin(), signal_.end(), 0.0F); }

std::optional<Arrival> ArrivalFinder::find(std::span<const std::int16_t> slot,
                                           double earliest) noexcept {
  const auto size = signal_.size() - kPacket - half_;
  std::copy_n(signal_.begin() + static_cast<std::ptrdiff_t>(size), half_, signal_.begin());
  for (std::size_t i = 0; i < std::min(size, slot.size()); ++i) {
    signal_[half_ + i] = static_cast<float>(slot[i]);
  }
  // In quadrature, so that the power has no ripple of twice the carrier and needs no low-pass:
  // what remains ends at the band-pass's own edge, below 4.1's 30 kHz.
  using Taps = Eigen::Map<const Eigen::VectorXf>;
  const auto taps = static_cast<Eigen::Index>(cosine_.size());
  const Taps cosine(cosine_.data(), taps), sine(sine_.data(), taps);
  for (std::size_t i = 0; i < power_.size(); ++i) {
    const Taps x(signal_.data() + kStep * i, taps);
    const float re = x.dot(cosine), im = x.dot(sine);
    power_[i] = re * re + im * im;
  }
  estimate_noise();

  // Sound spreads: what comes late was louder for its age, so powers are compared as they would be
  // at one distance.
  const auto least = static_cast<float>(kWellAbove * noise_);
  const auto loudness = [&](std::size_t i) {
    const auto age = static_cast<float>(i);
    return power_[i] * age * age;
  };
  float loudest = 0.0F;
  for (std::size_t i = 0; i < power_.size(); ++i) {
    if (power_[i] > least) loudest = std::max(loudest, loudness(i));
  }
  std::size_t top = 0;
  bool rising = false;
  for (std::size_t i = 1; i < power_.size(); ++i) {
    if (!rising) {
      rising = power_[i] > power_[i - 1] && power_[i] > least;
      top = i;
    } else if (power_[i] > power_[top]) {
      top = i;
    } else if (power_[i] < static_cast<float>(kFallen) * power_[top]) {
      rising = false;
      if (loudness(top) < static_cast<float>(kShareOfLoudest) * loudest) continue;
      const auto arrival = rise_to(top);
      if (arrival && arrival->inflection >= earliest) return arrival;
    }
  }
  return std::nullopt;
}

void ArrivalFinder::estimate_noise() noexcept {
  std::copy(power_.begin(), power_.end(), sorted_.begin());
  const auto quarter = sorted_.begin() + static_cast<std::ptrdiff_t>(sorted_.size() / 4);
  std::nth_element(sorted_.begin(), quarter, sorted_.end());
  const double now = std::max(static_cast<double>(*quarter) / kLowerQuartile, kLeastNoise);
  noise_ += noise_ == 0.0 ? now : (now < noise_ ? kQuieter : kLouder) * (now - noise_);
}

// The largest gradient of the rise that ends at a peak, to a part of an A/D sample.
std::optional<Arrival> ArrivalFinder::rise_to(std::size_t peak) const noexcept {
  const float foot = kFoot * power_[peak];
  std::size_t best = 0;
  float steepest = 0.0F;
  for (std::size_t i = peak; i-- > 0;) {  // the gradient between i and i + 1
    const float gradient = power_[i + 1] - power_[i];
    if (gradient > steepest) {
      steepest = gradient;
      best = i;
    }
    if (power_[i] < foot) break;
  }
  if (!(steepest > 0.0F) || best == 0 || best + 2 >= power_.size()) return std::nullopt;
  const double before = power_[best] - power_[best - 1];
  const double here = steepest;
  const double after = power_[best + 2] - power_[best + 1];
  const double bend = before - 2.0 * here + after;
  const double shift = bend < 0.0 ? std::clamp(0.5 * (before - after) / bend, -0.5, 0.5) : 0.0;
  Arrival arrival;
  arrival.inflection = static_cast<double>(kStep) * (static_cast<double>(best) + 0.5 + shift);
  arrival.peak = power_[peak];
  arrival.noise = noise_;
  return arrival;
}

double signal_confidence(double share) noexcept {
  const double missing = (DistanceTracker::kStrong - share) / DistanceTracker::kStrong;
  if (!(missing > 0.0)) return 1.0;
  const double x = missing / DistanceTracker::kWeakness;
  return 1.0 / (1.0 + x * x);
}

double continuity_confidence(double speed) noexcept {
  constexpr double kFall = DistanceTracker::kJumpSpeed - DistanceTracker::kSteadySpeed;
  return std::clamp((DistanceTracker::kJumpSpeed - std::abs(speed)) / kFall, 0.0, 1.0);
}

DistanceTracker::Result DistanceTracker::add(const Arrival& arrival, double time,
                                             const SourceCalibration& source,
                                             double metres_per_sample) noexcept {
  Result result;
  result.distance = std::max(0.0, metres_per_sample * (arrival.inflection - source.offset));
  result.w_s =
      signal_confidence(arrival.peak * result.distance * result.distance / source.strength);
  const double since = time - last_time_;
  result.w_t = has_last_ && since > 0.0 && since <= kNeighbour
                   ? continuity_confidence((result.distance - last_distance_) / since)
                   : kUnknownContinuity;
  last_distance_ = result.distance;
  last_time_ = time;
  has_last_ = true;
  return result;
}

}  // namespace secondskin::server
