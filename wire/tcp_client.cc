#include "wire/tcp_client.h"

#include <arpa/inet.h>
#include <netinet/in.h>
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

#include <cerrno>
#include <limits>
#include <stdexcept>
#include <system_error>

namespace secondskin::wire {
namespace {

bool would_block(int error) noexcept {
  return error == EAGAIN || error == EWOULDBLOCK || error == EINTR;
}

sockaddr_in place_of(const std::string& address, unsigned port) noexcept {
  sockaddr_in place{};
  place.sin_family = AF_INET;
  place.sin_port = htons(static_cast<std::uint16_t>(port));
  ::inet_pton(AF_INET, address.c_str(), &place.sin_addr);
  return place;
}

}  // namespace

TcpClient::TcpClient(const std::string& address, unsigned port)
    : address_(address), port_(port), last_attempt_(-std::numeric_limits<double>::infinity()) {
  in_addr parsed{};
  if (::inet_pton(AF_INET, address.c_str(), &parsed) != 1) {
    throw std::invalid_argument("'" + address + "' is no IPv4 address such as 127.0.0.1");
  }
  if (port == 0 || port > 65535) {
    throw std::invalid_argument("port " + std::to_string(port) + " is not one of 1 to 65535");
  }
}

TcpClient::~TcpClient() {
  if (fd_ >= 0) ::close(fd_);
}

void TcpClient::lose(int error) noexcept {
  error_ = error;
  connected_ = false;
  if (fd_ >= 0) ::close(fd_);
  fd_ = -1;
}

bool TcpClient::poll(double now) noexcept {
  if (connected_) return true;
  if (fd_ < 0 && (now - last_attempt_ >= kRetryInterval || now < last_attempt_)) {
    last_attempt_ = now;
    fd_ = ::socket(AF_INET, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0);
    if (fd_ < 0) {
      lose(errno);
      return false;
    }
    const sockaddr_in place = place_of(address_, port_);
    if (::connect(fd_, reinterpret_cast<const sockaddr*>(&place), sizeof place) != 0 &&
        errno != EINPROGRESS) {
      lose(errno);
      return false;
    }
  }
  if (fd_ < 0) return false;
  pollfd events{fd_, POLLOUT, 0};
  if (::poll(&events, 1, 0) <= 0) return false;  // still on its way
  int error = 0;
  socklen_t size = sizeof error;
  ::getsockopt(fd_, SOL_SOCKET, SO_ERROR, &error, &size);
  if (error != 0) {
    lose(error);
    return false;
  }
  connected_ = true;
  error_ = 0;
  ++openings_;
  return true;
}

std::size_t TcpClient::write_some(std::span<const std::uint8_t> bytes) noexcept {
  if (!connected_ || bytes.empty()) return 0;
  const ssize_t written = ::send(fd_, bytes.data(), bytes.size(), MSG_NOSIGNAL);
  if (written >= 0) return static_cast<std::size_t>(written);
  if (!would_block(errno)) lose(errno);
  return 0;
}

std::size_t TcpClient::read_some(std::span<std::uint8_t> bytes) noexcept {
  if (!connected_ || bytes.empty()) return 0;
  const ssize_t count = ::recv(fd_, bytes.data(), bytes.size(), 0);
  if (count > 0) return static_cast<std::size_t>(count);
  if (count == 0) {
    lose(ECONNRESET);
  } else if (!would_block(errno)) {
    lose(errno);
  }
  return 0;
}

std::string TcpClient::last_error() const {
  if (connected_ || error_ == 0) return {};
  return address_ + ":" + std::to_string(port_) + ": " + std::system_category().message(error_) +
         "; it is tried again";
}

}  // namespace secondskin::wire
