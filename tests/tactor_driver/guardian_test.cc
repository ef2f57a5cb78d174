#include "clients/tactor_driver/guardian.h"

#include <fcntl.h>
#include <gtest/gtest.h>
#include <poll.h>
#include <sched.h>
#include <signal.h>
#include <spawn.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <limits>
#include <memory>
#include <optional>
#include <sstream>
#include <string>
#include <thread>
#include <vector>

#include "sim/board/virtual_board_runner.h"
#include "wire/pseudo_terminal.h"

extern char** environ;

// Real processes: a driver (driver_process.cc) turns all tactors of a virtual board on, is ended in
// every way there is, and the board's recorded waveform says when the last drive was zero.
namespace secondskin::tactor_driver {
namespace {

namespace fs = std::filesystem;
using namespace std::chrono_literals;

constexpr double kForever = std::numeric_limits<double>::infinity();
constexpr double kOffWithin = 0.100;       // the design's bound [s]
constexpr double kLinkDeadWithin = 0.250;  // when only the link dies [s]
constexpr double kScheduling = 0.010;      // the board's 1 ms tick on a busy machine [s]

std::int64_t monotonic_ns() {
  timespec now{};
  ::clock_gettime(CLOCK_MONOTONIC, &now);
  return std::int64_t{now.tv_sec} * 1'000'000'000 + now.tv_nsec;
}

template <class Condition>
bool eventually(Condition condition, std::chrono::milliseconds limit = 10'000ms) {
  const auto end = std::chrono::steady_clock::now() + limit;
  while (!condition()) {
    if (std::chrono::steady_clock::now() > end) return false;
    std::this_thread::sleep_for(1ms);
  }
  return true;
}

/// The driver process. Ended and waited for, by its id, when this goes.
class DriverProcess {
 public:
  DriverProcess(const std::string& port, const char* mode) {
    int in[2];
    int out[2];
    if (::pipe2(in, O_CLOEXEC) != 0 || ::pipe2(out, O_CLOEXEC) != 0) std::abort();
    posix_spawn_file_actions_t actions;
    ::posix_spawn_file_actions_init(&actions);
    ::posix_spawn_file_actions_adddup2(&actions, in[0], 0);
    ::posix_spawn_file_actions_adddup2(&actions, out[1], 1);
    std::string program = TACTOR_DRIVER_PROCESS;
    std::string path = port;
    std::string word = mode;
    char* arguments[] = {program.data(), path.data(), word.data(), nullptr};
    const int error = ::posix_spawn(&pid_, program.c_str(), &actions, nullptr, arguments, environ);
    ::posix_spawn_file_actions_destroy(&actions);
    ::close(in[0]);
    ::close(out[1]);
    input_ = in[1];
    output_ = out[0];
    if (error != 0) pid_ = -1;
  }
  ~DriverProcess() {
    if (pid_ > 0) {
      ::kill(pid_, SIGKILL);
      ::waitpid(pid_, nullptr, 0);
    }
    ::close(input_);
    ::close(output_);
  }
  DriverProcess(const DriverProcess&) = delete;
  DriverProcess& operator=(const DriverProcess&) = delete;

  void signal(int number) const { ::kill(pid_, number); }
  void say_something() const { [[maybe_unused]] const ssize_t written = ::write(input_, "\n", 1); }
  /// Waits for its end. @returns the status as waitpid() gives it
  std::optional<int> wait() {
    int status = 0;
    if (!eventually([&] { return ::waitpid(pid_, &status, WNOHANG) == pid_; })) return std::nullopt;
    pid_ = -1;
    return status;
  }
  /// The guardian that it says it has started; -1 if it says nothing in time.
  pid_t next_guardian() {
    std::string line;
    char byte = 0;
    pollfd events{output_, POLLIN, 0};
    while (::poll(&events, 1, 10'000) > 0 && ::read(output_, &byte, 1) == 1 && byte != '\n') {
      line += byte;
    }
    return line.rfind("guardian ", 0) == 0 ? std::stoi(line.substr(9)) : -1;
  }

 private:
  pid_t pid_ = -1;
  int input_ = -1;
  int output_ = -1;
};

struct Row {
  std::int64_t time_ns;
  std::size_t slots_on;
  double strongest;
};

std::vector<Row> read_waveform(const fs::path& path) {
  std::ifstream file(path);
  std::string line;
  std::getline(file, line);
  std::vector<Row> rows;
  while (std::getline(file, line)) {
    std::istringstream fields(line);
    std::string field;
    std::getline(fields, field, ',');
    Row row{std::stoll(field), 0, 0.0};
    std::getline(fields, field, ',');
    row.slots_on = std::stoul(field);
    while (std::getline(fields, field, ','))
      row.strongest = std::max(row.strongest, std::stod(field));
    rows.push_back(row);
  }
  return rows;
}

/// A virtual board on a terminal of a fixed name, with its recording.
class GuardianTest : public ::testing::Test {
 protected:
  GuardianTest() {
    ::prctl(PR_SET_CHILD_SUBREAPER, 1);  // a dead driver's guardian becomes this process's child
    std::string pattern = (fs::temp_directory_path() / "secondskin-guardian-XXXXXX").string();
    folder_ = ::mkdtemp(pattern.data());
    port_ = (folder_ / "board").string();
  }
  ~GuardianTest() override {
    unplug();
    fs::remove_all(folder_);
  }

  /// Without its own watchdog unless asked for, so that only the driver or its guardian can turn
  /// off.
  void plug(double watchdog = kForever) {
    terminal_.emplace(port_);
    recorder_.emplace((folder_ / "waveform.csv").string());
    runner_.emplace(*terminal_, sim::VirtualBoardConfig{.actuators = {}, .watchdog = watchdog},
                    [this](const sim::BoardSample& sample) { recorder_->record(sample); });
    thread_ = std::jthread([this](std::stop_token stop) {
      // It stands for hardware, which no load holds up. Where this is forbidden, it is.
      sched_param real_time{};
      real_time.sched_priority = 1;
      ::sched_setscheduler(0, SCHED_FIFO | SCHED_RESET_ON_FORK, &real_time);
      runner_->run(stop);
    });
  }
  void unplug() {
    if (!runner_) return;
    thread_ = std::jthread();
    runner_.reset();
    recorder_.reset();
    terminal_.reset();
  }
  bool all_on() { return runner_->sample().slots_on == 18; }
  bool all_off() { return runner_->sample().slots_on == 0; }

  /// When, after an instant, the last drive became zero for good [s later]; NaN if it did not.
  double off_after(std::int64_t since_ns) {
    if (!eventually([&] { return all_off(); })) return std::numeric_limits<double>::quiet_NaN();
    std::this_thread::sleep_for(60ms);  // the guardian's repetition, and anything that comes back
    const std::vector<Row> rows = read_waveform(folder_ / "waveform.csv");
    double off = std::numeric_limits<double>::quiet_NaN();
    for (const Row& row : rows) {
      if (row.slots_on > 0) {
        off = std::numeric_limits<double>::quiet_NaN();
      } else if (std::isnan(off)) {
        EXPECT_EQ(row.strongest, 0.0);
        off = static_cast<double>(row.time_ns - since_ns) * 1e-9;
      }
    }
    return off;
  }
  /// Waits for the end of a guardian whose driver is gone.
  static bool reaped(pid_t guardian) {
    return eventually([&] {
      const pid_t found = ::waitpid(guardian, nullptr, WNOHANG);
      return found == guardian || (found < 0 && errno == ECHILD);
    });
  }

  fs::path folder_;
  std::string port_;
  std::optional<wire::PseudoTerminal> terminal_;
  std::optional<sim::WaveformRecorder> recorder_;
  std::optional<sim::VirtualBoardRunner> runner_;
  std::jthread thread_;
};

TEST_F(GuardianTest, TurnsEverythingOffWhenTheDriverIsKilled) {
  std::vector<double> times;
  for (int n = 0; n < 10; ++n) {
    plug();
    DriverProcess driver(port_, "drive");
    const pid_t guardian = driver.next_guardian();
    ASSERT_GT(guardian, 0);
    ASSERT_TRUE(eventually([&] { return all_on(); }));
    std::this_thread::sleep_for(std::chrono::milliseconds(7 * n));  // anywhere in its cycle
    const std::int64_t killed = monotonic_ns();
    driver.signal(SIGKILL);
    const double off = off_after(killed);
    EXPECT_LT(off, kOffWithin);
    times.push_back(off);
    ASSERT_TRUE(driver.wait());
    EXPECT_TRUE(reaped(guardian));
    unplug();
  }
  std::sort(times.begin(), times.end());
  std::cout << "all drives at 0 after SIGKILL: median " << times[times.size() / 2] * 1e3
            << " ms, longest " << times.back() * 1e3 << " ms\n";
}

TEST_F(GuardianTest, TurnsEverythingOffWhenTheDriverCrashes) {
  plug();
  DriverProcess driver(port_, "crash");
  ASSERT_TRUE(eventually([&] { return all_on(); }));
  const std::int64_t crashed = monotonic_ns();
  driver.say_something();
  EXPECT_LT(off_after(crashed), kOffWithin);
  const auto status = driver.wait();
  ASSERT_TRUE(status);
  EXPECT_TRUE(WIFSIGNALED(*status));
}

TEST_F(GuardianTest, LeavesNothingOnAfterATermination) {
  for (const int signal : {SIGTERM, SIGINT}) {
    plug();
    DriverProcess driver(port_, "drive");
    const pid_t guardian = driver.next_guardian();
    ASSERT_TRUE(eventually([&] { return all_on(); }));
    const std::int64_t asked = monotonic_ns();
    driver.signal(signal);
    EXPECT_LT(off_after(asked), kOffWithin);
    const auto status = driver.wait();
    ASSERT_TRUE(status);
    EXPECT_TRUE(WIFEXITED(*status) && WEXITSTATUS(*status) == 0);
    EXPECT_NE(::kill(guardian, 0), 0);  // waited for by the driver
    unplug();
  }
}

TEST_F(GuardianTest, TurnsEverythingOffForADriverThatEndsWithoutDoingSo) {
  plug();
  DriverProcess driver(port_, "late-quit");
  ASSERT_TRUE(eventually([&] { return all_on(); }));
  const std::int64_t asked = monotonic_ns();
  driver.signal(SIGTERM);
  EXPECT_LT(off_after(asked), kOffWithin);
}

TEST_F(GuardianTest, TurnsEverythingOffWhenTheCommandsEnd) {
  plug();
  DriverProcess driver(port_, "lapse");  // the driver's own doing: it lives
  ASSERT_TRUE(eventually([&] { return runner_->counters().commands > 40; }));
  EXPECT_LT(off_after(monotonic_ns()), 0.060 + kOffWithin);
}

TEST_F(GuardianTest, LeavesADeadLinkToTheBoardsWatchdog) {
  plug(wire::kBoardWatchdog);
  DriverProcess driver(port_, "drive");
  ASSERT_TRUE(eventually([&] { return all_on(); }));
  const std::int64_t stopped = monotonic_ns();
  driver.signal(SIGSTOP);  // lives, so the guardian waits; writes nothing
  const double off = off_after(stopped);
  EXPECT_LT(off, kLinkDeadWithin + kScheduling);
  std::cout << "all drives at 0 after the link fell silent: " << off * 1e3 << " ms\n";
  EXPECT_EQ(runner_->counters().watchdog_trips, 1U);
  driver.signal(SIGCONT);
  EXPECT_TRUE(eventually([&] { return all_on(); }));  // and goes on where the commands are
}

TEST_F(GuardianTest, IgnoresTheSignalsThatEndADriver) {
  plug();
  DriverProcess driver(port_, "drive");
  const pid_t guardian = driver.next_guardian();
  ASSERT_GT(guardian, 0);
  ASSERT_TRUE(eventually([&] { return all_on(); }));
  EXPECT_EQ(::getsid(guardian), guardian);  // a terminal's Ctrl-C does not reach it at all
  for (const int signal : {SIGINT, SIGTERM, SIGHUP, SIGPIPE}) ::kill(guardian, signal);
  std::this_thread::sleep_for(50ms);
  EXPECT_EQ(::kill(guardian, 0), 0);
  const std::int64_t killed = monotonic_ns();
  driver.signal(SIGKILL);
  EXPECT_LT(off_after(killed), kOffWithin);
  ASSERT_TRUE(driver.wait());
  EXPECT_TRUE(reaped(guardian));
}

TEST_F(GuardianTest, HoldsNoFileOfTheDriverButThePort) {
  plug();
  DriverProcess driver(port_, "drive");
  const pid_t guardian = driver.next_guardian();
  ASSERT_TRUE(eventually([&] { return all_on(); }));
  std::vector<std::string> files;
  for (const auto& entry : fs::directory_iterator("/proc/" + std::to_string(guardian) + "/fd")) {
    files.push_back(fs::read_symlink(entry).string());
  }
  std::sort(files.begin(), files.end());
  ASSERT_EQ(files.size(), 5U);
  for (std::size_t i = 0; i < 3; ++i) EXPECT_EQ(files[i], "/dev/null");
  EXPECT_EQ(files[3], terminal_->slave_path());
  EXPECT_EQ(files[4].rfind("socket:", 0), 0U);
  std::ifstream name("/proc/" + std::to_string(guardian) + "/comm");
  std::string text;
  std::getline(name, text);
  EXPECT_EQ(text, "tactor-guardian");
}

TEST_F(GuardianTest, IsReplacedWhenItIsKilledItself) {
  plug();
  DriverProcess driver(port_, "drive");
  const pid_t first = driver.next_guardian();
  ASSERT_GT(first, 0);
  ASSERT_TRUE(eventually([&] { return all_on(); }));
  ::kill(first, SIGKILL);
  const pid_t second = driver.next_guardian();
  ASSERT_GT(second, 0);
  EXPECT_NE(second, first);
  std::this_thread::sleep_for(50ms);
  const std::int64_t killed = monotonic_ns();
  driver.signal(SIGKILL);
  EXPECT_LT(off_after(killed), kOffWithin);
  ASSERT_TRUE(driver.wait());
  EXPECT_TRUE(reaped(second));
}

TEST_F(GuardianTest, FollowsThePortThatVanishedAndReturned) {
  plug();
  DriverProcess driver(port_, "drive");
  const pid_t guardian = driver.next_guardian();
  ASSERT_TRUE(eventually([&] { return all_on(); }));
  unplug();
  std::this_thread::sleep_for(100ms);
  plug();
  ASSERT_TRUE(eventually([&] { return all_on(); })) << "the driver did not reconnect";
  const std::int64_t killed = monotonic_ns();
  driver.signal(SIGKILL);
  EXPECT_LT(off_after(killed), kOffWithin);
  ASSERT_TRUE(driver.wait());
  EXPECT_TRUE(reaped(guardian));
}

TEST_F(GuardianTest, GivesUpOnAPortThatTakesNothing) {
  plug(wire::kBoardWatchdog);
  DriverProcess driver(port_, "drive");
  const pid_t guardian = driver.next_guardian();
  ASSERT_TRUE(eventually([&] { return all_on(); }));
  const int fd = ::open(port_.c_str(), O_RDWR | O_NOCTTY | O_CLOEXEC);
  ASSERT_GE(fd, 0);
  ASSERT_EQ(::tcflow(fd, TCOOFF), 0);  // held, as by flow control
  const std::int64_t killed = monotonic_ns();
  driver.signal(SIGKILL);
  EXPECT_LT(off_after(killed), kLinkDeadWithin + kScheduling);  // the board's own doing
  ASSERT_TRUE(driver.wait());
  EXPECT_TRUE(reaped(guardian));
  EXPECT_LT(static_cast<double>(monotonic_ns() - killed) * 1e-9, 2.0);
  ::close(fd);
}

TEST_F(GuardianTest, EndsWhenThePortIsGone) {
  plug();
  DriverProcess driver(port_, "drive");
  const pid_t guardian = driver.next_guardian();
  ASSERT_TRUE(eventually([&] { return all_on(); }));
  unplug();
  driver.signal(SIGKILL);
  ASSERT_TRUE(driver.wait());
  EXPECT_TRUE(reaped(guardian));
}

}  // namespace
}  // namespace secondskin::tactor_driver
