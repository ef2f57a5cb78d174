#include "clients/tactor_driver/tactor_service.h"

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <chrono>

#include "bus/health.h"
#include "bus/reader.h"
#include "bus/stop_state.h"
#include "bus/wait_set.h"
#include "clients/tactor_driver/guardian.h"
#include "wire/serial_port.h"

namespace secondskin::tactor_driver {

namespace msg = bus::msg;

namespace {

double monotonic() noexcept {
  return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

constexpr double kLongestSleep = 0.25;   // so that a port that comes back is met [s]
constexpr double kShortestSleep = 1e-4;  // [s]
constexpr double kLongestGoodbye = 0.1;  // for the last all-off to leave [s]

}  // namespace

struct TactorService::State {
  State(bus::Participant& participant, const TactorOptions& options)
      : guardian(Guardian::start()),
        port(options.port, options.baud_rate),
        core(port.byte_rate()),
        commands(participant),
        stop(participant),
        health(participant, "tactors") {
    news.attach(commands);
    news.attach(stop.reader());
  }

  void watch_port(double now) {
    port.poll(now);
    if (!guardian.alive()) {
      spdlog::warn("the guardian process is gone; starting another");
      if (linked) unlink();
      guardian = Guardian::start();
    }
    if (port.connected() && (!linked || port.openings() != openings)) {
      openings = port.openings();
      // Nothing is turned on before somebody stands by to turn it off.
      if (!guardian.hold(port.fd())) return;
      core.link_up(now);
      linked = true;
      spdlog::info("tactor board on {}", port.path());
    }
    if (port.connected()) {
      trouble.clear();
      return;
    }
    if (linked) {
      guardian.drop();
      unlink();
    }
    if (port.last_error() != trouble) {
      trouble = port.last_error();
      spdlog::warn("{}; waiting for it", trouble);
    }
  }

  void unlink() {
    linked = false;
    core.link_down();
  }

  /// Switches everything off and waits until it has left.
  void say_goodbye() {
    const double end = monotonic() + kLongestGoodbye;
    core.stop(true, monotonic());
    for (double now = monotonic(); now < end && !core.all_off_sent(); now = monotonic()) {
      core.pump(now, port);
      const double sleep = std::clamp(core.next_due(now) - now, kShortestSleep, end - now);
      news.wait(std::chrono::nanoseconds(static_cast<std::int64_t>(std::max(sleep, 0.0) * 1e9)));
    }
  }

  void take_messages(double now) {
    if (stop.poll()) {
      core.stop(stop.active(), now);
      spdlog::warn("emergency stop {}: {}", stop.active() ? "in force" : "lifted", stop.reason());
    }
    if (commands.take_newest(command) > 0) {
      // An all-off at a session's end repeats the last sample's stamp: its age is no latency.
      const bool of_new_sample = command.header().stamp_ns() != newest.stamp_ns;
      newest.intensities = command.intensities();
      newest.stamp_ns = command.header().stamp_ns();
      newest.valid_for = static_cast<double>(command.valid_for_ns()) * 1e-9;
      newest.number = command.command_number();
      if (core.push(newest, now) == Verdict::kTaken) {
        fresh = fresh || of_new_sample;
      } else {
        health.lost(1);
      }
    }
    const bool alive = commands.counts().alive_writers > 0;
    if (coach_alive && !alive) core.coach_lost(now);
    coach_alive = alive;
  }

  void report() {
    if (!port.connected()) {
      health.state(msg::SERVICE_FAULT, port.last_error().empty()
                                           ? fmt::format("{}: not open yet", port.path())
                                           : port.last_error());
    } else if (core.stopped()) {
      health.state(msg::SERVICE_WAITING, "emergency stop in force");
    } else if (!coach_alive) {
      health.state(msg::SERVICE_WAITING, "waiting for a coach on this subject");
    } else {
      health.state(msg::SERVICE_RUNNING);
    }
  }

  Guardian guardian;
  wire::SerialPort port;
  DriverCore core;
  bus::Reader<msg::TactorCommand> commands;
  bus::StopState stop;
  bus::WaitSet news;
  bus::HealthReporter health;
  std::uint64_t openings = 0;
  bool linked = false;
  std::string trouble;  // what was last said of the port
  bool coach_alive = false;
  bool fresh = false;  // a command was taken whose bytes have not gone out
  msg::TactorCommand command;
  DriverCommand newest;
};

TactorService::TactorService(bus::Participant& participant, const TactorOptions& options)
    : state_(std::make_unique<State>(participant, options)) {}

TactorService::~TactorService() = default;

TactorSummary TactorService::run(std::stop_token stop) {
  auto& s = *state_;
  const std::stop_callback wake(stop, [&s] { s.news.wake(); });
  try {
    while (!stop.stop_requested()) {
      double now = monotonic();
      s.watch_port(now);
      s.take_messages(now);
      const std::size_t sent = s.core.pump(now, s.port);
      if (s.fresh && (sent > 0 || s.core.next_due(now) > now)) {
        // Out, or nothing of it was new to the board.
        s.fresh = false;
        s.health.sample(static_cast<double>(bus::now_ns() - s.newest.stamp_ns) * 1e-9);
      }
      s.report();
      s.health.tick(bus::now_ns());
      now = monotonic();
      const double sleep = std::clamp(s.core.next_due(now) - now, kShortestSleep, kLongestSleep);
      s.news.wait(std::chrono::nanoseconds(static_cast<std::int64_t>(sleep * 1e9)));
    }
  } catch (...) {
    s.say_goodbye();
    throw;
  }
  s.say_goodbye();
  s.guardian.finish();
  s.health.state(msg::SERVICE_ENDED);
  return {s.core.counters(), s.health.latency(), s.trouble};
}

}  // namespace secondskin::tactor_driver
