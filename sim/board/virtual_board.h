#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <string>

#include "wire/tactor_protocol.h"
#include "wire/tactor_waveform.h"

/// The tactor board (Second Skin, chapter 4) in software: the same bytes in, the drive of sixteen
/// tactors out. Pure: time is passed in, monotonic [s], and never goes back.
namespace secondskin::sim {

struct VirtualBoardConfig {
  /// What hangs on each channel; voice coils unless said otherwise.
  std::array<wire::Actuator, wire::kTactorCount> actuators{};
  /// Everything is turned off after this long without a byte [s]; infinity for the paper's
  /// firmware, which has no watchdog.
  double watchdog = wire::kBoardWatchdog;
};

struct VirtualBoardCounters {
  std::uint64_t bytes = 0;           ///< received
  std::uint64_t commands = 0;        ///< pairs understood
  std::uint64_t dropped_bytes = 0;   ///< lost to resynchronisation (CommandParser)
  std::uint64_t watchdog_trips = 0;  ///< times that the watchdog had something to turn off
};

class VirtualBoard {
 public:
  /// @throws std::invalid_argument if the watchdog is not positive
  explicit VirtualBoard(const VirtualBoardConfig& config = {}, double now = 0.0);

  /// Takes bytes that arrived at this time.
  void receive(std::span<const std::uint8_t> bytes, double now) noexcept;
  /// Lets the time pass: watchdog, patterns, actuators.
  void step(double now) noexcept;

  /// Drive of each tactor at the last step, as a share of full voltage: 0 to 1.
  const std::array<double, wire::kTactorCount>& drive() const noexcept { return drive_; }
  /// How strongly each actuator vibrates at the last step, behind its drive by its rise time: 0
  /// to 1.
  const std::array<double, wire::kTactorCount>& amplitude() const noexcept { return amplitude_; }
  const wire::BoardState& state() const noexcept { return patterns_.state(); }
  std::size_t slots_on() const noexcept;
  /// Whether anything is driven or still vibrates; if not, only bytes can change that.
  bool active() const noexcept;
  VirtualBoardCounters counters() const noexcept;

 private:
  void advance(double now) noexcept;

  double watchdog_;
  double now_;
  double last_byte_;
  wire::CommandParser parser_;
  wire::BoardPatterns patterns_;
  std::array<wire::ActuatorResponse, wire::kTactorCount> actuators_;
  std::array<double, wire::kTactorCount> drive_{};
  std::array<double, wire::kTactorCount> amplitude_{};
  std::uint64_t bytes_ = 0;
  std::uint64_t commands_ = 0;
  std::uint64_t watchdog_trips_ = 0;
};

/// Voltage at a channel's plug (4.1): for a voice coil a square wave of 250 Hz, centred at zero, up
/// to 5 V peak to peak; for a motor direct current, 0 to 5 V.
double voltage_of(wire::Actuator actuator, double drive, double time) noexcept;

/// Sixteen tactors as one line of text, a character each: a dot for off, then 1 to 9.
std::string bars(std::span<const double, wire::kTactorCount> levels);

}  // namespace secondskin::sim
