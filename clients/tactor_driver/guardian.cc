#include "clients/tactor_driver/guardian.h"

#include <fcntl.h>
#include <linux/close_range.h>
#include <poll.h>
#include <sched.h>
#include <signal.h>
#include <spawn.h>
#include <sys/ioctl.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstdint>
#include <cstring>
#include <stdexcept>
#include <system_error>
#include <utility>

#include "wire/tactor_protocol.h"

extern char** environ;

namespace secondskin::tactor_driver {
namespace {

// One byte a message on the control socket.
constexpr char kReady = 'R';  // guardian to driver: standing watch
constexpr char kHold = 'H';   // with the port
constexpr char kDrop = 'D';
constexpr char kQuit = 'Q';

constexpr int kControlFd = 3;  // the socket's number in the guardian
constexpr int kStartTimeout_ms = 5'000;
constexpr int kFinishTimeout_ms = 600;  // two attempts at a stuck port
constexpr int kWriteTimeout_ms = 200;
constexpr int kRepeatAfter_ms = 20;  // as long as a board's parser waits for half a pair

std::int64_t now_ms() noexcept {
  timespec now{};
  ::clock_gettime(CLOCK_MONOTONIC, &now);
  return std::int64_t{now.tv_sec} * 1000 + now.tv_nsec / 1'000'000;
}

void sleep_ms(int ms) noexcept { ::poll(nullptr, 0, ms); }

bool send_message(int socket_fd, char message, int port_fd = -1) noexcept {
  iovec data{&message, 1};
  msghdr header{};
  header.msg_iov = &data;
  header.msg_iovlen = 1;
  alignas(cmsghdr) std::array<char, CMSG_SPACE(sizeof(int))> control{};
  if (port_fd >= 0) {
    header.msg_control = control.data();
    header.msg_controllen = control.size();
    cmsghdr* const rights = CMSG_FIRSTHDR(&header);
    rights->cmsg_level = SOL_SOCKET;
    rights->cmsg_type = SCM_RIGHTS;
    rights->cmsg_len = CMSG_LEN(sizeof(int));
    std::memcpy(CMSG_DATA(rights), &port_fd, sizeof port_fd);
  }
  ssize_t sent = 0;
  do {
    sent = ::sendmsg(socket_fd, &header, MSG_NOSIGNAL | MSG_DONTWAIT);
  } while (sent < 0 && errno == EINTR);
  return sent == 1;
}

struct Received {
  char message = 0;  ///< 0 when the socket closed
  int port_fd = -1;
};

Received receive_message(int socket_fd) noexcept {
  Received received;
  iovec data{&received.message, 1};
  msghdr header{};
  header.msg_iov = &data;
  header.msg_iovlen = 1;
  alignas(cmsghdr) std::array<char, CMSG_SPACE(sizeof(int))> control{};
  header.msg_control = control.data();
  header.msg_controllen = control.size();
  ssize_t count = 0;
  do {
    count = ::recvmsg(socket_fd, &header, MSG_CMSG_CLOEXEC);
  } while (count < 0 && errno == EINTR);
  if (count <= 0) return {};
  const cmsghdr* const rights = CMSG_FIRSTHDR(&header);
  if (rights != nullptr && rights->cmsg_level == SOL_SOCKET && rights->cmsg_type == SCM_RIGHTS &&
      rights->cmsg_len == CMSG_LEN(sizeof(int))) {
    std::memcpy(&received.port_fd, CMSG_DATA(rights), sizeof(int));
  }
  return received;
}

/// Eighty bytes, past whatever was queued, and until they are on the wire; gives up in time.
void write_all_off(int port_fd) noexcept {
  const auto bytes = wire::encode_all_off();
  const std::int64_t deadline = now_ms() + kWriteTimeout_ms;
  // The queue may hold "on" commands, or be full. What this tears, the resynchronisation rule
  // mends.
  ::tcflush(port_fd, TCOFLUSH);
  std::size_t done = 0;
  while (done < bytes.size()) {
    const ssize_t written = ::write(port_fd, bytes.data() + done, bytes.size() - done);
    if (written > 0) {
      done += static_cast<std::size_t>(written);
      continue;
    }
    if (written < 0 && errno != EAGAIN && errno != EWOULDBLOCK && errno != EINTR) return;
    const std::int64_t left = deadline - now_ms();
    if (left <= 0) return;
    pollfd events{port_fd, POLLOUT, 0};
    if (::poll(&events, 1, static_cast<int>(left)) > 0 &&
        (events.revents & (POLLHUP | POLLERR | POLLNVAL)) != 0) {
      return;
    }
  }
  // tcdrain() could wait for ever on a dead device.
  int queued = 0;
  while (::ioctl(port_fd, TIOCOUTQ, &queued) == 0 && queued > 0 && now_ms() < deadline) {
    sleep_ms(1);
  }
}

/// On a busy machine the guardian must not wait its turn; it sleeps all its life and runs once.
/// Each may be forbidden, which leaves the guardian as it is.
void be_scheduled_at_once() noexcept {
  sched_param real_time{};
  real_time.sched_priority = 1;
  if (::sched_setscheduler(0, SCHED_FIFO | SCHED_RESET_ON_FORK, &real_time) == 0) return;
  ::setpriority(PRIO_PROCESS, 0, -10);
  // Linux 6.12 and later: an ordinary process that asks for short slices is woken sooner.
  struct {
    std::uint32_t size = 48;
    std::uint32_t policy = SCHED_OTHER;
    std::uint64_t flags = 0;
    std::int32_t nice = 0;
    std::uint32_t priority = 0;
    std::uint64_t runtime_ns = 100'000;
    std::uint64_t deadline_ns = 0;
    std::uint64_t period_ns = 0;
  } attributes;
  static_assert(sizeof attributes == 48);  // SCHED_ATTR_SIZE_VER0
  attributes.nice = ::getpriority(PRIO_PROCESS, 0);
  ::syscall(SYS_sched_setattr, 0, &attributes, 0U);
}

void leave_everything_but(int control_fd) noexcept {
  ::setsid();
  if (::chdir("/") != 0) {
    // Only keeps a file system busy.
  }
  ::prctl(PR_SET_NAME, "tactor-guardian");
  be_scheduled_at_once();
  for (const int signal : {SIGINT, SIGTERM, SIGHUP, SIGPIPE, SIGQUIT, SIGTSTP, SIGTTIN, SIGTTOU}) {
    ::signal(signal, SIG_IGN);
  }
  sigset_t none;
  ::sigemptyset(&none);
  ::sigprocmask(SIG_SETMASK, &none, nullptr);
  const int null_fd = ::open("/dev/null", O_RDWR | O_CLOEXEC);
  for (int fd = 0; fd < 3; ++fd) {
    if (null_fd >= 0 && fd != control_fd) ::dup2(null_fd, fd);
  }
  const auto close_between = [](unsigned first, unsigned last) {
    if (first <= last) ::close_range(first, last, 0);
  };
  const auto kept = static_cast<unsigned>(control_fd);
  if (kept > 3) close_between(3, kept - 1);
  close_between(std::max(kept + 1, 3U), ~0U);
}

}  // namespace

Guardian Guardian::start() {
  std::array<int, 2> ends{-1, -1};
  // Packets: each message keeps its port. Close-on-exec: no other child may hold the driver's end,
  // or the guardian would not see the driver die.
  if (::socketpair(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC, 0, ends.data()) != 0) {
    throw std::system_error(errno, std::system_category(), "tactor guardian: socketpair");
  }
  posix_spawn_file_actions_t actions;
  posix_spawnattr_t attributes;
  ::posix_spawn_file_actions_init(&actions);
  ::posix_spawn_file_actions_adddup2(&actions, ends[1], kControlFd);
  ::posix_spawnattr_init(&attributes);
  sigset_t all;
  ::sigfillset(&all);  // until guardian_main() has said which it ignores
  ::posix_spawnattr_setsigmask(&attributes, &all);
  ::posix_spawnattr_setflags(&attributes, POSIX_SPAWN_SETSID | POSIX_SPAWN_SETSIGMASK);
  std::string program = "secondskin";
  std::string command = kGuardianCommand;
  std::string option = "--fd";
  std::string number = std::to_string(kControlFd);
  std::array<char*, 5> arguments{program.data(), command.data(), option.data(), number.data(),
                                 nullptr};
  pid_t pid = -1;
  const int error =
      ::posix_spawn(&pid, "/proc/self/exe", &actions, &attributes, arguments.data(), environ);
  ::posix_spawn_file_actions_destroy(&actions);
  ::posix_spawnattr_destroy(&attributes);
  ::close(ends[1]);
  if (error != 0) {
    ::close(ends[0]);
    throw std::system_error(error, std::system_category(),
                            "tactor guardian: cannot start /proc/self/exe");
  }
  Guardian guardian(ends[0], pid);
  pollfd events{ends[0], POLLIN, 0};
  if (::poll(&events, 1, kStartTimeout_ms) <= 0 || receive_message(ends[0]).message != kReady) {
    ::kill(pid, SIGKILL);
    throw std::runtime_error("tactor guardian: process " + std::to_string(pid) +
                             " did not stand watch within 5 s; without it nothing is turned on");
  }
  return guardian;
}

Guardian::~Guardian() { finish(); }

Guardian::Guardian(Guardian&& other) noexcept
    : control_fd_(std::exchange(other.control_fd_, -1)), pid_(std::exchange(other.pid_, -1)) {}

Guardian& Guardian::operator=(Guardian&& other) noexcept {
  if (this != &other) {
    finish();
    control_fd_ = std::exchange(other.control_fd_, -1);
    pid_ = std::exchange(other.pid_, -1);
  }
  return *this;
}

bool Guardian::hold(int port_fd) noexcept {
  return control_fd_ >= 0 && port_fd >= 0 && send_message(control_fd_, kHold, port_fd);
}

void Guardian::drop() noexcept {
  if (control_fd_ >= 0) send_message(control_fd_, kDrop);
}

bool Guardian::alive() const noexcept {
  if (control_fd_ < 0) return false;
  pollfd events{control_fd_, 0, 0};
  return ::poll(&events, 1, 0) == 0;
}

void Guardian::finish() noexcept {
  if (control_fd_ < 0) return;
  send_message(control_fd_, kQuit);
  ::close(std::exchange(control_fd_, -1));
  const std::int64_t deadline = now_ms() + kFinishTimeout_ms;
  const pid_t pid = std::exchange(pid_, -1);
  while (::waitpid(pid, nullptr, WNOHANG) == 0 && now_ms() < deadline) sleep_ms(1);
}

int guardian_main(int control_fd) noexcept {
  leave_everything_but(control_fd);
  if (!send_message(control_fd, kReady)) return 1;
  int port_fd = -1;
  for (;;) {
    const Received received = receive_message(control_fd);
    if (received.message == kHold && received.port_fd >= 0) {
      if (port_fd >= 0) ::close(port_fd);
      port_fd = received.port_fd;
      // A driver that opened it otherwise must not make the guardian wait.
      const int flags = ::fcntl(port_fd, F_GETFL);
      if (flags >= 0) ::fcntl(port_fd, F_SETFL, flags | O_NONBLOCK);
    } else if (received.message == kDrop) {
      if (port_fd >= 0) ::close(std::exchange(port_fd, -1));
    } else if (received.message == kQuit || received.message == 0) {
      if (port_fd >= 0) {
        // The queue may hold "on" commands, or be full. What this tears, the parser's rule mends.
        ::tcflush(port_fd, TCOFLUSH);
        write_all_off(port_fd);
        if (received.message != kQuit) {
          sleep_ms(kRepeatAfter_ms);
          write_all_off(port_fd);
        }
      }
      return 0;
    }
  }
}

}  // namespace secondskin::tactor_driver
