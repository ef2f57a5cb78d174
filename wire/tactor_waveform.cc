#include "wire/tactor_waveform.h"

#include <algorithm>
#include <cmath>

namespace secondskin::wire {
namespace {

constexpr std::size_t kTactorsPerGroup = 4;
constexpr std::size_t kFirstSaltation = 16;  // of a controller's slots

/// Rounding must not delay a pulse or tap past its exact instant.
constexpr double kPhaseTolerance = 1e-9;

struct Saltation {
  std::size_t first_tactor;
  bool reverse;
};

Saltation saltation_of(std::size_t slot) noexcept {
  const std::size_t controller = slot / 20;
  const std::size_t local = slot % 20 - kFirstSaltation;
  return {controller * kTactorsPerController + local / 2 * kTactorsPerGroup, local % 2 == 1};
}

std::size_t opposite_saltation(std::size_t slot) noexcept {
  return slot % 2 == 0 ? slot + 1 : slot - 1;
}

}  // namespace

double BoardPatterns::phase_of(std::size_t slot, double time) const noexcept {
  const double elapsed = std::max(0.0, time - since_[slot]);
  const Drive drive = drive_of(state_[slot]);
  switch (mode_of_slot(slot)) {
    case Mode::kPulsed:
      return phase_[slot] + elapsed * drive.pulse_rate_hz;
    case Mode::kSaltation:
      return phase_[slot] + elapsed / drive.tap_interval;
    case Mode::kContinuous:
      break;
  }
  return 0.0;
}

void BoardPatterns::apply(const Command& command, double time) noexcept {
  const std::size_t slot = command.slot;
  if (slot >= kSlotCount) return;
  const std::uint8_t intensity =
      command.intensity < kFaintestIntensity ? std::uint8_t{0} : command.intensity;
  if (intensity == state_[slot]) return;
  phase_[slot] = state_[slot] == 0 ? 0.0 : phase_of(slot, time);
  since_[slot] = time;
  state_[slot] = intensity;
  if (intensity != 0 && mode_of_slot(slot) == Mode::kSaltation) {
    state_[opposite_saltation(slot)] = 0;
  }
}

void BoardPatterns::all_off() noexcept { state_.fill(0); }

void BoardPatterns::drive(double time, std::array<double, kTactorCount>& level) const noexcept {
  level.fill(0.0);
  for (std::size_t slot = 0; slot < kSlotCount; ++slot) {
    if (state_[slot] == 0) continue;
    const Drive drive = drive_of(state_[slot]);
    const std::size_t controller = slot / 20;
    std::size_t tactor = controller * kTactorsPerController + slot % 20 % 8;
    switch (mode_of_slot(slot)) {
      case Mode::kContinuous:
        break;
      case Mode::kPulsed: {
        const double phase = phase_of(slot, time) + kPhaseTolerance;
        if (phase - std::floor(phase) >= 0.5) continue;
        break;
      }
      case Mode::kSaltation: {
        const double phase = phase_of(slot, time) + kPhaseTolerance;
        const double taps = std::floor(phase);
        if ((phase - taps) * drive.tap_interval >= kTapDuration) continue;
        const auto site = static_cast<std::size_t>(
            std::fmod(taps, static_cast<double>(kTapsPerSite * kTactorsPerGroup)) / kTapsPerSite);
        const Saltation saltation = saltation_of(slot);
        tactor = saltation.first_tactor + (saltation.reverse ? kTactorsPerGroup - 1 - site : site);
        break;
      }
    }
    level[tactor] = std::max(level[tactor], drive.level);
  }
}

ActuatorResponse::ActuatorResponse(Actuator kind) noexcept
    : time_constant_((kind == Actuator::kVoiceCoil ? kVoiceCoilRise : kDcMotorRise) /
                     std::log(20.0)) {}  // 1 - exp(-rise / tau) = 95 %

double ActuatorResponse::step(double drive, double dt) noexcept {
  if (dt > 0.0) amplitude_ += (drive - amplitude_) * -std::expm1(-dt / time_constant_);
  return amplitude_;
}

}  // namespace secondskin::wire
