#include "wire/pseudo_terminal.h"

#include <fcntl.h>
#include <stdlib.h>
#include <termios.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <filesystem>
#include <stdexcept>
#include <system_error>
#include <utility>

namespace secondskin::wire {
namespace fs = std::filesystem;
namespace {

[[noreturn]] void fail(const std::string& what) {
  throw std::system_error(errno, std::system_category(), "pseudo-terminal: " + what);
}

/// Atomically, so that a program that opens the link meanwhile finds the old or the new terminal.
void make_link(const std::string& target, const std::string& link_path) {
  const fs::file_status old = fs::symlink_status(link_path);
  if (fs::exists(old) && !fs::is_symlink(old)) {
    throw std::invalid_argument("pseudo-terminal: " + link_path +
                                " exists and is no link; it is left alone");
  }
  const std::string fresh = link_path + "." + std::to_string(::getpid()) + ".new";
  fs::remove(fresh);
  fs::create_symlink(target, fresh);
  fs::rename(fresh, link_path);
}

}  // namespace

PseudoTerminal::PseudoTerminal(std::string link_path) : link_path_(std::move(link_path)) {
  try {
    fd_ = ::posix_openpt(O_RDWR | O_NOCTTY | O_NONBLOCK | O_CLOEXEC);
    if (fd_ < 0) fail("none is free");
    if (::grantpt(fd_) != 0 || ::unlockpt(fd_) != 0) fail("cannot be unlocked");
    std::array<char, 128> name{};
    if (::ptsname_r(fd_, name.data(), name.size()) != 0) fail("has no name");
    slave_path_ = name.data();
    slave_fd_ = ::open(slave_path_.c_str(), O_RDWR | O_NOCTTY | O_NONBLOCK | O_CLOEXEC);
    if (slave_fd_ < 0) fail(slave_path_ + " cannot be opened");
    termios settings{};
    if (::tcgetattr(slave_fd_, &settings) != 0) fail(slave_path_ + " has no settings");
    ::cfmakeraw(&settings);
    if (::tcsetattr(slave_fd_, TCSANOW, &settings) != 0) fail(slave_path_ + " refuses raw mode");
    if (!link_path_.empty()) make_link(slave_path_, link_path_);
  } catch (...) {
    close();
    throw;
  }
}

PseudoTerminal::~PseudoTerminal() {
  if (!link_path_.empty()) {
    std::error_code error;
    if (fs::read_symlink(link_path_, error) == slave_path_) fs::remove(link_path_, error);
  }
  close();
}

void PseudoTerminal::close() noexcept {
  if (slave_fd_ >= 0) ::close(slave_fd_);
  if (fd_ >= 0) ::close(fd_);
}

std::size_t PseudoTerminal::write_some(std::span<const std::uint8_t> bytes) noexcept {
  if (bytes.empty()) return 0;
  const ssize_t written = ::write(fd_, bytes.data(), bytes.size());
  return written > 0 ? static_cast<std::size_t>(written) : 0;
}

std::size_t PseudoTerminal::read_some(std::span<std::uint8_t> bytes) noexcept {
  if (bytes.empty()) return 0;
  const ssize_t count = ::read(fd_, bytes.data(), bytes.size());
  return count > 0 ? static_cast<std::size_t>(count) : 0;
}

}  // namespace secondskin::wire
