#include "wire/serial_port.h"

#include <fcntl.h>
#include <poll.h>
#include <sys/file.h>
#include <sys/ioctl.h>
#include <sys/stat.h>
#include <sys/sysmacros.h>
#include <termios.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <limits>
#include <stdexcept>
#include <system_error>
#include <utility>

namespace secondskin::wire {
namespace {

struct Speed {
  unsigned baud_rate;
  speed_t code;
};
constexpr std::array kSpeeds = {
    Speed{1'200, B1200},     Speed{2'400, B2400},     Speed{4'800, B4800},
    Speed{9'600, B9600},     Speed{19'200, B19200},   Speed{38'400, B38400},
    Speed{57'600, B57600},   Speed{115'200, B115200}, Speed{230'400, B230400},
    Speed{460'800, B460800}, Speed{921'600, B921600},
};

unsigned speed_code(unsigned baud_rate) {
  for (const Speed& speed : kSpeeds) {
    if (speed.baud_rate == baud_rate) return speed.code;
  }
  throw std::invalid_argument("serial port: baud rate " + std::to_string(baud_rate) +
                              " is not one of 1200, 2400, 4800, 9600, 19200, 38400, 57600, "
                              "115200, 230400, 460800, 921600");
}

/// A pseudo-terminal's far end may be opened by several (a test, a viewer); a board may not.
bool is_pseudo_terminal(int fd) noexcept {
  struct stat status {};
  if (::fstat(fd, &status) != 0) return false;
  const unsigned device = major(status.st_rdev);
  return device >= 136 && device <= 143;  // Unix98 slaves, Linux' devices.txt
}

bool would_block(int error) noexcept {
  return error == EAGAIN || error == EWOULDBLOCK || error == EINTR;
}

}  // namespace

SerialPort::SerialPort(std::string path, unsigned baud_rate)
    : path_(std::move(path)),
      baud_rate_(baud_rate),
      speed_(speed_code(baud_rate)),
      last_attempt_(-std::numeric_limits<double>::infinity()) {
  if (path_.empty()) throw std::invalid_argument("serial port: the path is empty");
}

SerialPort::~SerialPort() {
  if (fd_ >= 0) ::close(fd_);
}

bool SerialPort::poll(double now) noexcept {
  if (fd_ >= 0) {
    pollfd events{fd_, 0, 0};
    if (::poll(&events, 1, 0) > 0 && (events.revents & (POLLHUP | POLLERR | POLLNVAL)) != 0) {
      lose(Trouble::kLost, ENODEV);
    }
  }
  // A clock that was set back must not postpone the next attempt.
  if (fd_ < 0 && (now - last_attempt_ >= kRetryInterval || now < last_attempt_)) {
    last_attempt_ = now;
    open();
  }
  return fd_ >= 0;
}

void SerialPort::open() noexcept {
  fd_ = ::open(path_.c_str(), O_RDWR | O_NOCTTY | O_NONBLOCK | O_CLOEXEC);
  if (fd_ < 0) return lose(Trouble::kOpen, errno);
  // One driver a board: two would undo each other's commands. Pseudo-terminals know no TIOCEXCL, so
  // the lock of the file itself is taken; the guardian's duplicate holds it too.
  if (::flock(fd_, LOCK_EX | LOCK_NB) != 0) return lose(Trouble::kOpen, EBUSY);
  termios settings{};
  if (::tcgetattr(fd_, &settings) != 0) return lose(Trouble::kOpen, ENOTTY);
  ::cfmakeraw(&settings);
  settings.c_cflag &= ~static_cast<tcflag_t>(CSTOPB | PARENB | CRTSCTS | CSIZE);
  settings.c_cflag |= CS8 | CLOCAL | CREAD;
  settings.c_cc[VMIN] = 1;  // with 0, "nothing yet" and "gone" would read the same
  settings.c_cc[VTIME] = 0;
  if (::cfsetspeed(&settings, speed_) != 0 || ::tcsetattr(fd_, TCSANOW, &settings) != 0) {
    return lose(Trouble::kSettings, errno);
  }
  if (!is_pseudo_terminal(fd_) && ::ioctl(fd_, TIOCEXCL) != 0) {
    return lose(Trouble::kSettings, errno);
  }
  ::tcflush(fd_, TCIFLUSH);
  trouble_ = Trouble::kNone;
  error_ = 0;
  ++openings_;
}

void SerialPort::lose(Trouble trouble, int error) noexcept {
  trouble_ = trouble;
  error_ = error;
  if (fd_ >= 0) ::close(fd_);
  fd_ = -1;
}

std::size_t SerialPort::write_some(std::span<const std::uint8_t> bytes) noexcept {
  if (fd_ < 0 || bytes.empty()) return 0;
  const ssize_t written = ::write(fd_, bytes.data(), bytes.size());
  if (written >= 0) return static_cast<std::size_t>(written);
  if (!would_block(errno)) lose(Trouble::kLost, errno);
  return 0;
}

std::size_t SerialPort::read_some(std::span<std::uint8_t> bytes) noexcept {
  if (fd_ < 0 || bytes.empty()) return 0;
  const ssize_t count = ::read(fd_, bytes.data(), bytes.size());
  if (count > 0) return static_cast<std::size_t>(count);
  if (count == 0) {
    lose(Trouble::kLost, ENODEV);  // a terminal that hung up
  } else if (!would_block(errno)) {
    lose(Trouble::kLost, errno);
  }
  return 0;
}

std::size_t SerialPort::unsent() const noexcept {
  int count = 0;
  if (fd_ < 0 || ::ioctl(fd_, TIOCOUTQ, &count) != 0 || count < 0) return 0;
  return static_cast<std::size_t>(count);
}

std::string SerialPort::last_error() const {
  if (trouble_ == Trouble::kNone) return {};
  const std::string reason = std::system_category().message(error_);
  const std::string name = "serial port " + path_;
  if (trouble_ == Trouble::kLost) {
    return name + " disappeared (" + reason + "); it is opened again as soon as it is back";
  }
  if (trouble_ == Trouble::kSettings) {
    return name + " refuses " + std::to_string(baud_rate_) + " baud, 8N1 (" + reason +
           "): is it the right port?";
  }
  switch (error_) {
    case ENOENT:
    case ENXIO:
    case ENODEV:
      return name + " is not there: plug in its adapter, or name another port";
    case EACCES:
    case EPERM:
      return name +
             " may not be opened by this user: join the group that owns it "
             "(on Debian: sudo usermod -aG dialout $USER), then log in again";
    case EBUSY:
      return name + " is in use by another program: end that one first";
    case ENOTTY:
      return name + " is no serial port: name the device's port";
    default:
      return name + " cannot be opened: " + reason;
  }
}

}  // namespace secondskin::wire
