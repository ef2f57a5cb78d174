#pragma once

#include <string>

#include "wire/byte_link.h"

/// A TCP connection to a device's server: never waits, comes back after it was lost. One thread.
namespace secondskin::wire {

class TcpClient final : public ByteLink {
 public:
  static constexpr double kRetryInterval = 0.25;  ///< between two attempts to connect [s]

  /// Connects to nothing yet; poll() does. @param address  IPv4, e.g. "127.0.0.1"
  /// @throws std::invalid_argument for anything else
  TcpClient(const std::string& address, unsigned port);
  ~TcpClient() override;
  TcpClient(const TcpClient&) = delete;
  TcpClient& operator=(const TcpClient&) = delete;

  /// Notices a lost connection, and tries to make a new one at most every kRetryInterval. Call it
  /// regularly. @param now  monotonic [s]; @returns connected()
  bool poll(double now) noexcept;

  std::size_t write_some(std::span<const std::uint8_t> bytes) noexcept override;
  std::size_t read_some(std::span<std::uint8_t> bytes) noexcept override;
  bool connected() const noexcept override { return connected_; }

  /// How often it was connected: a change means a fresh connection.
  std::uint64_t openings() const noexcept { return openings_; }
  /// For poll(2); -1 while there is none. The client keeps ownership.
  int fd() const noexcept { return connected_ ? fd_ : -1; }
  /// What went wrong last; empty while connected.
  std::string last_error() const;

 private:
  void lose(int error) noexcept;

  std::string address_;
  unsigned port_;
  int fd_ = -1;
  bool connected_ = false;
  std::uint64_t openings_ = 0;
  double last_attempt_;
  int error_ = 0;
};

}  // namespace secondskin::wire
