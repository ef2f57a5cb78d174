#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <string>
#include <string_view>
#include <tl/expected.hpp>
#include <utility>
#include <variant>
#include <vector>

/// The Foxglove WebSocket protocol v1 (github.com/foxglove/ws-protocol, docs/spec.md), the part
/// that a bridge with client publishing needs. Pure: bytes and texts, no sockets.
namespace secondskin::dashboard::foxglove {

/// What a client may ask for; the messages that we use are the same in both.
inline constexpr std::array<std::string_view, 2> kSubprotocols{"foxglove.websocket.v1",
                                                               "foxglove.sdk.v1"};

// ---- server to client

/// A topic as clients see it.
struct Channel {
  std::uint32_t id = 0;
  std::string topic;
  std::string encoding;         ///< of the messages, e.g. "cdr"
  std::string schema_name;      ///< e.g. "secondskin_msgs::msg::SkeletonPose"
  std::string schema;           ///< the text
  std::string schema_encoding;  ///< e.g. "omgidl"
};

enum class Level : std::uint8_t { kInfo, kWarning, kError };

/// @param session_id  another one tells clients that this is another server
std::string server_info(std::string_view name, std::string_view session_id);
std::string advertise(std::span<const Channel> channels);
std::string unadvertise(std::span<const std::uint32_t> channels);
std::string status(Level level, std::string_view message);

/// What precedes a message's bytes: opcode, subscription, time.
inline constexpr std::size_t kMessageHeadSize = 13;
std::array<std::uint8_t, kMessageHeadSize> message_head(std::uint32_t subscription,
                                                        std::int64_t time_ns) noexcept;

// ---- client to server

struct Subscription {
  std::uint32_t id = 0;  ///< the client's
  std::uint32_t channel = 0;
};
struct Subscribe {
  std::vector<Subscription> subscriptions;
};
struct Unsubscribe {
  std::vector<std::uint32_t> subscriptions;
};

/// A topic that a client is going to publish.
struct ClientChannel {
  std::uint32_t id = 0;  ///< the client's
  std::string topic;
  std::string encoding;
};
struct ClientAdvertise {
  std::vector<ClientChannel> channels;
};
struct ClientUnadvertise {
  std::vector<std::uint32_t> channels;
};

using ClientText = std::variant<Subscribe, Unsubscribe, ClientAdvertise, ClientUnadvertise>;

/// @returns what the client asks, or a sentence that names the field and what was expected.
tl::expected<ClientText, std::string> parse_text(std::string_view text);

struct ClientMessage {
  std::uint32_t channel = 0;  ///< the client's id of it
  std::span<const std::uint8_t> payload;
};

/// The payload lies in `bytes`. @returns the message, or a sentence as above.
tl::expected<ClientMessage, std::string> parse_binary(std::span<const std::uint8_t> bytes);

}  // namespace secondskin::dashboard::foxglove
