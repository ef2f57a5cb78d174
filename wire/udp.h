#pragma once

#include <chrono>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <string_view>

/// Datagrams to and from other programs. One thread each.
namespace secondskin::wire {

/// An IPv4 address and a port.
struct UdpPlace {
  std::string address = "127.0.0.1";
  std::uint16_t port = 0;

  /// Reads "PORT" or "ADDRESS:PORT". @throws std::invalid_argument naming what was expected
  static UdpPlace parse(std::string_view text);
  std::string text() const;
};

/// Sends to one place; never waits. Whether anybody listens there makes no difference to it.
class UdpSender {
 public:
  /// @throws std::system_error naming the place
  explicit UdpSender(const UdpPlace& to);
  ~UdpSender();
  UdpSender(const UdpSender&) = delete;
  UdpSender& operator=(const UdpSender&) = delete;

  /// @returns false when it could not leave, or when an earlier one was refused: nobody listens
  bool send(std::span<const std::uint8_t> datagram) noexcept;

 private:
  int fd_;
};

/// Receives what is sent to one place of this machine.
class UdpReceiver {
 public:
  /// @param at  port 0: any free one
  /// @throws std::system_error naming the place, e.g. when another program has it
  explicit UdpReceiver(const UdpPlace& at);
  ~UdpReceiver();
  UdpReceiver(const UdpReceiver&) = delete;
  UdpReceiver& operator=(const UdpReceiver&) = delete;

  const UdpPlace& place() const noexcept { return place_; }

  struct Arrival {
    std::size_t length;     ///< bytes, at most the buffer's
    std::int64_t stamp_ns;  ///< when it reached this machine (the first few: was read), Unix epoch
  };

  /// Waits for the next datagram. @returns empty when none came
  std::optional<Arrival> receive(std::span<std::uint8_t> buffer,
                                 std::chrono::milliseconds at_most) noexcept;

 private:
  UdpPlace place_;
  int fd_;
};

}  // namespace secondskin::wire
