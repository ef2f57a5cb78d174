#pragma once

#include <cstddef>
#include <cstdint>
#include <span>

/// A byte link to a device: a serial port, a pseudo-terminal, a recorded file, a test's vector.
namespace secondskin::wire {

class ByteLink {
 public:
  virtual ~ByteLink() = default;
  /// Writes as many bytes as fit now without waiting. @returns how many; 0 when full or not
  /// connected
  virtual std::size_t write_some(std::span<const std::uint8_t> bytes) noexcept = 0;
  /// Reads what has arrived, without waiting. @returns how many bytes
  virtual std::size_t read_some(std::span<std::uint8_t> bytes) noexcept = 0;
  /// Whether the device is there. A lost port may come back.
  virtual bool connected() const noexcept = 0;
  /// Bytes accepted by write_some that are still on this side of the wire, where the device can
  /// tell.
  virtual std::size_t unsent() const noexcept { return 0; }
};

}  // namespace secondskin::wire
