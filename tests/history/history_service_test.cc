#include "clients/history/history_service.h"

#include <gtest/gtest.h>
#include <sys/resource.h>

#include <chrono>
#include <fstream>
#include <optional>
#include <thread>

#include "bus/reader.h"
#include "bus/writer.h"
#include "clients/history/history.h"
#include "course.h"
#include "program.h"
#include "tests/session/process.h"

namespace secondskin::history {
namespace {

namespace msg = bus::msg;
using namespace std::chrono_literals;

template <class Condition>
bool eventually(Condition done, std::chrono::seconds at_most = 20s) {
  const auto end = std::chrono::steady_clock::now() + at_most;
  while (!done()) {
    if (std::chrono::steady_clock::now() > end) return false;
    std::this_thread::sleep_for(10ms);
  }
  return true;
}

// One participant for all tests: a process may make a few only.
bus::Participant& participant() {
  static bus::Participant it([] {
    bus::Config config;
    config.domain = 10 + static_cast<std::uint32_t>(::getpid()) % 90;
    config.subject = "test_" + std::to_string(::getpid());
    config.qos_file = SECONDSKIN_SOURCE_DIR "/idl/qos.xml";
    config.name = "history_service_test";
    return config;
  }());
  return it;
}

/// A coach that says what the tests want it to say, each test in hours of its own.
class Coach {
 public:
  explicit Coach(std::int64_t hour)
      : states_(participant()), repetitions_(participant()), now_(kMorning + hour * kHour) {
    state_.session_start_ns(now_);
    state_.phase(msg::SESSION_RUNNING);
    state_.reference("squat");
    state_.reference_fingerprint(0xfedcba9876543210u);
    state_.learner("L-BUS347");
    state_.plan("two");
    state_.blocks(2);
    state_.max_cues(2);
    state_.tolerance_scale(1.25);
    msg::TactorSite site;
    site.channel(5);
    site.segment("right_forearm");
    state_.tactors().push_back(site);
  }

  void block(std::uint32_t index, const char* name, const char* schedule) {
    state_.block(index);
    state_.block_name(name);
    state_.block_schedule(schedule);
    state_.block_tempo(0.75);
    state_.block_repetitions(0);
    state_.block_start_ns(now_ + kSecond / 50);  // by the clock, after the frame
    number_ = 0;
    say();
  }

  // As the coach does it: the score of the frame that ended it, then what holds from the next on.
  void repetition(double total, bool cued = true) {
    state_.cued_joints(cued ? 0x3fffff : 0);
    say();
    msg::RepetitionScore score;
    score.start_ns(now_ + kSecond);
    now_ += 4 * kSecond;
    score.end_ns(now_);
    score.header().stamp_ns(now_);
    score.repetition(++number_);
    score.total(total);
    score.cues(cued ? 3 : 0);
    msg::JointScore joint;
    joint.joint("left_knee");
    joint.measured(true);
    joint.rms(0.2);
    joint.timing_error(std::numeric_limits<double>::quiet_NaN());
    joint.smoothness(-1.5);
    score.joints().push_back(joint);
    repetitions_.write(score);
    state_.repetitions(state_.repetitions() + 1);
    state_.block_repetitions(number_);
    say();
  }

  void end(double dose) {
    state_.phase(msg::SESSION_ENDED);
    state_.tactors()[0].dose(dose);
    say();
  }

  void say() {
    state_.header().stamp_ns(now_ + 1);
    states_.write(state_);
  }

  bool heard(std::uint32_t by = 1) {
    return states_.wait_for_readers(by, 10s) && repetitions_.wait_for_readers(by, 10s);
  }

 private:
  bus::Writer<msg::SessionState> states_;
  bus::Writer<msg::RepetitionScore> repetitions_;
  msg::SessionState state_;
  std::int64_t now_;
  std::uint32_t number_ = 0;
};

class HistoryServiceTest : public testing::Test {
 protected:
  std::unique_ptr<Program> start(void (*prepare)() = nullptr) {
    return std::make_unique<Program>(
        "history_process",
        std::vector<std::string>{std::to_string(participant().config().domain),
                                 participant().config().subject, file,
                                 participant().config().qos_file.string()},
        folder / "log", prepare);
  }
  std::size_t booked() {
    if (!std::filesystem::exists(file)) return 0;
    std::size_t count = 0;
    for (const Session& session : History(file).sessions("")) count += session.repetitions;
    return count;
  }

  std::size_t sessions() {
    return std::filesystem::exists(file) ? History(file).sessions("").size() : 0;
  }

  void TearDown() override {
    if (HasFailure())
      std::printf("the service said:\n%s", session::read_text(folder / "log").c_str());
  }

  session::Folder folder;
  std::string file = folder / "new/history.db";
};

TEST_F(HistoryServiceTest, BooksASessionWithItsBlocksSchedulesAndExposure) {
  auto service = start();
  Coach coach(0);
  ASSERT_TRUE(coach.heard());
  coach.block(0, "practice", "fading");
  ASSERT_TRUE(eventually([&] { return sessions() == 1; }));
  coach.repetition(51.5);
  ASSERT_TRUE(eventually([&] { return booked() == 1; }));
  coach.repetition(62.5, false);
  ASSERT_TRUE(eventually([&] { return booked() == 2; }));
  coach.block(1, "alone", "off");
  coach.repetition(60, false);
  coach.end(4.5);
  ASSERT_TRUE(eventually([&] { return booked() == 3; }));
  ASSERT_TRUE(eventually([&] { return History(file).session(1)->end_ns.has_value(); }));
  const Session session = History(file).session(1).value();
  EXPECT_EQ(session.learner, "L-BUS347");
  EXPECT_EQ(session.start_ns, kMorning);
  EXPECT_EQ(session.plan, "two");
  EXPECT_EQ(session.reference.fingerprint, 0xfedcba9876543210u);
  ASSERT_EQ(session.blocks.size(), 2u);
  EXPECT_EQ(session.blocks[0].schedule, "fading");
  EXPECT_DOUBLE_EQ(session.blocks[0].tempo.value(), 0.75);
  EXPECT_DOUBLE_EQ(session.blocks[0].tolerance_scale, 1.25);
  ASSERT_EQ(session.blocks[0].repetitions.size(), 2u);
  EXPECT_EQ(session.blocks[0].repetitions[0].cued, true);
  EXPECT_EQ(session.blocks[0].repetitions[1].cued, false);
  EXPECT_DOUBLE_EQ(session.blocks[0].repetitions[1].total, 62.5);
  ASSERT_EQ(session.blocks[1].repetitions.size(), 1u);
  const auto& joint = session.blocks[1].repetitions[0].joints.at(0);
  EXPECT_DOUBLE_EQ(joint.rms, 0.2);
  EXPECT_FALSE(joint.timing_error);
  EXPECT_DOUBLE_EQ(joint.smoothness.value(), -1.5);
  ASSERT_EQ(session.exposure.size(), 1u);
  EXPECT_DOUBLE_EQ(session.exposure[0].dose_before, 0.0);
  EXPECT_DOUBLE_EQ(session.exposure[0].dose, 4.5);
}

TEST_F(HistoryServiceTest, JoiningLateItBooksWhatTheCoachStillOffers) {
  Coach coach(5);
  coach.block(0, "practice", "always");
  coach.repetition(41);
  coach.repetition(42);
  coach.block(1, "alone", "off");
  coach.repetition(43);
  auto service = start();
  ASSERT_TRUE(eventually([&] { return booked() == 3; })) << booked();
  const auto blocks = History(file).session(1)->blocks;
  ASSERT_EQ(blocks.size(), 2u);
  EXPECT_EQ(blocks[0].repetitions.size(), 2u);
  EXPECT_FALSE(blocks[0].tempo) << "nobody heard it begin";
  EXPECT_EQ(blocks[1].name, "alone");
}

TEST_F(HistoryServiceTest, KilledInASessionItLosesNothingAndGoesOnWithTheSameOne) {
  Coach coach(10);
  {
    auto service = start();
    ASSERT_TRUE(coach.heard());
    coach.block(0, "practice", "always");
    for (int i = 0; i < 4; ++i) coach.repetition(40 + i);
    ASSERT_TRUE(eventually([&] { return booked() == 4; }));
    service->end(SIGKILL);
  }
  // While it is dead one block ends, one passes and a third begins.
  coach.repetition(44);
  coach.block(1, "alone", "off");
  for (int i = 0; i < 2; ++i) coach.repetition(50 + i, false);
  coach.block(2, "again", "always");
  coach.repetition(60);
  auto service = start();
  ASSERT_TRUE(eventually([&] { return booked() == 8; })) << booked();
  coach.repetition(61);
  coach.end(1);
  ASSERT_TRUE(eventually([&] { return booked() == 9; })) << booked();
  ASSERT_EQ(History(file).sessions("").size(), 1u) << "the same session";
  const auto blocks = History(file).session(1)->blocks;
  ASSERT_EQ(blocks.size(), 3u);
  const std::vector<std::vector<double>> expected{{40, 41, 42, 43, 44}, {50, 51}, {60, 61}};
  for (std::size_t b = 0; b < 3; ++b) {
    std::vector<double> totals;
    for (const auto& repetition : blocks[b].repetitions) totals.push_back(repetition.total);
    EXPECT_EQ(totals, expected[b]) << b;
  }
  EXPECT_FALSE(blocks[1].tempo) << "nobody heard it begin";
  EXPECT_EQ(blocks[2].name, "again");
}

TEST_F(HistoryServiceTest, WhatTheDiskRefusesIsSaidAndWrittenLater) {
  bus::Reader<msg::ServiceHealth> health(participant(), bus::Want::kEvery);
  std::ofstream(folder / "new") << "a file where the folder should be";
  auto service = start();
  Coach coach(20);
  ASSERT_TRUE(coach.heard());
  coach.block(0, "practice", "always");
  coach.repetition(40);
  coach.repetition(41);
  const auto says = [&](msg::ServiceState state, const std::string& words) {
    msg::ServiceHealth heard;
    while (health.take(heard)) {
      if (heard.service().to_string() == "history" && heard.state() == state &&
          heard.message().to_string().find(words) != std::string::npos)
        return true;
    }
    return false;
  };
  EXPECT_TRUE(eventually([&] { return says(msg::SERVICE_FAULT, "history.db"); }));
  std::filesystem::remove(folder / "new");
  EXPECT_TRUE(eventually([&] { return booked() == 2; })) << booked();
  EXPECT_TRUE(eventually([&] { return says(msg::SERVICE_RUNNING, ""); }));
}

TEST_F(HistoryServiceTest, AFullDiskDoesNotEndItAndWhatWasBookedStaysWhole) {
  bus::Reader<msg::ServiceHealth> health(participant(), bus::Want::kEvery);
  auto service = start([] {
    const rlimit most{200'000, 200'000};  // no file may grow beyond
    ::setrlimit(RLIMIT_FSIZE, &most);
  });
  Coach coach(30);
  ASSERT_TRUE(coach.heard());
  coach.block(0, "practice", "always");
  bool full = false;
  for (int i = 0; i < 200 && !full; ++i) {
    coach.repetition(40);
    std::this_thread::sleep_for(20ms);
    msg::ServiceHealth heard;
    while (health.take(heard)) {
      full |= heard.service().to_string() == "history" && heard.state() == msg::SERVICE_FAULT &&
              heard.message().to_string().find("entries wait") != std::string::npos;
    }
  }
  EXPECT_TRUE(full) << "it should have said that the disk is full";
  EXPECT_GT(booked(), 0u);
  const std::size_t before = booked();
  service->end(SIGKILL);
  // With room again, all that the coach still offers comes in, each once.
  auto again = start();
  EXPECT_TRUE(eventually([&] { return booked() > before; }));
}

TEST_F(HistoryServiceTest, ASessionOfADeletedLearnerIsNotKeptOn) {
  auto service = start();
  Coach coach(40);
  ASSERT_TRUE(coach.heard());
  coach.block(0, "practice", "always");
  coach.repetition(40);
  ASSERT_TRUE(eventually([&] { return booked() == 1; }));
  ASSERT_TRUE(History(file).forget("L-BUS347"));
  coach.repetition(41);
  coach.block(1, "more", "always");
  coach.repetition(42);
  service->end(SIGTERM);
  EXPECT_EQ(booked(), 0u);
  EXPECT_TRUE(History(file).learners().empty());
}

TEST_F(HistoryServiceTest, ARealSessionIsBookedAsItsCoachScoredIt) {
  auto service = start();
  const std::string plan = folder / "two.toml";
  std::ofstream(plan) << "name = \"two\"\n"
                         "[[block]]\nname = \"slow\"\nrepetitions = 1\ntempo = 0.8\n"
                         "tolerance_scale = 0.3\nmax_cues = 1\nrest_s = 0.5\n"
                         "schedule = { kind = \"fading\", with = \"success\" }\n"
                         "[[block]]\nname = \"alone\"\nrepetitions = 1\ntolerance_scale = 0.3\n"
                         "schedule = { kind = \"off\" }\n";
  session::Process train(
      {"train", "--reference", "low_block", "--plan", plan, "--recording", folder / "r.mcap",
       "--loop", "--domain", std::to_string(participant().config().domain), "--subject",
       participant().config().subject},
      folder / "train.log");
  ASSERT_TRUE(train.wait(90s)) << train.output();
  ASSERT_TRUE(eventually([&] { return booked() == 2; })) << train.output();
  const Session session = History(file).session(1).value();
  EXPECT_EQ(session.learner, kUnassigned) << "nobody said who learns";
  EXPECT_EQ(session.plan, "two");
  EXPECT_EQ(session.reference.name, "low_block");
  EXPECT_GT(session.reference.duration, 3.0) << "as topic references says";
  EXPECT_NE(session.source.find("learner.bvh"), std::string::npos);
  ASSERT_EQ(session.blocks.size(), 2u);
  EXPECT_EQ(session.blocks[0].schedule, "fading");
  EXPECT_EQ(session.blocks[1].schedule, "off");
  EXPECT_DOUBLE_EQ(session.blocks[0].tempo.value(), 0.8);
  for (const Block& block : session.blocks) {
    ASSERT_EQ(block.repetitions.size(), 1u);
    const Repetition& repetition = block.repetitions[0];
    char said[80];
    std::snprintf(said, sizeof said,
                  "block '%s' (tempo %g): 1 repetitions, mean score %.1f, %u cues",
                  block.name.c_str(), *block.tempo, repetition.total, repetition.cues);
    EXPECT_TRUE(train.says(said)) << said << "\n" << train.output();
    EXPECT_EQ(repetition.cued, block.schedule != kNoCues);
    EXPECT_EQ(repetition.joints.size(), 22u);
  }
  double dose = 0.0;
  for (const SiteExposure& site : session.exposure) dose += site.dose - site.dose_before;
  EXPECT_GT(dose, 0.0) << "it was cued";
  EXPECT_TRUE(session.end_ns);
}

}  // namespace
}  // namespace secondskin::history
