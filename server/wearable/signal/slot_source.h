#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>

#include "motion/garment.h"
#include "server/pose_source.h"
#include "wire/garment_stream.h"

/// A garment's slots from a recorded file, a port or a socket: what measurements and calibration
/// both begin with.
namespace secondskin::server {

class SlotSource {
 public:
  /// @param place  a .garment file; a serial port or pseudo-terminal (not there yet is well); or
  ///               ADDRESS:PORT, e.g. 127.0.0.1:7000, where the driver box's stream is served
  /// @throws std::runtime_error naming the place
  explicit SlotSource(const std::string& place);
  ~SlotSource();

  /// Whether slots come as they are measured.
  bool live() const noexcept;

  /// Gives the next slot; waits for it, but not longer than a quarter of a second.
  /// @param slot  set on kPose; valid until the next call
  [[nodiscard]] Next next(const wire::GarmentSlot*& slot);

  /// A file starts again. @returns false for what cannot.
  bool rewind();

  /// Empty until the first slot has come.
  const std::optional<wire::GarmentStreamHeader>& header() const noexcept;
  const wire::GarmentStreamCounters& counters() const noexcept;
  bool connected() const noexcept;
  /// What is wrong with port or socket; empty when nothing is.
  std::string trouble() const;
  const std::string& place() const noexcept;

 private:
  struct State;
  std::unique_ptr<State> state_;
};

/// @throws std::runtime_error naming the place and what differs, when a stream is another
/// garment's.
void check_stream(const wire::GarmentStreamHeader& header, const Garment& garment,
                  const std::string& place);

}  // namespace secondskin::server
