#include <gtest/gtest.h>

#include "bus/writer.h"
#include "session.h"

// Whatever dies, the skin is left alone: real processes are killed while tactors are driven, and
// the board's recorded waveform is read.

namespace secondskin::session {
namespace {

constexpr std::int64_t kLongest_ns = 100'000'000;  // the design's bound when a process dies
constexpr std::int64_t kLongestOfALink_ns =
    260'000'000;  // the board's watchdog, 250 ms, and a tick

// How long after `since` something was still driven [ns].
testing::AssertionResult all_off_within(const std::string& waveform, std::int64_t since,
                                        std::int64_t longest_ns) {
  const auto rows = read_waveform(waveform);
  std::int64_t last_on = 0;
  for (std::size_t i = 0; i < rows.size(); ++i) {
    if (rows[i].slots_on == 0 && rows[i].strongest == 0.0) continue;
    last_on = i + 1 < rows.size() ? rows[i + 1].monotonic_ns : monotonic_ns();
  }
  const double took_ms = static_cast<double>(last_on - since) * 1e-6;
  if (last_on == 0) return testing::AssertionFailure() << "nothing was ever on";
  if (last_on - since > longest_ns) {
    return testing::AssertionFailure() << "driven until " << took_ms << " ms after";
  }
  return testing::AssertionSuccess() << took_ms << " ms";
}

class Safety : public testing::Test {
 protected:
  void begin() {
    parts_.push_back(session_.board());
    ASSERT_TRUE(eventually([&] { return parts_[0].says("port "); }, 10s));
  }
  void wait_until_on() {
    ASSERT_TRUE(eventually([&] { return session_.tactors_are_on(); }, 60s)) << log();
  }
  std::string log() const {
    std::string all;
    for (const auto& part : parts_) all += part.output();
    return all;
  }
  // Long enough for anything late to show.
  static void let_time_pass() { std::this_thread::sleep_for(400ms); }

  Session session_;
  std::vector<Process> parts_;
};

TEST_F(Safety, AKilledCoachLeavesNothingOn) {
  begin();
  parts_.push_back(session_.tactors());
  parts_.push_back(session_.capture());
  Process coach = session_.coach();
  wait_until_on();
  const std::int64_t killed = monotonic_ns();
  coach.end(SIGKILL);
  let_time_pass();
  EXPECT_TRUE(all_off_within(session_.waveform(), killed, kLongest_ns)) << log();
}

TEST_F(Safety, AKilledDriverLeavesNothingOn) {
  begin();
  parts_.push_back(session_.capture());
  parts_.push_back(session_.coach());
  Process tactors = session_.tactors();
  wait_until_on();
  const std::int64_t killed = monotonic_ns();
  tactors.end(SIGKILL);
  let_time_pass();
  EXPECT_TRUE(all_off_within(session_.waveform(), killed, kLongest_ns)) << log();
}

TEST_F(Safety, ADriverThatIsAskedToEndLeavesNothingOn) {
  begin();
  parts_.push_back(session_.capture());
  parts_.push_back(session_.coach());
  Process tactors = session_.tactors();
  wait_until_on();
  const std::int64_t asked = monotonic_ns();
  tactors.end(SIGTERM);
  ASSERT_TRUE(tactors.wait(5s));
  EXPECT_EQ(tactors.exit_code(), 0);
  let_time_pass();
  EXPECT_TRUE(all_off_within(session_.waveform(), asked, kLongest_ns)) << log();
}

TEST_F(Safety, AKilledTrainLeavesNothingOn) {
  begin();
  Process train = session_.start(
      "train",
      session_.on_bus({"train", "--reference", "low_block", "--tolerance-scale", "0.2", "--port",
                       session_.port(), "--recording", session_.folder / "killed.mcap"}));
  wait_until_on();
  std::this_thread::sleep_for(1s);  // at most the last half second of the recording is lost
  wait_until_on();
  const std::int64_t killed = monotonic_ns();
  train.end(SIGKILL);
  let_time_pass();
  EXPECT_TRUE(all_off_within(session_.waveform(), killed, kLongest_ns)) << train.output();

  // And the recording of the killed session still opens.
  Process info = session_.start("info", {"info", session_.folder / "killed.mcap"});
  ASSERT_TRUE(info.wait(20s));
  EXPECT_EQ(info.exit_code(), 0) << info.output();
  EXPECT_TRUE(info.says("finished: false")) << info.output();
  EXPECT_TRUE(info.says("/pose")) << info.output();
}

TEST_F(Safety, AStopOnTheTopicTurnsEverythingOffAtOnce) {
  begin();
  parts_.push_back(session_.tactors());
  parts_.push_back(session_.capture());
  parts_.push_back(session_.coach());
  bus::Config config;
  config.domain = 10 + static_cast<std::uint32_t>(::getpid()) % 90;
  config.subject = "test_" + std::to_string(::getpid());
  config.qos_file = SECONDSKIN_SOURCE_DIR "/idl/qos.xml";
  bus::Participant participant(config);
  bus::Writer<bus::msg::EmergencyStop> writer(participant);
  ASSERT_TRUE(writer.wait_for_readers(2, 20s)) << "driver and coach";
  wait_until_on();
  bus::msg::EmergencyStop stop;
  stop.active(true);
  const std::int64_t said = monotonic_ns();
  ASSERT_TRUE(writer.write(stop));
  let_time_pass();
  EXPECT_TRUE(all_off_within(session_.waveform(), said, kLongest_ns)) << log();
}

TEST_F(Safety, AStopFromAnotherProgramTurnsEverythingOffUntilItIsLifted) {
  begin();
  parts_.push_back(session_.tactors());
  parts_.push_back(session_.capture());
  parts_.push_back(session_.coach());
  wait_until_on();
  Process stop = session_.start("stop", session_.on_bus({"stop", "--reason", "test"}));
  ASSERT_TRUE(stop.wait(10s));
  EXPECT_EQ(stop.exit_code(), 0) << stop.output();
  // The program has joined the bus and published by the time it ends; so this is late, not early.
  const std::int64_t stopped = monotonic_ns();
  std::this_thread::sleep_for(2s);
  EXPECT_TRUE(all_off_within(session_.waveform(), stopped, kLongest_ns)) << log();

  Process lift = session_.start("lift", session_.on_bus({"stop", "--lift"}));
  ASSERT_TRUE(lift.wait(10s));
  wait_until_on();
}

TEST_F(Safety, ADeadLinkIsTurnedOffByTheBoardItself) {
  begin();
  parts_.push_back(session_.capture());
  parts_.push_back(session_.coach());
  Process tactors = session_.tactors();
  wait_until_on();
  const std::int64_t silent = monotonic_ns();
  tactors.end(SIGSTOP);  // lives, but says nothing: for the board the same as a cut link
  let_time_pass();
  EXPECT_TRUE(all_off_within(session_.waveform(), silent, kLongestOfALink_ns)) << log();
  tactors.end(SIGCONT);
}

}  // namespace
}  // namespace secondskin::session
