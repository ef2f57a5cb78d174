#pragma once

#include <sys/socket.h>

#include <boost/asio/connect.hpp>
#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <boost/beast/core.hpp>
#include <boost/beast/http.hpp>
#include <boost/beast/websocket.hpp>
#include <map>
#include <nlohmann/json.hpp>
#include <optional>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

/// Blocking clients of the dashboard's port, for tests.
namespace secondskin::dashboard::test {

namespace asio = boost::asio;
namespace beast = boost::beast;
namespace http = beast::http;
using Headers = std::vector<std::pair<std::string, std::string>>;

inline asio::ip::tcp::socket connected(asio::io_context& io, std::uint16_t port) {
  asio::ip::tcp::socket socket(io);
  socket.connect({asio::ip::address_v4::loopback(), port});
  timeval patience{20, 0};
  ::setsockopt(socket.native_handle(), SOL_SOCKET, SO_RCVTIMEO, &patience, sizeof patience);
  return socket;
}

struct Answer {
  unsigned status = 0;
  std::string body;
  std::map<std::string, std::string> headers;
};

/// One request on a connection of its own.
inline Answer request(std::uint16_t port, http::verb method, const std::string& target,
                      const Headers& headers = {}, const std::string& body = {}) {
  asio::io_context io;
  auto socket = connected(io, port);
  http::request<http::string_body> ask(method, target, 11);
  ask.set(http::field::host, "127.0.0.1");
  for (const auto& [name, value] : headers) ask.set(name, value);
  ask.body() = body;
  ask.prepare_payload();
  beast::error_code ignored;
  http::write(socket, ask, ignored);
  beast::flat_buffer buffer;
  http::response_parser<http::string_body> got;
  got.skip(method == http::verb::head);
  http::read(socket, buffer, got);
  Answer answer{got.get().result_int(), got.get().body(), {}};
  for (const auto& field : got.get()) {
    answer.headers[std::string(field.name_string())] = std::string(field.value());
  }
  return answer;
}

inline Answer get(std::uint16_t port, const std::string& target, const Headers& headers = {}) {
  return request(port, http::verb::get, target, headers);
}

/// What a request for a WebSocket is answered: 101 when it is granted.
inline unsigned upgrade_status(std::uint16_t port, const Headers& headers = {},
                               const std::string& target = "/",
                               const std::string& subprotocol = "foxglove.websocket.v1") {
  Headers all{{"Connection", "Upgrade"},
              {"Upgrade", "websocket"},
              {"Sec-WebSocket-Version", "13"},
              {"Sec-WebSocket-Key", "dGhlIHNhbXBsZSBub25jZQ=="},
              {"Sec-WebSocket-Protocol", subprotocol}};
  all.insert(all.end(), headers.begin(), headers.end());
  return get(port, target, all).status;
}

/// A WebSocket client of the Foxglove protocol.
class WebClient {
 public:
  /// @throws boost::system::system_error when it is refused.
  explicit WebClient(std::uint16_t port, const Headers& headers = {},
                     const std::string& target = "/",
                     const std::string& subprotocol = "foxglove.websocket.v1")
      : stream_(connected(io_, port)) {
    stream_.set_option(
        beast::websocket::stream_base::decorator([&](beast::websocket::request_type& request) {
          request.set(http::field::sec_websocket_protocol, subprotocol);
          for (const auto& [name, value] : headers) request.set(name, value);
        }));
    beast::websocket::response_type response;
    stream_.handshake(response, "127.0.0.1", target);
    agreed_ = std::string(response[http::field::sec_websocket_protocol]);
  }

  struct Message {
    bool text = false;
    std::string bytes;
    std::uint32_t subscription() const { return number(1, 4); }
    std::int64_t time_ns() const { return static_cast<std::int64_t>(number(5, 8)); }
    std::string payload() const { return bytes.substr(13); }

   private:
    std::uint64_t number(std::size_t at, std::size_t size) const {
      std::uint64_t value = 0;
      for (std::size_t i = size; i-- > 0;) {
        value = value << 8 | static_cast<unsigned char>(bytes.at(at + i));
      }
      return value;
    }
  };

  Message read() {
    beast::flat_buffer buffer;
    stream_.read(buffer);
    return {stream_.got_text(), beast::buffers_to_string(buffer.data())};
  }
  /// The next text that is such an operation.
  nlohmann::json read_op(const std::string& op) {
    for (;;) {
      const Message message = read();
      if (!message.text) continue;
      auto json = nlohmann::json::parse(message.bytes);
      if (json["op"] == op) return json;
    }
  }
  /// The next message of a subscription.
  Message read_of(std::uint32_t subscription) {
    for (;;) {
      Message message = read();
      if (!message.text && message.subscription() == subscription) return message;
    }
  }
  /// Topics and their channels, from the advertisement.
  std::map<std::string, std::uint32_t> read_channels() {
    std::map<std::string, std::uint32_t> channels;
    const nlohmann::json advertisement = read_op("advertise");
    for (const auto& channel : advertisement["channels"]) {
      channels[channel["topic"].get<std::string>()] = channel["id"];
    }
    return channels;
  }

  void write(const nlohmann::json& json) { write_text(json.dump()); }
  void write_text(const std::string& text) {
    stream_.text(true);
    stream_.write(asio::buffer(text));
  }
  void write_binary(const std::string& bytes) {
    stream_.binary(true);
    stream_.write(asio::buffer(bytes));
  }
  void subscribe(std::uint32_t id, std::uint32_t channel) {
    write({{"op", "subscribe"}, {"subscriptions", {{{"id", id}, {"channelId", channel}}}}});
  }
  /// Advertises a topic and publishes one message on it.
  void publish(std::uint32_t id, const std::string& topic, const std::string& encoding,
               const std::string& payload) {
    if (advertised_.emplace(id, topic).second) {
      write({{"op", "advertise"},
             {"channels",
              {{{"id", id}, {"topic", topic}, {"encoding", encoding}, {"schemaName", ""}}}}});
    }
    std::string bytes{1};
    for (int i = 0; i < 4; ++i) bytes += static_cast<char>(id >> 8 * i);
    write_binary(bytes + payload);
  }

  const std::string& agreed() const { return agreed_; }

 private:
  asio::io_context io_;
  beast::websocket::stream<asio::ip::tcp::socket> stream_;
  std::string agreed_;
  std::map<std::uint32_t, std::string> advertised_;
};

}  // namespace secondskin::dashboard::test
