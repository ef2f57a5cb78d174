#include "wire/udp.h"

#include <arpa/inet.h>
#include <netinet/in.h>
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

#include <cerrno>
#include <charconv>
#include <cstring>
#include <ctime>
#include <stdexcept>
#include <system_error>

namespace secondskin::wire {
namespace {

sockaddr_in address_of(const UdpPlace& place) {
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_port = htons(place.port);
  if (::inet_pton(AF_INET, place.address.c_str(), &address.sin_addr) != 1) {
    throw std::invalid_argument("'" + place.address + "' is no IPv4 address such as 127.0.0.1");
  }
  return address;
}

int open_socket() {
  const int fd = ::socket(AF_INET, SOCK_DGRAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0);
  if (fd < 0) throw std::system_error(errno, std::system_category(), "UDP socket");
  return fd;
}

[[noreturn]] void fail(int fd, const UdpPlace& place) {
  const int error = errno;
  ::close(fd);
  throw std::system_error(error, std::system_category(), place.text());
}

}  // namespace

UdpPlace UdpPlace::parse(std::string_view text) {
  UdpPlace place;
  const std::size_t colon = text.rfind(':');
  if (colon != std::string_view::npos) place.address = text.substr(0, colon);
  const std::string_view port = colon == std::string_view::npos ? text : text.substr(colon + 1);
  const auto [end, error] = std::from_chars(port.data(), port.data() + port.size(), place.port);
  if (error != std::errc() || end != port.data() + port.size() || place.port == 0) {
    throw std::invalid_argument("'" + std::string(text) +
                                "': expected PORT or ADDRESS:PORT with a port from 1 to 65535");
  }
  address_of(place);
  return place;
}

std::string UdpPlace::text() const { return address + ":" + std::to_string(port); }

UdpSender::UdpSender(const UdpPlace& to) : fd_(open_socket()) {
  const sockaddr_in address = address_of(to);
  if (::connect(fd_, reinterpret_cast<const sockaddr*>(&address), sizeof address) != 0) {
    fail(fd_, to);
  }
}

UdpSender::~UdpSender() { ::close(fd_); }

bool UdpSender::send(std::span<const std::uint8_t> datagram) noexcept {
  // A refusal tells of an earlier datagram, and takes the place of this one: try once more.
  for (int attempt = 0; attempt < 2; ++attempt) {
    const ssize_t sent = ::send(fd_, datagram.data(), datagram.size(), MSG_NOSIGNAL);
    if (sent == static_cast<ssize_t>(datagram.size())) return attempt == 0;
    if (errno != ECONNREFUSED) return false;
  }
  return false;
}

UdpReceiver::UdpReceiver(const UdpPlace& at) : place_(at), fd_(open_socket()) {
  sockaddr_in address = address_of(at);
  socklen_t size = sizeof address;
  if (::bind(fd_, reinterpret_cast<const sockaddr*>(&address), size) != 0 ||
      ::getsockname(fd_, reinterpret_cast<sockaddr*>(&address), &size) != 0) {
    fail(fd_, at);
  }
  place_.port = ntohs(address.sin_port);
  const int on = 1;
  ::setsockopt(fd_, SOL_SOCKET, SO_TIMESTAMPNS, &on, sizeof on);
}

UdpReceiver::~UdpReceiver() { ::close(fd_); }

std::optional<UdpReceiver::Arrival> UdpReceiver::receive(
    std::span<std::uint8_t> buffer, std::chrono::milliseconds at_most) noexcept {
  pollfd event{fd_, POLLIN, 0};
  if (::poll(&event, 1, static_cast<int>(at_most.count())) <= 0) return std::nullopt;
  iovec part{buffer.data(), buffer.size()};
  alignas(cmsghdr) char control[CMSG_SPACE(sizeof(timespec))];
  msghdr message{};
  message.msg_iov = &part;
  message.msg_iovlen = 1;
  message.msg_control = control;
  message.msg_controllen = sizeof control;
  const ssize_t length = ::recvmsg(fd_, &message, 0);
  if (length < 0) return std::nullopt;
  timespec time{};
  ::clock_gettime(CLOCK_REALTIME, &time);  // where the kernel does not tell
  for (cmsghdr* c = CMSG_FIRSTHDR(&message); c != nullptr; c = CMSG_NXTHDR(&message, c)) {
    if (c->cmsg_level == SOL_SOCKET && c->cmsg_type == SCM_TIMESTAMPNS) {
      std::memcpy(&time, CMSG_DATA(c), sizeof time);
    }
  }
  return Arrival{static_cast<std::size_t>(length),
                 std::int64_t{time.tv_sec} * 1'000'000'000 + time.tv_nsec};
}

}  // namespace secondskin::wire
