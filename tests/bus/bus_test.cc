#include <gtest/gtest.h>

#include <fstream>

#include "bus/pose_messages.h"
#include "bus/raw.h"
#include "bus/reader.h"
#include "bus/stop_state.h"
#include "bus/wait_set.h"
#include "bus/writer.h"
#include "motion/anatomy.h"
#include "test_domain.h"

namespace secondskin::bus {
namespace {

using namespace std::chrono_literals;

msg::SkeletonPose pose_message(std::uint64_t frame) {
  StampedPose pose{.frame = frame, .stamp_ns = now_ns(), .pose = Pose(kJointCount)};
  pose.pose.p_WR.x() = static_cast<double>(frame);
  msg::SkeletonPose message;
  to_message(pose, 1, message);
  return message;
}

TEST(Bus, CarriesAPoseFromOneParticipantToAnother) {
  Participant here(test_config()), there(test_config());
  Writer<msg::SkeletonPose> writer(here);
  Reader<msg::SkeletonPose> reader(there);
  WaitSet news;
  news.attach(reader);
  ASSERT_TRUE(eventually([&] { return writer.counts().readers == 1; }));
  ASSERT_TRUE(eventually([&] { return reader.counts().writers == 1; }));

  ASSERT_TRUE(writer.write(pose_message(5)));
  msg::SkeletonPose got;
  ASSERT_TRUE(eventually([&] { return news.wait(1s) && reader.take(got); }));
  EXPECT_EQ(got.header().frame(), 5u);
  EXPECT_EQ(got.root_position().x(), 5.0);
  EXPECT_EQ(reader.counts().taken, 1u);
  EXPECT_EQ(writer.counts().written, 1u);
}

TEST(Bus, ALiveReaderGetsTheNewestAndARecorderEveryMessage) {
  Participant here(test_config()), there(test_config());
  Writer<msg::SkeletonPose> writer(here);
  Reader<msg::SkeletonPose> live(there);
  Reader<msg::SkeletonPose> recorder(there, Want::kEvery);
  ASSERT_TRUE(eventually([&] { return writer.counts().readers == 2; }));
  ASSERT_TRUE(eventually([&] { return live.counts().writers + recorder.counts().writers == 2; }));

  constexpr std::uint64_t kMessages = 50;
  for (std::uint64_t i = 1; i <= kMessages; ++i) ASSERT_TRUE(writer.write(pose_message(i)));
  std::vector<std::uint64_t> frames;
  msg::SkeletonPose got;
  ASSERT_TRUE(eventually([&] {
    while (recorder.take(got)) frames.push_back(got.header().frame());
    return frames.size() == kMessages;
  }));
  for (std::uint64_t i = 0; i < kMessages; ++i) EXPECT_EQ(frames[i], i + 1);
  ASSERT_EQ(live.take_newest(got), 1u);  // depth 1
  EXPECT_EQ(got.header().frame(), kMessages);
}

TEST(Bus, ALateReaderGetsTheSkeletonAndTheStopButNoOldPose) {
  Participant here(test_config());
  Writer<msg::EmergencyStop> stop(here);
  Writer<msg::SkeletonPose> pose(here);
  msg::EmergencyStop message;
  message.active(true);
  message.reason("test");
  ASSERT_TRUE(stop.write(message));
  ASSERT_TRUE(pose.write(pose_message(1)));

  Participant there(test_config());
  Reader<msg::SkeletonPose> poses(there, Want::kEvery);
  Reader<msg::EmergencyStop> stops(there);
  msg::EmergencyStop got;
  ASSERT_TRUE(eventually([&] { return stops.take(got); }));
  EXPECT_TRUE(got.active());
  EXPECT_EQ(got.reason().to_string(), "test");
  ASSERT_TRUE(eventually([&] { return poses.counts().writers == 1; }));
  msg::SkeletonPose old;
  EXPECT_FALSE(poses.take(old));
}

TEST(Bus, ATactorCommandThatIsOlderThanItsLifespanIsNeverRead) {
  Participant here(test_config()), there(test_config());
  Writer<msg::TactorCommand> writer(here);
  Reader<msg::TactorCommand> reader(there);
  ASSERT_TRUE(eventually([&] { return writer.counts().readers == 1; }));
  ASSERT_TRUE(eventually([&] { return reader.counts().writers == 1; }));
  ASSERT_TRUE(writer.write(msg::TactorCommand{}));
  std::this_thread::sleep_for(200ms);  // the lifespan of qos.xml is 60 ms
  msg::TactorCommand got;
  EXPECT_FALSE(reader.take(got));
}

TEST(Bus, TellsOfAWriterThatWentAway) {
  Participant there(test_config());
  Reader<msg::TactorCommand> reader(there);
  WaitSet news;
  news.attach(reader);
  {
    Participant here(test_config());
    Writer<msg::TactorCommand> writer(here);
    ASSERT_TRUE(eventually([&] { return reader.counts().alive_writers == 1; }));
  }
  ASSERT_TRUE(eventually([&] { return reader.counts().writers == 0; }));
  EXPECT_EQ(reader.counts().alive_writers, 0u);
  EXPECT_TRUE(news.wait(0ns));  // it was woken
}

TEST(Bus, ForwardsMessagesAsTheyAre) {
  Participant here(test_config()), there(test_config());
  Writer<msg::SkeletonPose> writer(here);
  RawReader reader(there, kTopicOf<msg::SkeletonPose>);
  ASSERT_TRUE(eventually([&] { return writer.counts().readers == 1; }));
  ASSERT_TRUE(eventually([&] { return reader.counts().writers == 1; }));
  const auto sent = pose_message(9);
  ASSERT_TRUE(writer.write(sent));
  RawMessage raw;
  ASSERT_TRUE(eventually([&] { return reader.take(raw); }));
  EXPECT_EQ(raw.bytes, encode(sent));
  EXPECT_NEAR(static_cast<double>(now_ns() - raw.source_ns), 0.0, 5e9);
}

TEST(Bus, WritesRecordedBytesSoThatTypedReadersUnderstandThem) {
  Participant here(test_config()), there(test_config());
  RawWriter writer(here, kTopicOf<msg::SkeletonPose>);
  Reader<msg::SkeletonPose> reader(there);
  ASSERT_TRUE(eventually([&] { return reader.counts().writers == 1; }));
  const RawMessage recorded{.bytes = encode(pose_message(11))};
  msg::SkeletonPose got;
  ASSERT_TRUE(eventually([&] { return writer.write(recorded) && reader.take(got); }));
  EXPECT_EQ(got.header().frame(), 11u);
  EXPECT_FALSE(writer.write(RawMessage{}));
}

TEST(Bus, SubjectsDoNotHearEachOther) {
  auto other = test_config();
  other.subject += "_b";
  Participant here(test_config()), there(other);
  Writer<msg::SkeletonPose> writer(here);
  Reader<msg::SkeletonPose> reader(there);
  Reader<msg::SkeletonPose> same(here);
  ASSERT_TRUE(eventually([&] { return same.counts().writers == 1; }));
  EXPECT_FALSE(eventually([&] { return reader.counts().writers > 0; }, 500ms));
}

msg::EmergencyStop stop_message(bool active, std::int64_t publish_ns) {
  msg::EmergencyStop message;
  message.active(active);
  message.publish_ns(publish_ns);
  return message;
}

TEST(StopState, OutlivesWhoAskedForItAndTheRestartOfAListener) {
  Participant coach_place(test_config()), driver_place(test_config());
  StopState coach(coach_place);
  auto driver = std::make_unique<StopState>(driver_place);
  {
    Participant there(test_config());
    Writer<msg::EmergencyStop> writer(there);
    writer.write(stop_message(true, 1000));
    ASSERT_TRUE(eventually([&] { return (coach.poll(), coach.active()); }));
    ASSERT_TRUE(eventually([&] { return (driver->poll(), driver->active()); }));
  }
  driver = std::make_unique<StopState>(driver_place);  // it has forgotten
  EXPECT_TRUE(eventually([&] { return (driver->poll(), driver->active()); }));
}

TEST(StopState, ListenersThatRepeatEachOtherFallSilent) {
  Participant first_place(test_config()), second_place(test_config()), there(test_config());
  StopState first(first_place), second(second_place);
  Reader<msg::EmergencyStop> witness(there, Want::kEvery);
  Writer<msg::EmergencyStop> writer(there);
  ASSERT_TRUE(writer.wait_for_readers(3, 10s));
  ASSERT_TRUE(eventually([&] { return witness.counts().writers == 3; }));
  writer.write(stop_message(true, 0));  // without a time: each listener notes its own
  std::size_t words = 0;
  msg::EmergencyStop message;
  const auto end = std::chrono::steady_clock::now() + 500ms;
  while (std::chrono::steady_clock::now() < end) {
    first.poll();
    second.poll();
    words += witness.take_newest(message);
  }
  EXPECT_TRUE(first.active());
  EXPECT_TRUE(second.active());
  EXPECT_LE(words, 5u);  // the first word, one repeat each, and at most one to agree
}

TEST(StopState, ObeysAStopOfAnyClockButALiftOnlyWhenItIsNewer) {
  Participant here(test_config()), there(test_config());
  StopState listener(here);
  Writer<msg::EmergencyStop> writer(there);
  const auto say = [&](bool active, std::int64_t publish_ns) {
    writer.write(stop_message(active, publish_ns));
    const auto end = std::chrono::steady_clock::now() + 150ms;
    eventually([&] { return (listener.poll(), std::chrono::steady_clock::now() > end); });
    return listener.active();
  };
  ASSERT_TRUE(writer.wait_for_readers(1, 10s));
  EXPECT_TRUE(say(true, 2000));
  EXPECT_TRUE(say(false, 1999)) << "a lift from before the stop";
  EXPECT_FALSE(say(false, 2001));
  EXPECT_FALSE(say(true, 2000)) << "the stop that was lifted, repeated by somebody late";
  EXPECT_TRUE(say(true, 1500)) << "a new stop of a clock that is behind";
  EXPECT_FALSE(say(false, now_ns()));
  EXPECT_TRUE(say(true, 0)) << "a stop of a sender that does not say when";
}

TEST(Bus, AWaitEndsWhenItIsWoken) {
  WaitSet news;
  std::thread other([&] {
    std::this_thread::sleep_for(20ms);
    news.wake();
  });
  EXPECT_TRUE(news.wait(10s));
  other.join();
  EXPECT_FALSE(news.wait(1ms));
}

TEST(Bus, RefusesRawAndTypedReadersOfOneTopicInOneParticipant) {
  Participant here(test_config());
  Reader<msg::SkeletonPose> typed(here);
  EXPECT_THROW(RawReader(here, kTopicOf<msg::SkeletonPose>), std::runtime_error);
}

TEST(Configuration, NamesWhatIsWrong) {
  const auto refused = [](Config config, const std::string& word) {
    try {
      Participant participant(config);
      return testing::AssertionFailure() << "taken";
    } catch (const std::runtime_error& error) {
      const std::string what = error.what();
      return what.find(word) != std::string::npos
                 ? testing::AssertionSuccess()
                 : testing::AssertionFailure() << what << " does not name " << word;
    }
  };
  auto config = test_config();
  config.subject = "anna/pose";
  EXPECT_TRUE(refused(config, "anna/pose"));
  config = test_config();
  config.domain = 233;
  EXPECT_TRUE(refused(config, "233"));
  config = test_config();
  config.qos_file = "/nonexistent/qos.xml";
  EXPECT_TRUE(refused(config, "/nonexistent/qos.xml"));
  const auto torn =
      std::filesystem::temp_directory_path() / ("torn_" + std::to_string(::getpid()) + ".xml");
  std::ofstream(torn) << "<dds><profiles><data_writer";
  config.qos_file = torn;
  EXPECT_TRUE(refused(config, torn.string()));
  std::filesystem::remove(torn);
}

TEST(Bytes, OfAMessageAreReadBackAndTornOnesRefused) {
  const auto bytes = encode(pose_message(77));
  EXPECT_EQ(bytes[0], 0);  // CDR, little-endian (RTPS 2.2, 10.2.1.2)
  EXPECT_EQ(bytes[1], 1);
  msg::SkeletonPose got;
  ASSERT_TRUE(decode(bytes, got));
  EXPECT_EQ(got.header().frame(), 77u);
  for (std::size_t n = 0; n < bytes.size(); ++n) {
    EXPECT_FALSE(decode(std::span(bytes.data(), n), got)) << n;
  }
}

}  // namespace
}  // namespace secondskin::bus
