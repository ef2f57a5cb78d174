#pragma once

#include <boost/beast/core.hpp>
#include <boost/beast/http.hpp>
#include <memory>
#include <optional>

#include "clients/dashboard/file_body.h"
#include "clients/dashboard/static_files.h"
#include "clients/dashboard/websocket_session.h"

/// One HTTP connection of the server. Not for use outside it.
namespace secondskin::dashboard {

class HttpSession;

/// What a connection needs of the server.
class HttpHost {
 public:
  virtual ~HttpHost() = default;
  virtual const WebServerOptions& settings() const noexcept = 0;
  virtual const StaticFiles& page() const noexcept = 0;
  /// Has the handlers answer; `reply` comes on the sockets' thread.
  virtual void answer(HttpRequest request, std::function<void(HttpResponse)> reply) = 0;
  virtual bool has_room() const noexcept = 0;  ///< for one more WebSocket
  virtual void upgrade(boost::asio::ip::tcp::socket socket,
                       const WebSocketSession::Request& request, std::string_view subprotocol) = 0;
  virtual void refused() noexcept = 0;
  virtual void ended(HttpSession* session) noexcept = 0;
};

/// All calls on the sockets' thread. It lives until its last operation has ended.
class HttpSession : public std::enable_shared_from_this<HttpSession> {
 public:
  HttpSession(boost::asio::ip::tcp::socket socket, HttpHost& host);
  ~HttpSession() { host_.ended(this); }
  void read();
  void close();

 private:
  using Request = WebSocketSession::Request;
  using Response = boost::beast::http::response<boost::beast::http::string_body>;

  void read_body();
  void take(const Target& target);
  void reject_unreadable(const boost::system::error_code& error);
  /// @returns whether it may go on; else it was answered.
  bool may_pass(const Target& target);
  void upgrade();
  void serve_file(const Target& target);
  void write(HttpResponse response, std::string_view set_cookie = {});
  void write(Response response);
  void send_file(HttpResponse from);
  void send_rest();  ///< of the file
  void finished(bool keep_alive);
  Response response(unsigned status, std::string_view content_type, std::string body) const;

  boost::beast::tcp_stream stream_;
  HttpHost& host_;
  boost::beast::flat_buffer incoming_;
  std::optional<boost::beast::http::request_parser<boost::beast::http::string_body>> parser_;
  Request request_;
  Response response_;
  std::optional<FileBody> file_;
};

}  // namespace secondskin::dashboard
