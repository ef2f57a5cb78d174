#pragma once

#include <cstdint>

#include "wire/byte_link.h"

/// The device's side of a TCP connection on this machine (127.0.0.1): serves one client at a time,
/// the newest. Never waits; one thread.
namespace secondskin::wire {

class TcpListener final : public ByteLink {
 public:
  /// @param port  0: any that is free
  /// @throws std::system_error naming the port
  explicit TcpListener(std::uint16_t port);
  ~TcpListener() override;
  TcpListener(const TcpListener&) = delete;
  TcpListener& operator=(const TcpListener&) = delete;

  std::uint16_t port() const noexcept { return port_; }
  /// Takes a client that waits, in place of the one before. Call it regularly.
  /// @returns connected()
  bool poll() noexcept;

  std::size_t write_some(std::span<const std::uint8_t> bytes) noexcept override;
  std::size_t read_some(std::span<std::uint8_t> bytes) noexcept override;
  bool connected() const noexcept override { return client_ >= 0; }
  /// How many clients there have been: a change means a fresh connection.
  std::uint64_t openings() const noexcept { return openings_; }

 private:
  void hang_up() noexcept;

  int fd_ = -1, client_ = -1;
  std::uint16_t port_ = 0;
  std::uint64_t openings_ = 0;
};

}  // namespace secondskin::wire
