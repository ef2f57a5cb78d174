#include "sim/board/virtual_board_runner.h"

#include <gtest/gtest.h>
#include <sys/resource.h>
#include <time.h>

#include <algorithm>
#include <chrono>
#include <filesystem>
#include <fstream>
#include <sstream>
#include <string>
#include <thread>
#include <vector>

#include "wire/serial_port.h"

namespace secondskin::sim {
namespace {

namespace fs = std::filesystem;
using namespace std::chrono_literals;

template <class Condition>
bool eventually(Condition condition, std::chrono::milliseconds limit = 5000ms) {
  const auto end = std::chrono::steady_clock::now() + limit;
  while (!condition()) {
    if (std::chrono::steady_clock::now() > end) return false;
    std::this_thread::sleep_for(1ms);
  }
  return true;
}

double thread_cpu_seconds(std::jthread& thread) {
  clockid_t clock{};
  timespec time{};
  if (::pthread_getcpuclockid(thread.native_handle(), &clock) != 0) return -1.0;
  ::clock_gettime(clock, &time);
  return static_cast<double>(time.tv_sec) + 1e-9 * static_cast<double>(time.tv_nsec);
}

TEST(VirtualBoardRunner, DrivesWhatIsWrittenToItsTerminalAndTripsItsWatchdog) {
  wire::PseudoTerminal terminal;
  VirtualBoardRunner runner(terminal);
  std::jthread thread([&](std::stop_token stop) { runner.run(stop); });
  wire::SerialPort port(terminal.path());
  ASSERT_TRUE(port.poll(0.0)) << port.last_error();
  ASSERT_EQ(port.write_some(wire::encode(wire::continuous_slot(10), 255)), 2U);
  EXPECT_TRUE(eventually([&] { return runner.sample().drive[10] == 1.0; }));
  EXPECT_TRUE(eventually([&] { return runner.sample().slots_on == 0; }));  // no more bytes
  EXPECT_EQ(runner.counters().watchdog_trips, 1U);
  EXPECT_EQ(runner.counters().commands, 1U);
}

TEST(VirtualBoardRunner, SleepsWhileNothingIsOnAndStopsAtOnce) {
  wire::PseudoTerminal terminal;
  VirtualBoardRunner runner(terminal);
  std::jthread thread([&](std::stop_token stop) { runner.run(stop); });
  {
    wire::SerialPort port(terminal.path());  // opened and closed: no endless hang-up
    ASSERT_TRUE(port.poll(0.0));
  }
  std::this_thread::sleep_for(50ms);
  const double before = thread_cpu_seconds(thread);
  std::this_thread::sleep_for(300ms);
  EXPECT_LT(thread_cpu_seconds(thread) - before, 0.005);
  const auto asked = std::chrono::steady_clock::now();
  thread.request_stop();
  thread.join();
  EXPECT_LT(std::chrono::steady_clock::now() - asked, 500ms);
}

TEST(WaveformRecorder, WritesARowPerChangeThatCanBeReadAtOnce) {
  const fs::path path =
      fs::temp_directory_path() / ("secondskin-waveform-" + std::to_string(::getpid()) + ".csv");
  WaveformRecorder recorder(path.string());
  BoardSample sample;
  sample.monotonic_ns = 1'000'000'000;
  recorder.record(sample);
  sample.monotonic_ns = 2'000'000'000;
  recorder.record(sample);  // no change, no row
  sample.monotonic_ns = 3'000'000'000;
  sample.slots_on = 1;
  sample.drive[15] = 1.0 / 3.0;
  recorder.record(sample);
  std::ifstream file(path);
  std::vector<std::string> lines;
  for (std::string line; std::getline(file, line);) lines.push_back(line);
  fs::remove(path);
  ASSERT_EQ(lines.size(), 3U);
  EXPECT_EQ(lines[0],
            "monotonic_ns,slots_on,drive_0,drive_1,drive_2,drive_3,drive_4,drive_5,drive_6,drive_7,"
            "drive_8,drive_9,drive_10,drive_11,drive_12,drive_13,drive_14,drive_15");
  EXPECT_EQ(lines[1], "1000000000,0,0,0,0,0,0,0,0,0,0,0,0,0,0,0,0,0");
  EXPECT_EQ(lines[2], "3000000000,1,0,0,0,0,0,0,0,0,0,0,0,0,0,0,0,0.3333");
  EXPECT_EQ(recorder.lost_rows(), 0U);
}

TEST(WaveformRecorder, CountsRowsThatAFullDiskRefuses) {
  if (!fs::exists("/dev/full")) GTEST_SKIP() << "this system has no /dev/full";
  EXPECT_THROW(WaveformRecorder("/dev/full"), std::system_error);
  EXPECT_THROW(WaveformRecorder("/nowhere/waveform.csv"), std::system_error);
}

TEST(VirtualBoardRunner, RecordsThePulsesOfItsTactors) {
  const fs::path path =
      fs::temp_directory_path() / ("secondskin-pulses-" + std::to_string(::getpid()) + ".csv");
  {
    wire::PseudoTerminal terminal;
    WaveformRecorder recorder(path.string());
    VirtualBoardRunner runner(terminal, {},
                              [&](const BoardSample& sample) { recorder.record(sample); });
    std::jthread thread([&](std::stop_token stop) { runner.run(stop); });
    wire::SerialPort port(terminal.path());
    ASSERT_TRUE(port.poll(0.0));
    for (int i = 0; i < 10; ++i) {  // a second of 15 Hz, fed within the watchdog's time
      port.write_some(wire::encode(wire::pulsed_slot(0), 255));
      std::this_thread::sleep_for(100ms);
    }
    port.write_some(wire::encode(wire::pulsed_slot(0), 0));
    EXPECT_TRUE(eventually([&] { return runner.sample().slots_on == 0; }));
  }
  std::ifstream file(path);
  std::string line;
  std::getline(file, line);
  std::vector<double> edges;  // where the drive rose
  double last = 0.0;
  while (std::getline(file, line)) {
    std::istringstream row(line);
    std::string time, slots, drive;
    std::getline(row, time, ',');
    std::getline(row, slots, ',');
    std::getline(row, drive, ',');
    if (std::stod(drive) > 0.0 && last == 0.0) edges.push_back(std::stod(time) * 1e-9);
    last = std::stod(drive);
  }
  fs::remove(path);
  EXPECT_EQ(last, 0.0);
  // The median gap: on a busy machine a pulse or two may pass between two looks.
  ASSERT_GE(edges.size(), 8U);
  std::vector<double> gaps;
  for (std::size_t i = 1; i < edges.size(); ++i) gaps.push_back(edges[i] - edges[i - 1]);
  std::nth_element(gaps.begin(), gaps.begin() + static_cast<std::ptrdiff_t>(gaps.size() / 2),
                   gaps.end());
  EXPECT_NEAR(gaps[gaps.size() / 2], 1.0 / 15.0, 0.004);
}

}  // namespace
}  // namespace secondskin::sim
