#include "clients/dashboard/http_session.h"

#include <fmt/format.h>

#include <algorithm>
#include <boost/asio/write.hpp>

#include "clients/dashboard/json_answer.h"

namespace secondskin::dashboard {

namespace asio = boost::asio;
namespace beast = boost::beast;
namespace http = beast::http;
using Error = boost::system::error_code;

namespace {

constexpr std::uint32_t kLargestHeader = 16 << 10;
constexpr auto kPatience =
    std::chrono::seconds(30);  // with a request that does not come to its end

std::string_view view(beast::string_view text) { return {text.data(), text.size()}; }

/// The first that both sides know; empty if there is none.
std::string_view common_subprotocol(const WebSocketSession::Request& request) {
  std::string_view offered = view(request[http::field::sec_websocket_protocol]);
  while (!offered.empty()) {
    const auto end = offered.find(',');
    std::string_view one = offered.substr(0, end);
    offered = end == std::string_view::npos ? std::string_view() : offered.substr(end + 1);
    one.remove_prefix(std::min(one.find_first_not_of(" \t"), one.size()));
    one = one.substr(0, one.find_last_not_of(" \t") + 1);
    const auto& known = foxglove::kSubprotocols;
    const auto* found = std::find(known.begin(), known.end(), one);
    if (found != known.end()) return *found;
  }
  return {};
}

}  // namespace

HttpSession::HttpSession(asio::ip::tcp::socket socket, HttpHost& host)
    : stream_(std::move(socket)), host_(host) {
  Error ignored;
  stream_.socket().set_option(asio::ip::tcp::no_delay(true), ignored);
}

void HttpSession::read() {
  parser_.emplace();
  parser_->header_limit(kLargestHeader);
  parser_->body_limit(host_.settings().largest_body);
  stream_.expires_after(kPatience);
  http::async_read_header(stream_, incoming_, *parser_,
                          [self = shared_from_this()](Error error, std::size_t) {
                            if (error) return self->reject_unreadable(error);
                            self->read_body();
                          });
}

// A stranger's body is not even read, so it takes no memory.
void HttpSession::read_body() {
  request_ = Request(parser_->get().base());
  if (!parser_->is_done()) request_.keep_alive(false);  // should it be answered before
  auto target = parse_target(view(request_.target()));
  if (!target) {
    return write(
        error_response(400, "target: expected a path that begins with / and whole escapes"));
  }
  if (!may_pass(*target)) return;
  http::async_read(
      stream_, incoming_, *parser_,
      [self = shared_from_this(), target = std::move(*target)](Error error, std::size_t) {
        if (error) return self->reject_unreadable(error);
        self->request_ = self->parser_->release();
        self->take(target);
      });
}

void HttpSession::close() {
  Error ignored;
  stream_.socket().close(ignored);
}

void HttpSession::reject_unreadable(const Error& error) {
  request_ = {};
  request_.version(11);
  request_.keep_alive(false);
  if (error == http::error::header_limit) {
    write(error_response(431, fmt::format("header: expected at most {} bytes", kLargestHeader)));
  } else if (error == http::error::body_limit) {
    write(error_response(
        413, fmt::format("body: expected at most {} bytes", host_.settings().largest_body)));
  } else if (error.category() == make_error_code(http::error::bad_method).category() &&
             error != http::error::end_of_stream && error != http::error::partial_message) {
    write(error_response(400, "not an HTTP request: " + error.message()));
  }
}

void HttpSession::take(const Target& target) {
  if (beast::websocket::is_upgrade(request_)) return upgrade();
  if (target.path.starts_with("/api/") || target.path == "/api") {
    // Until the handler has answered nobody is late.
    stream_.expires_never();
    return host_.answer(
        {std::string(view(request_.method_string())), target.path, target.query,
         std::move(request_.body())},
        [self = shared_from_this()](HttpResponse response) { self->write(std::move(response)); });
  }
  if (request_.method() != http::verb::get && request_.method() != http::verb::head) {
    return write(error_response(
        405, fmt::format("{} {}: expected GET", view(request_.method_string()), target.path)));
  }
  serve_file(target);
}

bool HttpSession::may_pass(const Target& target) {
  const auto token = target.query.find("token");
  const bool reads = request_.method() == http::verb::get || request_.method() == http::verb::head;
  const Credentials credentials{
      .changes = !reads || beast::websocket::is_upgrade(request_),
      .host = view(request_[http::field::host]),
      .origin = view(request_[http::field::origin]),
      .authorization = view(request_[http::field::authorization]),
      .cookie = view(request_[http::field::cookie]),
      .query_token = token == target.query.end() ? std::string_view() : token->second};
  const Access access = judge(host_.settings().access, credentials);
  if (access == Access::kGranted) return true;
  host_.refused();
  switch (access) {
    case Access::kNoToken:
      write(error_response(401,
                           "token: expected the one that the dashboard printed, as "
                           "?token=..., or Authorization: Bearer ..."));
      break;
    case Access::kForeignHost:
      write(error_response(403,
                           fmt::format("Host '{:.100}': expected this machine's; or use a token or "
                                       "--allow-origin",
                                       credentials.host)));
      break;
    default:
      write(error_response(
          403, fmt::format("Origin '{:.100}': expected the own host; allow another with "
                           "--allow-origin",
                           credentials.origin)));
  }
  return false;
}

void HttpSession::upgrade() {
  const std::string_view subprotocol = common_subprotocol(request_);
  if (subprotocol.empty()) {
    return write(error_response(
        400, fmt::format("Sec-WebSocket-Protocol: expected {}", foxglove::kSubprotocols[0])));
  }
  if (!host_.has_room()) {
    host_.refused();
    return write(error_response(
        503, fmt::format("too many clients: expected at most {}", host_.settings().most_clients)));
  }
  stream_.expires_never();
  host_.upgrade(stream_.release_socket(), request_, subprotocol);
}

void HttpSession::serve_file(const Target& target) {
  const auto file = host_.page().find(target.path);
  std::string cookie;
  if (!host_.settings().access.token.empty() && target.query.contains("token")) {
    cookie = fmt::format("{}={}; Path=/; HttpOnly; SameSite=Strict", kTokenCookie,
                         host_.settings().access.token);
  }
  if (!file && target.path == "/") {
    return write({.content_type = "text/html; charset=utf-8",
                  .body = host_.settings().no_page,
                  .file_name = {}},
                 cookie);
  }
  if (!file) return write(error_response(404, "no such file in the page"));
  const bool known = view(request_[http::field::if_none_match]) == file->etag;
  Response answer = response(known ? 304 : 200, file->content_type, known ? "" : file->body);
  answer.set(http::field::etag, file->etag);
  answer.set(http::field::cache_control,
             file->immutable ? "public, max-age=31536000, immutable" : "no-cache");
  if (!cookie.empty()) answer.set(http::field::set_cookie, cookie);
  write(std::move(answer));
}

void HttpSession::write(HttpResponse from, std::string_view set_cookie) {
  if (!from.file.empty()) return send_file(std::move(from));
  Response answer = response(from.status, from.content_type, std::move(from.body));
  answer.set(http::field::cache_control, "no-store");
  if (!from.file_name.empty()) {
    std::erase_if(from.file_name, [](unsigned char c) { return c < 0x20 || c == '"' || c > 0x7e; });
    answer.set(http::field::content_disposition,
               fmt::format("attachment; filename=\"{}\"", from.file_name));
  }
  if (!set_cookie.empty()) answer.set(http::field::set_cookie, std::string(set_cookie));
  write(std::move(answer));
}

HttpSession::Response HttpSession::response(unsigned status, std::string_view content_type,
                                            std::string body) const {
  Response answer(static_cast<http::status>(status), request_.version());
  answer.set(http::field::server, "secondskin");
  answer.set(http::field::content_type, std::string(content_type));
  answer.set("X-Content-Type-Options", "nosniff");
  answer.set("X-Frame-Options", "SAMEORIGIN");
  answer.set("Referrer-Policy", "no-referrer");  // a token in the address stays here
  answer.body() = std::move(body);
  answer.keep_alive(request_.keep_alive());
  answer.prepare_payload();
  if (request_.method() == http::verb::head) answer.body().clear();
  return answer;
}

void HttpSession::write(Response answer) {
  response_ = std::move(answer);
  stream_.expires_after(kPatience);
  http::async_write(stream_, response_, [self = shared_from_this()](Error error, std::size_t) {
    self->finished(!error && self->response_.keep_alive());
  });
}

void HttpSession::send_file(HttpResponse from) {
  auto file = FileBody::open(from.file);
  if (!file) return write(error_response(404, "the file is gone"));
  const bool known = view(request_[http::field::if_none_match]) == file->etag();
  const auto if_range = view(request_[http::field::if_range]);
  const bool ranged = !known && (if_range.empty() || if_range == file->etag());
  const auto range = ranged ? file->seek(view(request_[http::field::range])) : Range::kWhole;
  const unsigned status = known                            ? 304
                          : range == Range::kPart          ? 206
                          : range == Range::kUnsatisfiable ? 416
                                                           : from.status;
  // The body is sent behind it: only the header is of this message.
  response_ = response(status, from.content_type, {});
  response_.set(http::field::etag, file->etag());
  response_.set(http::field::accept_ranges, "bytes");
  response_.set(http::field::cache_control, "no-cache");
  const bool body = status == from.status || status == 206;
  if (status == 206 || status == 416) {
    response_.set(http::field::content_range, file->content_range(range));
  }
  response_.content_length(body ? file->left() : 0);
  if (status == 304) response_.erase(http::field::content_length);
  file_.reset();
  if (body && request_.method() != http::verb::head) file_ = std::move(*file);
  auto header = std::make_shared<http::response_serializer<http::string_body>>(response_);
  stream_.expires_after(kPatience);
  http::async_write_header(stream_, *header,
                           [self = shared_from_this(), header](Error error, std::size_t) {
                             if (error) return self->finished(false);
                             self->send_rest();
                           });
}

void HttpSession::send_rest() {
  if (!file_ || file_->left() == 0) {
    file_.reset();
    return finished(response_.keep_alive());
  }
  const auto block = file_->next();
  if (block.empty())
    return finished(false);  // it became shorter: the client must not wait for more
  stream_.expires_after(kPatience);
  asio::async_write(stream_, asio::buffer(block.data(), block.size()),
                    [self = shared_from_this()](Error error, std::size_t) {
                      if (error) return self->finished(false);
                      self->send_rest();
                    });
}

void HttpSession::finished(bool keep_alive) {
  if (keep_alive) return read();
  file_.reset();
  Error ignored;
  stream_.socket().shutdown(asio::ip::tcp::socket::shutdown_send, ignored);
}

}  // namespace secondskin::dashboard
