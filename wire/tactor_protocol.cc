#include "wire/tactor_protocol.h"

#include <cmath>

namespace secondskin::wire {
namespace {

constexpr std::size_t kSlotsPerController = kSlotCount / 2;
constexpr std::uint8_t kSecondControllerId = 30;  // 4.2: IDs 30-53

// The ends of the intensity table. Ratios, not differences: a step on the skin is noticed from a
// change of 17-21 %, wherever on the scale it starts.
constexpr double kFaintestLevel = 0.30;
constexpr double kFastestPulse_hz = 15.0;  // 4.3: "up to 15 Hz"
constexpr double kSlowestPulse_hz = 5.0;   // off for 100 ms; slower is late for a correction
constexpr double kShortestTapInterval = 0.040;
constexpr double kLongestTapInterval = 0.120;

using DriveTable = std::array<Drive, 256>;

DriveTable make_drive_table() noexcept {
  DriveTable table;
  for (std::size_t i = 0; i < table.size(); ++i) {
    if (i < kFaintestIntensity) {
      table[i] = {0.0, 0.0, kLongestTapInterval};
      continue;
    }
    const double x =
        static_cast<double>(kStrongestIntensity - i) / (kStrongestIntensity - kFaintestIntensity);
    table[i] = {std::pow(kFaintestLevel, x),
                kFastestPulse_hz * std::pow(kSlowestPulse_hz / kFastestPulse_hz, x),
                kShortestTapInterval * std::pow(kLongestTapInterval / kShortestTapInterval, x)};
  }
  return table;
}

const DriveTable& drive_table() noexcept {
  static const DriveTable table = make_drive_table();
  return table;
}

}  // namespace

std::uint8_t id_of_slot(std::size_t slot) noexcept {
  const std::size_t local = slot % kSlotsPerController;
  const std::size_t gap = local < 8 ? 0 : local < 16 ? 2 : 4;  // IDs 8, 9, 18, 19 do not exist
  const std::size_t base = slot / kSlotsPerController * kSecondControllerId;
  return static_cast<std::uint8_t>(base + local + gap);
}

std::optional<std::size_t> slot_of_id(std::uint8_t id) noexcept {
  const std::size_t controller = id / kSecondControllerId;
  const std::size_t local = id % kSecondControllerId;
  if (controller > 1 || local > 23) return std::nullopt;
  if (local % 10 > 7) return std::nullopt;
  return controller * kSlotsPerController + local - local / 10 * 2;
}

Mode mode_of_slot(std::size_t slot) noexcept {
  const std::size_t local = slot % kSlotsPerController;
  return local < 8 ? Mode::kContinuous : local < 16 ? Mode::kPulsed : Mode::kSaltation;
}

Drive drive_of(std::uint8_t intensity) noexcept { return drive_table()[intensity]; }

std::uint8_t intensity_for_level(double level) noexcept {
  if (!(level > 0.0)) return 0;
  const DriveTable& table = drive_table();
  std::size_t intensity = kFaintestIntensity;
  while (intensity < kStrongestIntensity && table[intensity].level < level) ++intensity;
  return static_cast<std::uint8_t>(intensity);
}

std::array<std::uint8_t, 2> encode(std::size_t slot, std::uint8_t intensity) noexcept {
  return {id_of_slot(slot), intensity < kFaintestIntensity ? std::uint8_t{0} : intensity};
}

std::array<std::uint8_t, 2 * kSlotCount> encode_all_off() noexcept {
  std::array<std::uint8_t, 2 * kSlotCount> bytes{};
  for (std::size_t i = 0; i < kSlotCount; ++i) bytes[2 * i] = id_of_slot(kSlotCount - 1 - i);
  return bytes;
}

std::optional<Command> CommandParser::push(std::uint8_t byte, double time) noexcept {
  if (pending_slot_ && !(time - pending_since_ < kPairTimeout)) {
    pending_slot_.reset();
    ++dropped_bytes_;
  }
  if (pending_slot_) {
    if (byte == 0 || byte >= kFaintestIntensity) {
      const Command command{*pending_slot_, byte};
      pending_slot_.reset();
      return command;
    }
    ++dropped_bytes_;  // the waiting ID; its intensity was lost
  }
  pending_slot_ = slot_of_id(byte);
  if (pending_slot_) {
    pending_since_ = time;
  } else {
    ++dropped_bytes_;
  }
  return std::nullopt;
}

}  // namespace secondskin::wire
