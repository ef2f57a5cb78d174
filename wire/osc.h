#pragma once

#include <cstdint>
#include <span>
#include <string_view>
#include <vector>

/// Open Sound Control 1.0, the part that the VMC protocol needs: messages of 32-bit integers,
/// 32-bit floats and strings, in bundles that are due at once. Everything is big-endian and padded
/// to four bytes.
namespace secondskin::wire {

using Datagram = std::vector<std::uint8_t>;

/// One message, built up argument by argument.
class OscMessage {
 public:
  /// @param address  e.g. "/VMC/Ext/OK"; it must outlive the message
  explicit OscMessage(std::string_view address) : address_(address) {}

  OscMessage& add(std::int32_t value);
  OscMessage& add(float value);
  /// A string has no zero byte inside.
  OscMessage& add(std::string_view value);

  Datagram encode() const;

 private:
  std::string_view address_;
  Datagram types_{','};
  Datagram arguments_;
};

/// Bundles with all the messages in their order, none longer than a limit: a message that does not
/// fit any more begins the next one, and one that is longer than the limit has a bundle for itself.
/// @param most_bytes  e.g. an Ethernet frame's room for UDP, 1472
std::vector<Datagram> osc_bundles(std::span<const OscMessage> messages, std::size_t most_bytes);

}  // namespace secondskin::wire
