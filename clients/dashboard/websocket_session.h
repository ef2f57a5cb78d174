#pragma once

#include <atomic>
#include <boost/beast/core.hpp>
#include <boost/beast/http/message.hpp>
#include <boost/beast/http/string_body.hpp>
#include <boost/beast/websocket.hpp>
#include <memory>

#include "clients/dashboard/web_server.h"

/// One WebSocket of the server. Not for use outside it.
namespace secondskin::dashboard {

/// All calls on the sockets' thread. It lives until its last operation has ended.
class WebSocketSession : public std::enable_shared_from_this<WebSocketSession> {
 public:
  using Socket = boost::asio::ip::tcp::socket;
  using Request = boost::beast::http::request<boost::beast::http::string_body>;

  /// @param closed  called once, when it is over
  WebSocketSession(ClientId id, Socket socket, const WebServerOptions& options,
                   WebSocketService& service, std::function<void(ClientId)> closed);

  /// @param subprotocol  the one that was agreed on
  void accept(const Request& request, std::string_view subprotocol);
  void send(Frame frame);
  void forget(std::uint32_t stream) { outbox_.forget(stream); }
  void close();

  /// Closes it if it has taken nothing for too long. @returns whether it did
  bool close_if_stuck(std::chrono::steady_clock::time_point now);
  /// Whether it was closed for being too slow.
  bool too_slow() const noexcept { return too_slow_; }

 private:
  void read();
  void take();
  void write_next();
  void over();

  ClientId id_;
  std::chrono::nanoseconds patience_;
  WebSocketService& service_;
  std::function<void(ClientId)> closed_;
  boost::beast::websocket::stream<boost::beast::tcp_stream> stream_;
  boost::beast::flat_buffer incoming_;
  Outbox outbox_;
  std::optional<Frame> writing_;
  std::chrono::steady_clock::time_point writing_since_;
  bool open_ = false, over_ = false, too_slow_ = false;
};

}  // namespace secondskin::dashboard
