#pragma once

#include <chrono>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "clients/dashboard/access.h"
#include "clients/dashboard/http.h"
#include "clients/dashboard/outbox.h"

/// HTTP and WebSocket on one port.
///
/// Threads: one for all sockets, which never waits for a client; one on which the HTTP handlers
/// run. Whoever publishes hands over with post() and goes on.
namespace secondskin::dashboard {

using ClientId = std::uint64_t;

/// What is served on WebSockets. All calls on the sockets' thread.
class WebSocketService {
 public:
  virtual ~WebSocketService() = default;
  virtual void opened(ClientId client) = 0;
  virtual void closed(ClientId client) = 0;
  virtual void text(ClientId client, std::string_view message) = 0;
  virtual void binary(ClientId client, std::span<const std::uint8_t> message) = 0;
};

struct WebServerOptions {
  std::string bind = "127.0.0.1";
  std::uint16_t port = 8765;  ///< 0: any that is free
  AccessRules access;
  std::filesystem::path page;  ///< the built page's folder
  std::string no_page;         ///< what "/" says where there is none, HTML
  std::size_t most_clients = 100;
  std::size_t most_connections = 300;                            ///< HTTP's included
  std::size_t largest_message = 64u << 10;                       ///< from a client [bytes]
  std::size_t largest_body = 1u << 20;                           ///< of an HTTP request [bytes]
  std::size_t most_waiting_bytes = 4u << 20;                     ///< for one client, streams aside
  std::chrono::nanoseconds patience = std::chrono::seconds(10);  ///< with one that takes nothing
};

struct WebServerCounts {
  std::size_t clients = 0;    ///< WebSockets that are open
  std::uint64_t dropped = 0;  ///< closed because they were too slow
  std::uint64_t refused = 0;  ///< requests without token, of a foreign origin, or too many
};

class WebServer {
 public:
  /// Takes the port; serves from start() on.
  /// @param service  outlives the server
  /// @throws std::runtime_error naming address and port when they cannot be had.
  WebServer(WebServerOptions options, std::vector<HttpHandler> handlers, WebSocketService& service);
  ~WebServer();  ///< as stop()

  void start();
  /// Closes all connections. The service hears nothing any more.
  void stop();

  std::uint16_t port() const noexcept;
  WebServerCounts counts() const noexcept;

  /// Runs something on the sockets' thread, soon. Any thread; never waits.
  void post(std::function<void()> what);

  // On the sockets' thread only. A client that is gone is passed over.
  void send(ClientId client, Frame frame);
  void forget(ClientId client, std::uint32_t stream);  ///< what waits of it

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace secondskin::dashboard
