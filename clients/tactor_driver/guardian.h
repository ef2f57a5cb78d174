#pragma once

#include <sys/types.h>

#include <span>
#include <string>
#include <vector>

/// The process that turns the tactors off when the tactor driver dies, however it dies.
///
/// A dead process cannot send. The guardian is this same program, started again with a hidden
/// subcommand. It holds a duplicate of the port and the far end of a socket; when that socket
/// closes, because the driver ended, crashed or was killed, it discards what is queued, writes
/// all-off, and once more 20 ms later. It leads a session of its own and ignores SIGINT, SIGTERM,
/// SIGHUP and SIGPIPE, so that what ends the driver does not end it first. It runs at real-time
/// priority where that is allowed, so that a busy machine does not hold it up.
///
/// It does not see a driver that hangs: against that, as against a dead link, stands the board's
/// watchdog. A supervisor that kills the whole control group takes the guardian too
/// (docs/tactors.md).
namespace secondskin::tactor_driver {

/// The hidden subcommand; its arguments are {"--fd", NUMBER}.
inline constexpr const char* kGuardianCommand = "__tactor-guardian";

class Guardian {
 public:
  /// Starts the guardian and waits until it stands watch. Start it before the port is opened; the
  /// program's main must hand kGuardianCommand to guardian_main().
  /// @throws std::runtime_error, std::system_error naming what failed
  static Guardian start();

  /// As finish().
  ~Guardian();
  Guardian(Guardian&& other) noexcept;
  Guardian& operator=(Guardian&& other) noexcept;

  /// Gives it the port to write to; call it each time the port was opened, before anything is
  /// turned on. The caller keeps its own. @returns false if the guardian is gone
  [[nodiscard]] bool hold(int port_fd) noexcept;
  /// Takes a lost port away from it, so that the device can come back under its old name.
  void drop() noexcept;
  /// Whether it still stands watch. If not, start another and hold() again.
  bool alive() const noexcept;
  /// A clean end, after the driver itself has sent all-off: it sends all-off once more and ends.
  void finish() noexcept;

  pid_t pid() const noexcept { return pid_; }

 private:
  Guardian(int control_fd, pid_t pid) noexcept : control_fd_(control_fd), pid_(pid) {}

  int control_fd_ = -1;
  pid_t pid_ = -1;
};

/// What the guardian process runs: watches the socket until it closes, then turns everything off.
/// Closes every other file that the process has. @returns the process's exit status
int guardian_main(int control_fd) noexcept;

}  // namespace secondskin::tactor_driver
