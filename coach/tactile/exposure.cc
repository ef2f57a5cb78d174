#include "coach/tactile/exposure.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace secondskin::coach {
namespace {

constexpr std::size_t kSitesOfRing = 4;

// First-order approach to `input` while the command lived, then to rest.
double average(double value, double input, double on, double off, double window) noexcept {
  const double then = input + (value - input) * std::exp(-on / window);
  return then * std::exp(-off / window);
}

}  // namespace

MeanDrive mean_drive(const wire::BoardState& board, std::size_t channel) noexcept {
  // The strongest drives at each instant; the sum bounds it from above and is equal for one mode.
  MeanDrive mean;
  const auto add = [&](std::uint8_t intensity, double share) {
    const double level = wire::drive_of(intensity).level;
    if (level <= 0.0) return;
    mean.on += share;
    mean.square += share * level * level;
  };
  add(board[wire::continuous_slot(channel)], 1.0);
  add(board[wire::pulsed_slot(channel)], 0.5);
  for (const bool reverse : {false, true}) {
    const std::uint8_t intensity = board[wire::saltation_slot(channel / kSitesOfRing, reverse)];
    add(intensity,
        wire::kTapDuration / (wire::drive_of(intensity).tap_interval * double{kSitesOfRing}));
  }
  mean.on = std::min(mean.on, 1.0);
  mean.square = std::min(mean.square, 1.0);
  return mean;
}

double daily_exposure(const Tactor& tactor, double dose) noexcept {
  return tactor.acceleration * std::sqrt(dose / kExposureDay);
}

ExposureLimiter::ExposureLimiter(const BodyMap& map, const ExposureState& start) noexcept
    : state_(start) {
  for (const Tactor& tactor : map.tactors) {
    const double share = kDailyExposure / tactor.acceleration;
    limit_[tactor.channel] = {tactor.acceleration > 0.0 ? kExposureDay * share * share
                                                        : std::numeric_limits<double>::infinity(),
                              tactor.actuator == wire::Actuator::kVoiceCoil};
    const SiteExposure& site = state_.sites[tactor.channel];
    resting_[tactor.channel] =
        site.duty > kRestUntilShare * kLongestDuty || site.heat > kRestUntilShare * kHottest;
  }
}

void ExposureLimiter::advance(std::int64_t stamp_ns, const wire::BoardState& board,
                              double lifetime) noexcept {
  const double passed = state_.stamp_ns == 0
                            ? 0.0
                            : std::max(0.0, 1e-9 * static_cast<double>(stamp_ns - state_.stamp_ns));
  state_.stamp_ns = std::max(state_.stamp_ns, stamp_ns);
  const double on = std::min(passed, lifetime), off = passed - on;
  for (std::size_t c = 0; c < wire::kTactorCount; ++c) {
    if (limit_[c].dose <= 0.0) continue;
    SiteExposure& site = state_.sites[c];
    const MeanDrive mean = mean_drive(board, c);
    site.dose += on * mean.square;
    site.duty = average(site.duty, mean.on, on, off, kDutyWindow);
    site.heat =
        limit_[c].heats ? average(site.heat, kHeatAtFull * mean.square, on, off, kHeatWindow) : 0.0;
    if (site.duty > kLongestDuty || site.heat > kHottest) resting_[c] = true;
    if (site.duty < kRestUntilShare * kLongestDuty && site.heat < kRestUntilShare * kHottest) {
      resting_[c] = false;
    }
  }
}

bool ExposureLimiter::rests(std::size_t channel, bool alarm) const noexcept {
  return resting_[channel] ||
         !(state_.sites[channel].dose < (alarm ? 1.0 : kCueShareOfDose) * limit_[channel].dose);
}

}  // namespace secondskin::coach
