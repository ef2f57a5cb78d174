#include <fcntl.h>
#include <fmt/format.h>
#include <sys/file.h>
#include <unistd.h>

#include <cerrno>
#include <stdexcept>

#include "bus/sole_writer.h"

namespace secondskin::bus {

void SoleLock::refuse(const Config& config, std::string_view role, std::string_view who) {
  throw std::runtime_error(fmt::format(
      "another {} ({}) already serves subject '{}' in domain {}; end it, or give one of "
      "them another --subject or --domain",
      role, who, config.subject, config.domain));
}

SoleLock::SoleLock(const Config& config, std::string_view role) {
  const std::string path = fmt::format("/tmp/secondskin_{}_{}_{}.lock", config.domain,
                                       config.subject, role.substr(0, role.find(' ')));
  fd_ = ::open(path.c_str(), O_RDWR | O_CLOEXEC);
  if (fd_ < 0) fd_ = ::open(path.c_str(), O_RDWR | O_CREAT | O_CLOEXEC | O_NOFOLLOW, 0666);
  if (fd_ < 0) return;  // another user's file: discovery must tell
  if (::flock(fd_, LOCK_EX | LOCK_NB) != 0 && errno == EWOULDBLOCK) {
    char holder[16] = "";
    const auto got = ::pread(fd_, holder, sizeof holder - 1, 0);
    ::close(fd_);
    refuse(config, role,
           got > 0
               ? fmt::format("process {}", std::string_view(holder, static_cast<std::size_t>(got)))
               : "on this machine");
  }
  const std::string own = std::to_string(::getpid());
  if (::ftruncate(fd_, 0) != 0 || ::pwrite(fd_, own.data(), own.size(), 0) < 0) {
    // Who holds it is a convenience; that it is held is what counts.
  }
}

SoleLock::~SoleLock() {
  if (fd_ >= 0) ::close(fd_);
}

}  // namespace secondskin::bus
