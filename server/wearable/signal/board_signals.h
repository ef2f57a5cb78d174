#pragma once

#include <memory>
#include <optional>
#include <span>
#include <vector>

#include "motion/garment.h"
#include "server/wearable/signal/inertial_decoder.h"
#include "server/wearable/signal/ultrasound.h"
#include "wire/garment_stream.h"

/// From a driver box's slots to what the boards' signals say, not yet in physical units: arrivals
/// of sound and inertial codes. One thread; no allocation after construction.
namespace secondskin::server {

/// How one board's signal fares.
struct BoardHealth {
  InertialCounts inertial;
  bool locked = false;
  double level = 0.0;          ///< of the digital stream [A/D counts]
  double chip_noise = 0.0;     ///< of its chips, after the low-pass [A/D counts]
  double ambient_noise = 0.0;  ///< power in the ultrasonic band [A/D counts^2]
  std::uint64_t arrivals = 0;  ///< slots in which a pulse was heard
  std::uint64_t unheard = 0;   ///< slots in which none was
  std::uint64_t clipped = 0;   ///< A/D samples at the converter's ends
};

class BoardSignals {
 public:
  /// After a gap of more slots than this everything is looked for anew.
  static constexpr std::uint32_t kBridgedSlots = 125;

  /// @throws std::invalid_argument when the garment's rates do not fit the decoders
  explicit BoardSignals(const Garment& garment);

  /// Takes the next slot. Slots that are missing before it are bridged: their inertial samples are
  /// lost, the locks are kept. @pre the slot has the garment's boards and samples
  void process(const wire::GarmentSlot& slot) noexcept;

  /// Of the last slot, one per board.
  std::span<const std::optional<Arrival>> arrivals() const noexcept { return arrivals_; }
  /// Samples that the last slot completed. Their start counts from slot 0 of the stream.
  std::span<const InertialSample> inertial(std::size_t board) const noexcept {
    return channels_[board]->samples;
  }
  /// Where the last slot begins and ends, from slot 0 of the stream [A/D samples].
  double slot_begin() const noexcept { return begin_; }
  double slot_end() const noexcept { return begin_ + static_cast<double>(slot_samples_); }

  BoardHealth health(std::size_t board) const noexcept;

 private:
  struct Channel {
    Channel(const Garment& garment, double period);
    InertialDecoder decoder;
    ArrivalFinder finder;
    std::vector<InertialSample> samples;
    std::uint64_t arrivals = 0, unheard = 0, clipped = 0;
  };

  void bridge(std::uint32_t missing) noexcept;
  void decode(Channel& channel, std::span<const std::int16_t> signal) noexcept;

  double period_;  ///< of inertial samples [A/D samples]
  std::size_t slot_samples_;
  std::vector<std::unique_ptr<Channel>> channels_;
  std::vector<std::optional<Arrival>> arrivals_;
  std::vector<std::int16_t> nothing_;
  std::optional<std::uint32_t> last_;
  double begin_ = 0.0;
  double origin_ = 0.0;  ///< position 0 of the decoders
};

}  // namespace secondskin::server
