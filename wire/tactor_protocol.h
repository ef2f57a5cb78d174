#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>

/// The tactor board's two-byte commands (Second Skin, section 4.2) and what each intensity means.
///
/// A command is an ID byte and an intensity byte. IDs 0-7 drive the first controller's tactors
/// continuously, 10-17 pulse them, 20-23 run saltation over its first four, the same reversed, its
/// last four, the same reversed; 30-53 likewise for the second controller. Sixteen tactors, forty
/// IDs.
///
/// The paper's pairs have no framing. Ours are self-synchronising because the two alphabets do not
/// meet but in 0: every ID is at most 53, and an intensity is 0 (off) or at least
/// kFaintestIntensity = 54; 1-53 are never sent as an intensity. The receiver's rule is in
/// CommandParser, the whole contract in docs/tactors.md.
namespace secondskin::wire {

inline constexpr std::size_t kTactorCount = 16;  ///< 4.1: two controllers of eight
inline constexpr std::size_t kTactorsPerController = 8;
inline constexpr std::size_t kSlotCount = 40;           ///< valid IDs: 20 a controller
inline constexpr std::uint8_t kFaintestIntensity = 54;  ///< smallest intensity that drives
inline constexpr std::uint8_t kStrongestIntensity = 0xFF;
/// Our extension of the firmware: after this long without a byte the board turns everything off
/// [s].
inline constexpr double kBoardWatchdog = 0.250;

enum class Mode : std::uint8_t { kContinuous, kPulsed, kSaltation };

/// Slots number the forty valid IDs in their order: 0-7 continuous, 8-15 pulsed, 16-19 saltation of
/// the first controller, 20-39 the same of the second.
constexpr std::size_t continuous_slot(std::size_t tactor) noexcept {
  return tactor / kTactorsPerController * 20 + tactor % kTactorsPerController;
}
constexpr std::size_t pulsed_slot(std::size_t tactor) noexcept {
  return continuous_slot(tactor) + 8;
}
/// @param group    0-3: tactors 4*group to 4*group+3
/// @param reverse  from the last tactor of the group to the first
constexpr std::size_t saltation_slot(std::size_t group, bool reverse) noexcept {
  return group / 2 * 20 + 16 + group % 2 * 2 + (reverse ? 1 : 0);
}

std::uint8_t id_of_slot(std::size_t slot) noexcept;
std::optional<std::size_t> slot_of_id(std::uint8_t id) noexcept;
Mode mode_of_slot(std::size_t slot) noexcept;

/// What is commanded of the whole board: an intensity a slot. All off when default-constructed.
using BoardState = std::array<std::uint8_t, kSlotCount>;

/// One intensity byte carries both the level and the rate (4.2): the table that coach, renderer and
/// board share. All three are monotone in the intensity i: with x = (255 - i) / 201,
///   level = 0.30^x,  pulse_rate_hz = 15 / 3^x,  tap_interval = 0.040 * 3^x,
/// so that equal steps of the byte are equal ratios on the skin (a step of 30, 20 %, is noticed).
/// Intensities below kFaintestIntensity have level and rate 0 and the longest interval.
struct Drive {
  double level;          ///< share of the full drive voltage, 0 or 0.30 to 1
  double pulse_rate_hz;  ///< pulsed mode: on-off cycles a second, half of each on; 5 to 15 (4.3)
  double tap_interval;   ///< saltation: onset to onset of two taps [s]; 0.120 down to 0.040
};
Drive drive_of(std::uint8_t intensity) noexcept;

/// The smallest intensity whose level is at least this: 0 for a level of 0, less, or NaN; the
/// strongest for a level above 1.
std::uint8_t intensity_for_level(double level) noexcept;

/// The pair of bytes that sets one slot. Intensities of 1 to 53 are sent as 0.
std::array<std::uint8_t, 2> encode(std::size_t slot, std::uint8_t intensity) noexcept;

/// Every ID of both controllers at intensity 0: 80 bytes, 7 ms at 115,200 baud. From ID 53 down to
/// ID 0, for a board that still waits for the intensity of a torn pair: 53 cannot be one, so the
/// board is in step from the first byte and all forty take effect. (Beginning with ID 0 would lose
/// slot 0.)
std::array<std::uint8_t, 2 * kSlotCount> encode_all_off() noexcept;

/// One command as the board understood it.
struct Command {
  std::size_t slot;
  std::uint8_t intensity;
};

/// Reads pairs from a byte stream that may lose, gain or garble bytes, as the firmware does:
/// - expecting an ID: a byte that is none is dropped;
/// - expecting an intensity: 1-53 cannot be one, so the intensity was lost; the byte is taken as a
///   new ID (or dropped if it is none) and the waiting one is forgotten;
/// - a pause of kPairTimeout between the two bytes of a pair forgets the waiting ID.
/// One lost byte therefore never drives a tactor that was not commanded; one garbled or gained byte
/// sets at most one slot wrong, until that slot is next written.
class CommandParser {
 public:
  static constexpr double kPairTimeout = 0.020;  ///< [s]; a Bluetooth link splits packets by less

  /// @param time  when the byte arrived, monotonic [s]
  [[nodiscard]] std::optional<Command> push(std::uint8_t byte, double time) noexcept;

  std::uint64_t dropped_bytes() const noexcept { return dropped_bytes_; }

 private:
  std::optional<std::size_t> pending_slot_;
  double pending_since_ = 0.0;
  std::uint64_t dropped_bytes_ = 0;
};

}  // namespace secondskin::wire
