#include "coach/align/reference_measure.h"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace secondskin::coach {
namespace {

constexpr double kDegree = std::numbers::pi / 180.0;
constexpr double square(double x) { return x * x; }

// Shares are of the typical distance between two of the reference's poses.
constexpr double kZone = 6.0 * kDegree, kZoneShare = 0.15;
constexpr double kEndShare = 0.7;  // of that radius, for the frames that are the end
constexpr double kLostShare = 0.9;
constexpr double kLeastLost = 18.0 * kDegree, kMostLost = 30.0 * kDegree;
constexpr double kMatchShare = 0.85;   // of the lost distance
constexpr double kEndProgress = 0.95;  // the end's neighbourhood begins after this much of the path
constexpr double kRestShare = 0.4;     // of the expert's speed
constexpr double kRestSpeed = 20.0 * kDegree;

}  // namespace

ReferenceMeasure::ReferenceMeasure(const ReferenceFeatures& f, double rate)
    : features(f), rate_hz(rate), frames(f.size()) {
  double sum = 0.0;
  std::size_t pairs = 0;
  const std::size_t step = std::max<std::size_t>(1, frames / 64);
  for (std::size_t a = 0; a < frames; a += step) {
    for (std::size_t b = 0; b < a; b += step, ++pairs) sum += features.distance_square(a, b);
  }
  const double typical = pairs > 0 ? std::sqrt(sum / static_cast<double>(pairs)) : 0.0;
  lost_square = square(std::clamp(kLostShare * typical, kLeastLost, kMostLost));
  match_square = square(kMatchShare) * lost_square;
  radius = std::max(kZone, kZoneShare * typical);
  cyclic = features.distance_square(0, frames - 1) < 2.0 * square(radius);

  path.resize(frames, 0.0);
  double moving = 0.0;
  const auto lag = static_cast<std::size_t>(std::lround(0.1 * rate_hz));
  for (std::size_t i = 1; i < frames; ++i) {
    const std::size_t a = i > lag ? i - lag : 0;
    const double v = std::sqrt(std::max(0.0F, features.distance_square(a, i))) * rate_hz /
                     static_cast<double>(i - a);
    path[i] = path[i - 1] + std::max(0.0, v - kStillSpeed) / rate_hz;
    if (v > kStillSpeed) moving += 1.0 / rate_hz;
  }
  speed = path.back() / std::max(moving, 0.1);
  resting_speed = std::min(kRestSpeed, kRestShare * (speed + kStillSpeed));

  while (start_zone < frames && features.distance_square(0, start_zone) < square(radius)) {
    ++start_zone;
  }
  end_zone = frames - 1;
  while (end_zone > 0 &&
         features.distance_square(frames - 1, end_zone - 1) < square(kEndShare * radius) &&
         path[end_zone - 1] > kEndProgress * path.back()) {
    --end_zone;
  }
  if (end_zone < start_zone) {  // hardly any motion: halves
    start_zone = std::max<std::size_t>(1, frames / 2);
    end_zone = std::min(frames - 1, start_zone);
  }
}

double ReferenceMeasure::path_at(double position) const noexcept {
  const double p = std::clamp(position, 0.0, static_cast<double>(frames - 1));
  const auto i = static_cast<std::size_t>(p);
  if (i + 1 >= frames) return path.back();
  const double u = p - static_cast<double>(i);
  return path[i] + u * (path[i + 1] - path[i]);
}

bool ReferenceMeasure::alike(double a, double b) const noexcept {
  const auto frame = [&](double at) {
    return static_cast<std::size_t>(std::clamp(at + 0.5, 0.0, static_cast<double>(frames - 1)));
  };
  return features.distance_square(frame(a), frame(b)) < square(2.0 * radius);
}

}  // namespace secondskin::coach
