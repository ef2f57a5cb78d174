#include "sim/board/virtual_board_runner.h"

#include <poll.h>
#include <sys/eventfd.h>
#include <time.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <system_error>
#include <utility>

namespace secondskin::sim {
namespace {

constexpr int kTick_ms = 1;
constexpr int kForever = -1;

std::int64_t monotonic_ns() noexcept {
  timespec now{};
  ::clock_gettime(CLOCK_MONOTONIC, &now);
  return std::int64_t{now.tv_sec} * 1'000'000'000 + now.tv_nsec;
}

double seconds(std::int64_t ns) noexcept { return static_cast<double>(ns) * 1e-9; }

/// Wakes poll(2) when a stop is asked for.
class StopEvent {
 public:
  StopEvent() : fd_(::eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK)) {
    if (fd_ < 0) throw std::system_error(errno, std::system_category(), "virtual board: eventfd");
  }
  ~StopEvent() { ::close(fd_); }
  StopEvent(const StopEvent&) = delete;
  StopEvent& operator=(const StopEvent&) = delete;

  int fd() const noexcept { return fd_; }
  void signal() const noexcept {
    const std::uint64_t one = 1;
    [[maybe_unused]] const ssize_t written = ::write(fd_, &one, sizeof one);
  }

 private:
  int fd_;
};

}  // namespace

VirtualBoardRunner::VirtualBoardRunner(wire::PseudoTerminal& terminal,
                                       const VirtualBoardConfig& config, Observer observer)
    : terminal_(terminal),
      observer_(std::move(observer)),
      board_(config, seconds(monotonic_ns())) {}

void VirtualBoardRunner::run(std::stop_token stop) {
  const StopEvent stop_event;
  const std::stop_callback on_stop(stop, [&stop_event] { stop_event.signal(); });
  std::array<std::uint8_t, 256> bytes;
  publish(monotonic_ns());
  while (!stop.stop_requested()) {
    std::array<pollfd, 2> events{pollfd{terminal_.fd(), POLLIN, 0},
                                 pollfd{stop_event.fd(), POLLIN, 0}};
    if (::poll(events.data(), events.size(), board_.active() ? kTick_ms : kForever) < 0 &&
        errno != EINTR) {
      throw std::system_error(errno, std::system_category(), "virtual board: poll");
    }
    std::int64_t now_ns = monotonic_ns();
    std::size_t count = 0;
    while (!stop.stop_requested() && (count = terminal_.read_some(bytes)) > 0) {
      board_.receive(std::span(bytes).first(count), seconds(now_ns));
      publish(now_ns);
      now_ns = monotonic_ns();
    }
    board_.step(seconds(now_ns));
    publish(now_ns);
  }
}

void VirtualBoardRunner::publish(std::int64_t now_ns) {
  BoardSample sample;
  sample.monotonic_ns = now_ns;
  sample.drive = board_.drive();
  sample.amplitude = board_.amplitude();
  sample.slots_on = board_.slots_on();
  {
    const std::lock_guard lock(mutex_);
    sample_ = sample;
    counters_ = board_.counters();
  }
  if (!first_ && sample.drive == published_.drive && sample.slots_on == published_.slots_on) return;
  first_ = false;
  published_ = sample;
  if (observer_) observer_(sample);
}

BoardSample VirtualBoardRunner::sample() const {
  const std::lock_guard lock(mutex_);
  return sample_;
}

VirtualBoardCounters VirtualBoardRunner::counters() const {
  const std::lock_guard lock(mutex_);
  return counters_;
}

}  // namespace secondskin::sim
