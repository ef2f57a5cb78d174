#pragma once

#include <array>
#include <span>

#include "wire/tactor_waveform.h"

/// From commands to what each tactor does: pure, for tests, figures and simulated learners. The
/// live path goes through the driver and the board instead, which obey the same rules.
namespace secondskin::coach {

/// The whole board for a while.
struct TimedCommand {
  double time = 0.0;  ///< when it takes effect [s]
  wire::BoardState board{};
  double valid_for = 0.0;  ///< everything is off after this long without a newer one [s]
};

struct EnvelopeSample {
  std::array<double, wire::kTactorCount> drive{};      ///< share of full voltage, 0 to 1
  std::array<double, wire::kTactorCount> vibration{};  ///< the actuator's, behind it, 0 to 1
};

/// Drive and vibration at from, from + step, ... Patterns and rises are wire/tactor_waveform.h's;
/// of both directions of one saltation the stronger runs, as the driver has it.
/// @param commands  by time; one that is not finite is left out
/// @param out       one sample a step; vibration is integrated from rest at `from` in these steps
void render_envelope(std::span<const TimedCommand> commands,
                     const std::array<wire::Actuator, wire::kTactorCount>& actuators, double from,
                     double step, std::span<EnvelopeSample> out) noexcept;

}  // namespace secondskin::coach
