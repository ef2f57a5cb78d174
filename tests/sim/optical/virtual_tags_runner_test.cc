#include <gtest/gtest.h>

#include <chrono>
#include <filesystem>
#include <thread>

#include "scenes.h"
#include "sim/optical/virtual_tags.h"
#include "wire/serial_port.h"

namespace secondskin::sim {
namespace {

using namespace std::chrono_literals;
using Bytes = std::vector<std::uint8_t>;

template <class Condition>
bool eventually(Condition condition, std::chrono::milliseconds limit = 10'000ms) {
  const auto end = std::chrono::steady_clock::now() + limit;
  while (!condition()) {
    if (std::chrono::steady_clock::now() > end) return false;
    std::this_thread::sleep_for(1ms);
  }
  return true;
}

class RunningTags : public testing::Test {
 protected:
  void start(std::vector<std::string> links = {}) {
    runner_.emplace(rig_, tag_sizes(suit_), TagLink{}, 3, std::move(links));
  }
  void run() {
    thread_ = std::jthread([this](std::stop_token stop) { runner_->run(stop); });
  }
  // Appends what has come.
  static void read(wire::SerialPort& port, Bytes& bytes) {
    std::array<std::uint8_t, 4096> buffer;
    while (const std::size_t count = port.read_some(buffer)) {
      bytes.insert(bytes.end(), buffer.begin(), buffer.begin() + static_cast<long>(count));
    }
  }

  Suit suit_ = shipped_suit("second_skin");
  SuitScene scene_{reference("wave_hello"), suit_, AtEnd::kThereAndBack};
  VirtualRig rig_{second_skin_rig(), scene_, OpticalNoise{}, 7};
  std::optional<VirtualTagsRunner> runner_;
  std::jthread thread_;
};

TEST_F(RunningTags, SendWhatTheFilesHold) {
  start();
  wire::SerialPort first(runner_->path(0)), second(runner_->path(1));
  ASSERT_TRUE(first.poll(0.0)) << first.last_error();
  ASSERT_TRUE(second.poll(0.0)) << second.last_error();
  run();
  std::vector<Bytes> got(2);
  ASSERT_TRUE(eventually([&] {
    read(first, got[0]);
    read(second, got[1]);
    return got[0].size() >= 20 * 289 && got[1].size() >= 20 * 129;
  }));
  thread_ = {};
  const auto counters = runner_->counters();
  if (counters.skipped > 0 || counters.dropped_bytes > 0) {
    GTEST_SKIP() << "this machine is too busy to keep time";
  }

  SuitScene scene{reference("wave_hello"), suit_, AtEnd::kThereAndBack};
  VirtualRig rig{second_skin_rig(), scene, OpticalNoise{}, 7};
  VirtualTags tags(rig, tag_sizes(suit_), {}, 3);
  std::vector<Bytes> expected(2);
  while (expected[0].size() < got[0].size() || expected[1].size() < got[1].size()) {
    tags.cycle(static_cast<double>(expected[1].size() / 129) * tags.cycle_time(),
               [&](std::size_t tag, double, auto bytes) {
                 expected[tag].insert(expected[tag].end(), bytes.begin(), bytes.end());
               });
  }
  for (std::size_t tag = 0; tag < 2; ++tag) {
    expected[tag].resize(got[tag].size());
    EXPECT_EQ(got[tag], expected[tag]);
  }
  EXPECT_TRUE(runner_->start_ns());
}

TEST_F(RunningTags, CanBeUnpluggedAndComeBackUnderTheirName) {
  const std::string link = testing::TempDir() + "/second_skin_tag_1";
  start({"", link});
  run();
  EXPECT_EQ(runner_->path(1), link);
  wire::SerialPort port(link);
  Bytes bytes;
  EXPECT_TRUE(eventually([&] { return port.poll(0.0); }));
  EXPECT_TRUE(eventually([&] {
    read(port, bytes);
    return bytes.size() > 300;
  }));
  runner_->unplug(1);
  EXPECT_EQ(runner_->path(1), "");
  EXPECT_FALSE(std::filesystem::exists(link));
  EXPECT_TRUE(eventually([&] {
    read(port, bytes);
    return !port.connected();
  }));
  runner_->unplug(1);  // twice is once
  EXPECT_TRUE(eventually([&] { return runner_->counters().dropped_bytes > 0; }));
  runner_->plug(1);
  runner_->plug(1);
  wire::SerialPort again(runner_->path(1));
  bytes.clear();
  EXPECT_TRUE(eventually([&] { return again.poll(0.0); }));
  EXPECT_TRUE(eventually([&] {
    read(again, bytes);
    return bytes.size() > 300;
  }));
}

TEST_F(RunningTags, CanLoseAProjectorWhileTheyRun) {
  start();
  wire::SerialPort port(runner_->path(0));
  ASSERT_TRUE(port.poll(0.0)) << port.last_error();
  run();
  wire::TagDecoder decoder({18, 16, false});
  // How many values of projector 4 came in the last sets.
  int lit = -1;
  const auto sink = [&](const wire::TagSet& set) {
    lit = 0;
    for (std::size_t i = 0; i < 18; ++i) lit += set.values[i * 16 + 4] != 0 ? 1 : 0;
  };
  const auto decode = [&] {
    Bytes bytes;
    read(port, bytes);
    decoder.feed(bytes, 0, sink);
  };
  EXPECT_TRUE(eventually([&] {
    decode();
    return lit > 0;
  }));
  runner_->darken(4, true);
  EXPECT_TRUE(eventually([&] {
    decode();
    return lit == 0;
  }));
  runner_->darken(4, false);
  EXPECT_TRUE(eventually([&] {
    decode();
    return lit > 0;
  }));
  EXPECT_THROW(runner_->darken(16, true), std::out_of_range);
}

TEST_F(RunningTags, StopAtOnceAndCountWhatNobodyReads) {
  start();
  run();
  EXPECT_TRUE(eventually([&] { return runner_->counters().dropped_bytes > 0; }));
  const auto begin = std::chrono::steady_clock::now();
  thread_ = {};
  EXPECT_LT(std::chrono::steady_clock::now() - begin, 5s);
}

}  // namespace
}  // namespace secondskin::sim
