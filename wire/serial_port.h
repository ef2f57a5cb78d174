#pragma once

#include <cstdint>
#include <string>

#include "wire/byte_link.h"

/// A serial port, or a pseudo-terminal in its place: raw, 8N1, never waits, comes back after it
/// vanished. Plain termios; one thread.
namespace secondskin::wire {

class SerialPort final : public ByteLink {
 public:
  static constexpr double kRetryInterval = 0.25;  ///< between two attempts to open [s]
  static constexpr unsigned kBaudRate = 115'200;  ///< the board's Bluetooth module

  /// Opens nothing yet; poll() does.
  /// @param path       the device, e.g. "/dev/ttyUSB0", or a link to one
  /// @param baud_rate  one of the standard rates from 1,200 (slower ones tear pairs apart: a byte
  ///                   would take longer than CommandParser's patience) to 921,600
  /// @throws std::invalid_argument for an empty path or another rate
  explicit SerialPort(std::string path, unsigned baud_rate = kBaudRate);
  ~SerialPort() override;
  SerialPort(const SerialPort&) = delete;
  SerialPort& operator=(const SerialPort&) = delete;

  /// Notices a port that vanished, and tries to open a missing one at most every kRetryInterval.
  /// Call it regularly. @param now  monotonic [s]; @returns connected()
  bool poll(double now) noexcept;

  std::size_t write_some(std::span<const std::uint8_t> bytes) noexcept override;
  std::size_t read_some(std::span<std::uint8_t> bytes) noexcept override;
  bool connected() const noexcept override { return fd_ >= 0; }
  std::size_t unsent() const noexcept override;

  /// How often it was opened: a change means a fresh connection.
  std::uint64_t openings() const noexcept { return openings_; }
  /// For poll(2) and the guardian; -1 while not connected. The port keeps ownership.
  int fd() const noexcept { return fd_; }
  /// What went wrong last, naming the path and what to do; empty if nothing did since it was
  /// opened.
  std::string last_error() const;
  const std::string& path() const noexcept { return path_; }
  /// Bytes a second on the wire: a tenth of the baud rate (start bit, eight, stop bit).
  double byte_rate() const noexcept { return baud_rate_ / 10.0; }

 private:
  enum class Trouble : std::uint8_t { kNone, kOpen, kSettings, kLost };

  void open() noexcept;
  void lose(Trouble trouble, int error) noexcept;

  std::string path_;
  unsigned baud_rate_;
  unsigned speed_;  ///< termios' code of the baud rate
  int fd_ = -1;
  std::uint64_t openings_ = 0;
  double last_attempt_;
  Trouble trouble_ = Trouble::kNone;
  int error_ = 0;
};

}  // namespace secondskin::wire
