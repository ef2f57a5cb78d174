#include "server/optical/track/value_gate.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <stdexcept>

namespace secondskin::server {
namespace {

constexpr float kDoubtless = 1.5F;  // the mean of a few squares is above 1 by chance, too
constexpr float kRate = 0.15F;
constexpr float kMostDoubtful = 25.0F;  // one wild value says no more than this

}  // namespace

ValueGate::ValueGate(std::size_t detectors, std::size_t projectors, const ValueNoise& noise)
    : gate_(noise.gate * noise.gate),
      variance_(1.0 / 12.0 + noise.count_sigma * noise.count_sigma +
                noise.model_sigma * noise.model_sigma),
      doubts_(detectors * projectors, kFirstDoubt),
      counts_(detectors),
      projectors_(projectors) {
  if (!(noise.count_sigma >= 0.0 && noise.model_sigma >= 0.0 && std::isfinite(variance_))) {
    throw std::invalid_argument(
        fmt::format("count_sigma and model_sigma: expected at least 0 counts, found {} and {}",
                    noise.count_sigma, noise.model_sigma));
  }
  if (!(noise.gate > 0.0)) {
    throw std::invalid_argument(
        fmt::format("gate: expected more than 0 standard deviations, found {}", noise.gate));
  }
}

std::optional<double> ValueGate::admit(std::size_t detector, std::size_t projector, double nu,
                                       double normalised_square) noexcept {
  float& doubt = doubts_[detector * projectors_.size() + projector];
  const double variance = variance_ * static_cast<double>(std::max(1.0F, doubt / kDoubtless));
  const bool fits = normalised_square <= gate_;  // not for NaN
  // fmin gives the other one for NaN.
  doubt += kRate * (std::fmin(static_cast<float>(normalised_square), kMostDoubtful) - doubt);
  if (!fits) {
    leave_out(detector, projector);
    return std::nullopt;
  }
  ++counts_[detector].used;
  ProjectorCounts& counts = projectors_[projector];
  ++counts.used;
  counts.innovation_sum += nu;
  counts.innovation_squares += nu * nu;
  return variance;
}

}  // namespace secondskin::server
