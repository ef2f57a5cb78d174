#pragma once

#include <array>
#include <cstdint>

#include "wire/tactor_protocol.h"

/// What each tactor's drive does over time under a board state: the one renderer that the coach's
/// checks, the virtual board and the dashboard share. Pure: time is passed in.
///
/// Modes on one tactor at once: at each instant the strongest of them drives it (maximum, never a
/// sum, so no combination exceeds the strongest single command). Forward and reverse saltation of
/// one group exclude each other: the one commanded last runs and the other's slot is off.
namespace secondskin::wire {

/// Which kind of actuator hangs on a channel (section 4.3).
enum class Actuator : std::uint8_t {
  kVoiceCoil,  ///< 250 Hz square wave, starts and stops in 5 ms
  kDcMotor,    ///< direct current, starts and stops in 100 ms
};
inline constexpr double kVoiceCoilFrequency = 250.0;  ///< [Hz], 4: most sensitive for the skin
inline constexpr double kVoiceCoilRise = 0.005;       ///< [s], 4.3
inline constexpr double kDcMotorRise = 0.100;         ///< [s], 4.3
inline constexpr double kTapDuration = 0.030;         ///< a saltation tap is on for this [s]
inline constexpr int kTapsPerSite = 2;                ///< 4.2: each tactor twice, then the next

/// The state of the board's pattern generators. Value type; no allocation.
class BoardPatterns {
 public:
  /// Takes one command at a time [s]. A slot whose intensity changes while on keeps its phase, also
  /// when its rate changes; a slot that starts begins its pattern with a pulse or tap at once.
  void apply(const Command& command, double time) noexcept;
  void all_off() noexcept;

  /// Drive of each tactor at an instant, as a share of full voltage (0 to 1), before the actuator's
  /// own rise. Zero for every tactor when every slot is off; a slot that is on drives each of its
  /// tactors at least once in a period of its pattern.
  void drive(double time, std::array<double, kTactorCount>& level) const noexcept;

  const BoardState& state() const noexcept { return state_; }

 private:
  double phase_of(std::size_t slot, double time) const noexcept;

  BoardState state_{};
  std::array<double, kSlotCount> since_{};  ///< when each slot last changed [s]
  std::array<double, kSlotCount> phase_{};  ///< its pattern's phase then: pulses or taps begun
};

/// First-order rise and fall of an actuator's vibration towards its drive; reaches 95 % of a step
/// in the rise time.
class ActuatorResponse {
 public:
  explicit ActuatorResponse(Actuator kind) noexcept;
  /// @param dt  time since the last call [s]; @returns the vibration's amplitude, 0 to 1
  double step(double drive, double dt) noexcept;

 private:
  double time_constant_;
  double amplitude_ = 0.0;
};

}  // namespace secondskin::wire
