#include "sim/wearable/inertial_encoder.h"

#include <algorithm>
#include <cmath>

namespace secondskin::sim {

InertialEncoder::InertialEncoder(double period, double start, std::uint64_t seed)
    : period_(period),
      chips_per_sample_(static_cast<double>(wire::kChips) / period),
      next_start_(start),
      random_(static_cast<std::minstd_rand::result_type>(seed % 2147483646U + 1U)) {}

void InertialEncoder::take(const Values& values) noexcept {
  // After a time of silence the samples that were not sent are still counted.
  while (static_cast<double>(n_) >= next_start_) {
    start_ = next_start_;
    next_start_ += period_;
    code_.counter = counter_;
    counter_ = static_cast<std::uint8_t>((counter_ + 1) % wire::kCounterCodes);
  }
  std::normal_distribution<double> noise(0.0, kConverterNoise);
  for (std::size_t i = 0; i < values.size(); ++i) {
    int sum = 0;
    for (int r = 0; r < wire::kReadings; ++r) {
      // Code 512 is the middle: a reading rounds to it from half a count either side.
      const double reading = 512.0 * (1.0 + values[i]) + noise(random_);
      sum += static_cast<int>(std::lround(std::clamp(reading, 0.0, 1023.0)));
    }
    code_.values[i] = modulators_[i](sum);
  }
  chips_ = wire::encode_chips(code_);
  sending_ = true;
}

}  // namespace secondskin::sim
