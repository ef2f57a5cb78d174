#include "clients/dashboard/web_server.h"

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <atomic>
#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <boost/asio/post.hpp>
#include <boost/asio/steady_timer.hpp>
#include <map>
#include <set>
#include <stdexcept>
#include <thread>

#include "clients/dashboard/http_session.h"
#include "clients/dashboard/websocket_session.h"
#include "clients/dashboard/worker.h"

namespace secondskin::dashboard {

namespace asio = boost::asio;
using Error = boost::system::error_code;
using tcp = asio::ip::tcp;

struct WebServer::State final : HttpHost {
  State(WebServerOptions given, std::vector<HttpHandler> handlers, WebSocketService& websockets)
      : options(std::move(given)),
        files(options.page),
        service(websockets),
        worker(std::move(handlers)) {
    is_loopback(options.bind);
    const tcp::endpoint where(asio::ip::make_address(options.bind), options.port);
    Error error;
    acceptor.open(where.protocol(), error);
    if (!error) acceptor.set_option(tcp::acceptor::reuse_address(true), error);
    if (!error) acceptor.bind(where, error);
    if (!error) acceptor.listen(asio::socket_base::max_listen_connections, error);
    if (error) {
      throw std::runtime_error(fmt::format("dashboard: port {} on {}: {}; choose another",
                                           options.port, options.bind, error.message()));
    }
    port = acceptor.local_endpoint().port();
  }

  // ---- what HTTP sessions ask of their host

  const WebServerOptions& settings() const noexcept override { return options; }
  const StaticFiles& page() const noexcept override { return files; }
  void refused() noexcept override { ++refused_count; }
  void answer(HttpRequest request, std::function<void(HttpResponse)> reply) override {
    // The reply holds its connection, which must end on the sockets' thread: so it is moved on.
    worker.answer(
        std::move(request), [this, reply = std::move(reply)](HttpResponse response) mutable {
          asio::post(io, [reply = std::move(reply), response = std::move(response)]() mutable {
            reply(std::move(response));
          });
        });
  }
  void ended(HttpSession* session) noexcept override { http_sessions.erase(session); }

  bool has_room() const noexcept override { return clients.size() < options.most_clients; }
  void upgrade(tcp::socket socket, const WebSocketSession::Request& request,
               std::string_view subprotocol) override {
    const ClientId id = ++last_id;
    auto session = std::make_shared<WebSocketSession>(id, std::move(socket), options, service,
                                                      [this](ClientId gone) { client_gone(gone); });
    clients.emplace(id, session);
    client_count = clients.size();
    session->accept(request, subprotocol);
  }

  // ----

  void client_gone(ClientId id) {
    const auto found = clients.find(id);
    if (found == clients.end()) return;
    if (found->second->too_slow()) {
      ++dropped;
      spdlog::warn("dashboard: a client was too slow and is closed");
    }
    clients.erase(found);
    client_count = clients.size();
  }

  void accept() {
    acceptor.async_accept([this](Error error, tcp::socket socket) {
      if (stopping) return;
      if (!error && clients.size() + http_sessions.size() < options.most_connections) {
        auto session = std::make_shared<HttpSession>(std::move(socket), *this);
        http_sessions.insert(session.get());
        session->read();
      } else if (!error) {
        ++refused_count;  // closed as it goes out of scope
      }
      accept();
    });
  }

  void watch() {
    watch_timer.expires_after(
        std::min<std::chrono::nanoseconds>(options.patience / 4, std::chrono::seconds(1)));
    watch_timer.async_wait([this](Error error) {
      if (error || stopping) return;
      const auto now = std::chrono::steady_clock::now();
      for (auto next = clients.begin(); next != clients.end();) {
        const auto session = (next++)->second;  // closing removes it from the list
        session->close_if_stuck(now);
      }
      watch();
    });
  }

  void run() {
    for (;;) {
      try {
        io.run();
        return;
      } catch (const std::exception& error) {
        spdlog::error("dashboard: {}", error.what());
      }
    }
  }

  // First, so that it goes last but for its pending operations, which stop() has ended.
  asio::io_context io{1};
  WebServerOptions options;
  StaticFiles files;
  WebSocketService& service;
  tcp::acceptor acceptor{io};
  asio::steady_timer watch_timer{io};
  std::uint16_t port = 0;
  bool stopping = false;
  ClientId last_id = 0;
  std::map<ClientId, std::shared_ptr<WebSocketSession>> clients;
  std::set<HttpSession*> http_sessions;  // counted; they own themselves
  std::atomic<std::size_t> client_count{0};
  std::atomic<std::uint64_t> dropped{0}, refused_count{0};
  Worker worker;
  std::jthread thread;
};

WebServer::WebServer(WebServerOptions options, std::vector<HttpHandler> handlers,
                     WebSocketService& service)
    : state_(std::make_unique<State>(std::move(options), std::move(handlers), service)) {}

WebServer::~WebServer() { stop(); }

void WebServer::start() {
  auto& s = *state_;
  s.accept();
  s.watch();
  s.worker.start();
  s.thread = std::jthread([&s] { s.run(); });
}

void WebServer::stop() {
  auto& s = *state_;
  if (!s.thread.joinable()) return;
  s.worker.stop();
  // Every operation ends with an error and lets go of its session; then run() comes back.
  asio::post(s.io, [&s] {
    Error ignored;
    s.stopping = true;
    s.acceptor.close(ignored);
    s.watch_timer.cancel();
    for (auto next = s.clients.begin(); next != s.clients.end();) {
      const auto session = (next++)->second;
      session->close();
    }
    for (auto next = s.http_sessions.begin(); next != s.http_sessions.end();) {
      (*next++)->close();
    }
  });
  s.thread.join();
}

std::uint16_t WebServer::port() const noexcept { return state_->port; }

WebServerCounts WebServer::counts() const noexcept {
  return {state_->client_count, state_->dropped, state_->refused_count};
}

void WebServer::post(std::function<void()> what) { asio::post(state_->io, std::move(what)); }

void WebServer::send(ClientId client, Frame frame) {
  const auto found = state_->clients.find(client);
  if (found != state_->clients.end()) found->second->send(std::move(frame));
}

void WebServer::forget(ClientId client, std::uint32_t stream) {
  const auto found = state_->clients.find(client);
  if (found != state_->clients.end()) found->second->forget(stream);
}

}  // namespace secondskin::dashboard
