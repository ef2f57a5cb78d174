// A tactor driver without topics, for guardian_test.cc to kill:
//   tactor_driver_process PORT drive        all sixteen tactors on, until a signal
//   tactor_driver_process PORT lapse        one command for 60 ms, then nothing more
//   tactor_driver_process PORT crash        abort() when a line comes in
//   tactor_driver_process PORT late-quit    ends with tactors on, leaving all-off to the guardian
// Prints "guardian PID" whenever it has started a guardian.
#include <poll.h>
#include <signal.h>
#include <time.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <string>

#include "clients/tactor_driver/driver_core.h"
#include "clients/tactor_driver/guardian.h"
#include "wire/serial_port.h"

namespace {

using secondskin::tactor_driver::DriverCommand;
using secondskin::tactor_driver::DriverCore;
using secondskin::tactor_driver::Guardian;
using secondskin::wire::SerialPort;

volatile sig_atomic_t ended = 0;

double now() {
  timespec time{};
  ::clock_gettime(CLOCK_MONOTONIC, &time);
  return static_cast<double>(time.tv_sec) + 1e-9 * static_cast<double>(time.tv_nsec);
}

Guardian start_guardian() {
  Guardian guardian = Guardian::start();
  std::printf("guardian %d\n", static_cast<int>(guardian.pid()));
  std::fflush(stdout);
  return guardian;
}

int drive(const char* path, const std::string& mode) {
  Guardian guardian = start_guardian();
  SerialPort port(path);
  DriverCore core(port.byte_rate());
  DriverCommand command;
  command.valid_for = 0.06;
  for (std::size_t tactor = 0; tactor < 16; ++tactor) {
    command.intensities[secondskin::wire::continuous_slot(tactor)] = 200;
  }
  command.intensities[secondskin::wire::pulsed_slot(0)] = 255;
  command.intensities[secondskin::wire::saltation_slot(3, true)] = 255;
  double next_command = now();
  std::uint64_t openings = 0;
  bool stop_sent = false;
  for (;;) {
    const bool connected = port.poll(now());
    if (!guardian.alive()) {
      guardian = start_guardian();
      if (connected && !guardian.hold(port.fd())) continue;
    }
    if (connected && port.openings() != openings) {
      if (!guardian.hold(port.fd())) continue;
      openings = port.openings();
      core.link_up(now());
    } else if (!connected && openings != 0) {
      guardian.drop();
      core.link_down();
    }
    if (now() >= next_command && !(mode == "lapse" && command.number > 0)) {
      ++command.number;
      core.push(command, now());
      next_command = now() + 0.016;
    }
    if (ended != 0) {
      if (mode == "late-quit") return 0;
      if (!stop_sent) core.stop(true, now());
      stop_sent = true;
    }
    core.pump(now(), port);
    if (stop_sent && core.all_off_sent()) {
      guardian.finish();
      return 0;
    }
    const double wait = std::min({core.next_due(now()), next_command, now() + 0.05}) - now();
    pollfd input{0, POLLIN, 0};
    const int ms = std::max(0, static_cast<int>(std::ceil(wait * 1000.0)));
    if (::poll(&input, mode == "crash" ? 1 : 0, ms) > 0 && input.revents != 0) std::abort();
  }
}

}  // namespace

int main(int argc, char** argv) {
  if (argc == 4 && std::strcmp(argv[1], secondskin::tactor_driver::kGuardianCommand) == 0) {
    return secondskin::tactor_driver::guardian_main(std::atoi(argv[3]));
  }
  if (argc != 3) return 2;
  struct sigaction action {};
  action.sa_handler = [](int) { ended = 1; };
  ::sigaction(SIGTERM, &action, nullptr);
  ::sigaction(SIGINT, &action, nullptr);
  try {
    return drive(argv[1], argv[2]);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "tactor_driver_process: %s\n", error.what());
    return 1;
  }
}
