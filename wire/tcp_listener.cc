#include "wire/tcp_listener.h"

#include <arpa/inet.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <unistd.h>

#include <cerrno>
#include <string>
#include <system_error>

namespace secondskin::wire {

TcpListener::TcpListener(std::uint16_t port) {
  const auto fail = [&] {
    const int error = errno;
    if (fd_ >= 0) ::close(fd_);
    throw std::system_error(error, std::generic_category(), "port " + std::to_string(port));
  };
  fd_ = ::socket(AF_INET, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0);
  if (fd_ < 0) fail();
  const int yes = 1;
  ::setsockopt(fd_, SOL_SOCKET, SO_REUSEADDR, &yes, sizeof(yes));
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_port = htons(port);
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  socklen_t size = sizeof(address);
  if (::bind(fd_, reinterpret_cast<const sockaddr*>(&address), size) != 0 ||
      ::listen(fd_, 1) != 0 ||
      ::getsockname(fd_, reinterpret_cast<sockaddr*>(&address), &size) != 0) {
    fail();
  }
  port_ = ntohs(address.sin_port);
}

TcpListener::~TcpListener() {
  hang_up();
  ::close(fd_);
}

void TcpListener::hang_up() noexcept {
  if (client_ >= 0) ::close(client_);
  client_ = -1;
}

bool TcpListener::poll() noexcept {
  const int client = ::accept4(fd_, nullptr, nullptr, SOCK_NONBLOCK | SOCK_CLOEXEC);
  if (client >= 0) {
    hang_up();
    client_ = client;
    ++openings_;
  }
  return connected();
}

std::size_t TcpListener::write_some(std::span<const std::uint8_t> bytes) noexcept {
  if (bytes.empty() || !connected()) return 0;
  const ssize_t written = ::send(client_, bytes.data(), bytes.size(), MSG_NOSIGNAL);
  if (written > 0) return static_cast<std::size_t>(written);
  if (errno != EAGAIN && errno != EINTR) hang_up();
  return 0;
}

std::size_t TcpListener::read_some(std::span<std::uint8_t> bytes) noexcept {
  if (bytes.empty() || !connected()) return 0;
  const ssize_t count = ::recv(client_, bytes.data(), bytes.size(), 0);
  if (count > 0) return static_cast<std::size_t>(count);
  if (count == 0 || (errno != EAGAIN && errno != EINTR)) hang_up();
  return 0;
}

}  // namespace secondskin::wire
