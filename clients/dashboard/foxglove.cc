#include "clients/dashboard/foxglove.h"

#include <fmt/format.h>

#include <limits>
#include <nlohmann/json.hpp>
#include <stdexcept>

namespace secondskin::dashboard::foxglove {
namespace {

using Json = nlohmann::json;

constexpr std::uint8_t kMessageData = 1;        // server to client
constexpr std::uint8_t kClientMessageData = 1;  // client to server
constexpr std::size_t kClientHeadSize = 5;

template <class Unsigned>
void put_little_endian(Unsigned value, std::uint8_t* to) noexcept {
  for (std::size_t i = 0; i < sizeof(value); ++i) to[i] = static_cast<std::uint8_t>(value >> 8 * i);
}

// Texts from outside may hold bytes that are no UTF-8; they are replaced, not thrown at.
std::string dumped(const Json& json) {
  return json.dump(-1, ' ', false, Json::error_handler_t::replace);
}

// A refusal in words; parse_text() catches it.
struct Refusal : std::runtime_error {
  using std::runtime_error::runtime_error;
};

const Json& array_of(const Json& message, const char* op, const char* field) {
  const auto found = message.find(field);
  if (found == message.end() || !found->is_array()) {
    throw Refusal(fmt::format("{}: field '{}': expected an array", op, field));
  }
  return *found;
}

std::uint32_t number(const Json& value, const std::string& where) {
  if (!value.is_number_integer() || value < 0 ||
      value > std::numeric_limits<std::uint32_t>::max()) {
    throw Refusal(fmt::format("{}: expected a whole number of 32 bits", where));
  }
  return value.get<std::uint32_t>();
}

std::uint32_t number_of(const Json& object, const char* op, const char* field) {
  const auto where = fmt::format("{}: field '{}'", op, field);
  const auto found = object.is_object() ? object.find(field) : object.end();
  if (!object.is_object() || found == object.end()) {
    throw Refusal(where + ": expected a whole number of 32 bits");
  }
  return number(*found, where);
}

std::string text_of(const Json& object, const char* op, const char* field) {
  if (!object.is_object() || !object.contains(field) || !object[field].is_string()) {
    throw Refusal(fmt::format("{}: field '{}': expected a text", op, field));
  }
  return object[field].get<std::string>();
}

std::vector<std::uint32_t> numbers(const Json& message, const char* op, const char* field) {
  std::vector<std::uint32_t> found;
  for (const Json& value : array_of(message, op, field)) {
    found.push_back(number(value, fmt::format("{}: field '{}'", op, field)));
  }
  return found;
}

ClientText parsed(std::string_view text) {
  const Json message = Json::parse(text, nullptr, false);
  if (message.is_discarded()) throw Refusal("a text message: expected JSON");
  const std::string op = text_of(message, "a text message", "op");
  if (op == "subscribe") {
    Subscribe subscribe;
    for (const Json& one : array_of(message, "subscribe", "subscriptions")) {
      subscribe.subscriptions.push_back(
          {number_of(one, "subscribe", "id"), number_of(one, "subscribe", "channelId")});
    }
    return subscribe;
  }
  if (op == "unsubscribe") return Unsubscribe{numbers(message, "unsubscribe", "subscriptionIds")};
  if (op == "advertise") {
    ClientAdvertise advertise;
    for (const Json& one : array_of(message, "advertise", "channels")) {
      advertise.channels.push_back({number_of(one, "advertise", "id"),
                                    text_of(one, "advertise", "topic"),
                                    text_of(one, "advertise", "encoding")});
    }
    return advertise;
  }
  if (op == "unadvertise") return ClientUnadvertise{numbers(message, "unadvertise", "channelIds")};
  throw Refusal(fmt::format(
      "op '{:.40}': expected 'subscribe', 'unsubscribe', 'advertise' or 'unadvertise'", op));
}

}  // namespace

std::string server_info(std::string_view name, std::string_view session_id) {
  return dumped({{"op", "serverInfo"},
                 {"name", name},
                 {"capabilities", {"clientPublish"}},
                 {"supportedEncodings", {"json", "cdr"}},
                 {"metadata", Json::object()},
                 {"sessionId", session_id}});
}

std::string advertise(std::span<const Channel> channels) {
  Json list = Json::array();
  for (const Channel& channel : channels) {
    list.push_back({{"id", channel.id},
                    {"topic", channel.topic},
                    {"encoding", channel.encoding},
                    {"schemaName", channel.schema_name},
                    {"schema", channel.schema},
                    {"schemaEncoding", channel.schema_encoding}});
  }
  return dumped({{"op", "advertise"}, {"channels", std::move(list)}});
}

std::string unadvertise(std::span<const std::uint32_t> channels) {
  return dumped({{"op", "unadvertise"},
                 {"channelIds", std::vector<std::uint32_t>(channels.begin(), channels.end())}});
}

std::string status(Level level, std::string_view message) {
  return dumped({{"op", "status"}, {"level", static_cast<int>(level)}, {"message", message}});
}

std::array<std::uint8_t, kMessageHeadSize> message_head(std::uint32_t subscription,
                                                        std::int64_t time_ns) noexcept {
  std::array<std::uint8_t, kMessageHeadSize> head{kMessageData};
  put_little_endian(subscription, head.data() + 1);
  put_little_endian(static_cast<std::uint64_t>(time_ns), head.data() + 5);
  return head;
}

tl::expected<ClientText, std::string> parse_text(std::string_view text) {
  try {
    return parsed(text);
  } catch (const Refusal& refusal) {
    return tl::unexpected(std::string(refusal.what()));
  }
}

tl::expected<ClientMessage, std::string> parse_binary(std::span<const std::uint8_t> bytes) {
  if (bytes.empty() || bytes[0] != kClientMessageData) {
    return tl::unexpected(fmt::format("a binary message: found opcode {}, expected 1",
                                      bytes.empty() ? "none" : std::to_string(bytes[0])));
  }
  if (bytes.size() < kClientHeadSize) {
    return tl::unexpected(fmt::format("a binary message: found {} bytes, expected at least {}",
                                      bytes.size(), kClientHeadSize));
  }
  std::uint32_t channel = 0;
  for (std::size_t i = 0; i < 4; ++i) channel |= static_cast<std::uint32_t>(bytes[1 + i]) << 8 * i;
  return ClientMessage{channel, bytes.subspan(kClientHeadSize)};
}

}  // namespace secondskin::dashboard::foxglove
