#include "clients/dashboard/websocket_session.h"

#include <array>
#include <boost/asio/post.hpp>

namespace secondskin::dashboard {

namespace asio = boost::asio;
namespace beast = boost::beast;
namespace websocket = beast::websocket;
using Error = boost::system::error_code;

namespace {

// A client that answers no ping for this long is gone.
constexpr auto kSilence = std::chrono::seconds(60);
// What the system may hold for a slow client: the less, the fresher is what it gets.
constexpr int kSendBuffer = 128 << 10;

}  // namespace

WebSocketSession::WebSocketSession(ClientId id, Socket socket, const WebServerOptions& options,
                                   WebSocketService& service, std::function<void(ClientId)> closed)
    : id_(id),
      patience_(options.patience),
      service_(service),
      closed_(std::move(closed)),
      stream_(std::move(socket)),
      outbox_(options.most_waiting_bytes) {
  Error ignored;
  auto& tcp = beast::get_lowest_layer(stream_).socket();
  tcp.set_option(asio::ip::tcp::no_delay(true), ignored);
  tcp.set_option(asio::socket_base::send_buffer_size(kSendBuffer), ignored);
  websocket::stream_base::timeout timeout{};
  timeout.handshake_timeout = std::chrono::seconds(10);
  timeout.idle_timeout = kSilence;
  timeout.keep_alive_pings = true;
  stream_.set_option(timeout);
  stream_.read_message_max(options.largest_message);
}

void WebSocketSession::accept(const Request& request, std::string_view subprotocol) {
  stream_.set_option(websocket::stream_base::decorator(
      [subprotocol = std::string(subprotocol)](websocket::response_type& response) {
        response.set(beast::http::field::sec_websocket_protocol, subprotocol);
        response.set(beast::http::field::server, "secondskin");
      }));
  stream_.async_accept(request, [self = shared_from_this()](Error error) {
    if (error || self->over_) return self->over();
    self->open_ = true;
    self->service_.opened(self->id_);
    self->write_next();
    self->read();
  });
}

void WebSocketSession::read() {
  stream_.async_read(incoming_, [self = shared_from_this()](Error error, std::size_t) {
    if (error || self->over_) return self->over();
    self->take();
    self->incoming_.consume(self->incoming_.size());
    if (!self->over_) self->read();
  });
}

void WebSocketSession::take() {
  const auto data = incoming_.cdata();
  if (stream_.got_text()) {
    service_.text(id_, {static_cast<const char*>(data.data()), data.size()});
  } else {
    service_.binary(id_, {static_cast<const std::uint8_t*>(data.data()), data.size()});
  }
}

void WebSocketSession::send(Frame frame) {
  if (over_ || too_slow_) return;
  if (!outbox_.push(std::move(frame))) {
    too_slow_ = true;
    // Not here: whoever sends goes through its lists.
    asio::post(stream_.get_executor(), [self = shared_from_this()] { self->close(); });
    return;
  }
  if (!writing_) write_next();
}

void WebSocketSession::write_next() {
  if (over_ || !open_ || writing_) return;
  writing_ = outbox_.pop();
  if (!writing_) return;
  writing_since_ = std::chrono::steady_clock::now();
  stream_.text(writing_->text);
  const std::array<asio::const_buffer, 2> buffers{
      writing_->head ? asio::buffer(*writing_->head) : asio::const_buffer(),
      asio::buffer(*writing_->body)};
  stream_.async_write(buffers, [self = shared_from_this()](Error error, std::size_t) {
    self->writing_.reset();
    if (error) return self->over();
    self->write_next();
  });
}

bool WebSocketSession::close_if_stuck(std::chrono::steady_clock::time_point now) {
  if (over_ || !writing_ || now - writing_since_ < patience_) return false;
  too_slow_ = true;
  close();
  return true;
}

void WebSocketSession::close() {
  // No closing handshake: who reads nothing would not answer it.
  Error ignored;
  beast::get_lowest_layer(stream_).socket().close(ignored);
  over();
}

void WebSocketSession::over() {
  if (std::exchange(over_, true)) return;
  Error ignored;
  beast::get_lowest_layer(stream_).socket().close(ignored);
  if (open_) service_.closed(id_);
  closed_(id_);
}

}  // namespace secondskin::dashboard
