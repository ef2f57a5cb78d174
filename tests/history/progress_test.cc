#include "clients/history/progress.h"

#include <gtest/gtest.h>

#include <cmath>

#include "course.h"

namespace secondskin::history {
namespace {

using Kind = Retention::Kind;

// Five sessions over twelve days; the figures below were worked out by hand.
std::vector<Session> five_sessions() {
  std::vector<Session> all;
  const std::int64_t d0 = kMorning, noon = kMorning + 5 * kHour, d3 = kMorning + 3 * kDay,
                     d10 = kMorning + 10 * kDay, d12 = kMorning + 12 * kDay;
  all.push_back(session_of(
      1, d0,
      {block_of(0, "always", d0, {40, 50, 60}), block_of(1, "off", d0 + 300 * kSecond, {44, 48})}));
  all.push_back(session_of(
      2, noon,
      {block_of(0, "fading", noon, {60, 70}), block_of(1, "off", noon + 100 * kSecond, {61, 63})}));
  all.push_back(session_of(
      3, d3,
      {block_of(0, "off", d3, {58}), block_of(1, "always", d3 + 100 * kSecond, {90, 90}, 0.5),
       block_of(2, "bandwidth", d3 + 200 * kSecond, {70, 74, 78}),
       block_of(3, "off", d3 + 300 * kSecond, {75})}));
  all.push_back(session_of(4, d10, {block_of(0, "off", d10, {30})}));
  all.back().reference.fingerprint = 8;  // somebody changed the reference
  all.push_back(
      session_of(5, d12,
                 {block_of(0, "always", d12, {80}), block_of(1, "off", d12 + 100 * kSecond, {79}),
                  block_of(2, "off", d12 + 200 * kSecond, {})}));
  all[1].blocks[0].repetitions[1].cued = false;
  all[4].blocks.push_back(block_of(3, "", d12 + 300 * kSecond, {50}));
  all[4].blocks.back().tempo.reset();  // nobody heard it begin
  Session other = session_of(6, d12 + kHour, {block_of(0, "always", d12 + kHour, {10})});
  other.reference.name = "kick";
  all.push_back(other);
  return all;
}

TEST(Progress, ABlockIsAPointWithMeanDeviationAndJoints) {
  auto course = five_sessions();
  auto& repetitions = course[0].blocks[0].repetitions;
  repetitions[0].joints[0].rms = 0.1;
  repetitions[1].joints[0].rms = 0.2;
  repetitions[2].joints[0].measured = false;
  const auto points = progress(course, "squat").points;
  ASSERT_EQ(points.size(), 11u) << "two blocks say nothing, and the kick is another reference";
  EXPECT_DOUBLE_EQ(points[0].mean_total, 50.0);
  EXPECT_DOUBLE_EQ(points[0].sd_total.value(), 10.0);
  EXPECT_NEAR(points[1].sd_total.value(), std::sqrt(8.0), 1e-12);
  EXPECT_FALSE(points[4].sd_total) << "one repetition has none";
  EXPECT_NEAR(points[0].joints.at("left_knee"), 0.158113883, 1e-9);
  EXPECT_FALSE(points[0].joints.contains("right_hip")) << "never measured";
  EXPECT_DOUBLE_EQ(points[2].cued.value(), 0.5);
  EXPECT_EQ(points[0].start_ns, kMorning + kSecond);
  EXPECT_EQ(points[0].end_ns, kMorning + 15 * kSecond);
}

TEST(Progress, RetentionIsAgainstTheCuedBlockBeforeAndAgainstAnEarlierDay) {
  const auto retention = progress(five_sessions(), "squat").retention;
  struct Expected {
    Kind kind;
    std::int64_t session, block, against_session, against_block;
    double change;
  };
  const Expected expected[] = {{Kind::kAfterCues, 1, 1, 1, 0, -4.0},
                               {Kind::kAfterCues, 2, 1, 2, 0, -3.0},
                               {Kind::kAcrossDays, 3, 0, 2, 1, -4.0},
                               {Kind::kAfterCues, 3, 3, 3, 2, 1.0},
                               {Kind::kAfterCues, 5, 1, 5, 0, -1.0}};
  ASSERT_EQ(retention.size(), std::size(expected));
  for (std::size_t i = 0; i < retention.size(); ++i) {
    EXPECT_EQ(retention[i].kind, expected[i].kind) << i;
    EXPECT_EQ(retention[i].retention.session, expected[i].session) << i;
    EXPECT_EQ(retention[i].retention.block, expected[i].block) << i;
    EXPECT_EQ(retention[i].practice.session, expected[i].against_session) << i;
    EXPECT_EQ(retention[i].practice.block, expected[i].against_block) << i;
    EXPECT_NEAR(retention[i].change(), expected[i].change, 1e-12) << i;
  }
  // Ends at 15 s of the block; the next begins at 300 s, its first repetition at 301 s.
  EXPECT_DOUBLE_EQ(retention[0].pause, 286.0);
  EXPECT_DOUBLE_EQ(retention[2].pause, 3 * 86400.0 - 5 * 3600.0 - 109.0);
}

TEST(Progress, ADayThatEndedWithCuesIsComparedWithThem) {
  const std::int64_t next = kMorning + kDay;
  const std::vector course{session_of(1, kMorning,
                                      {block_of(0, "off", kMorning, {40}),
                                       block_of(1, "always", kMorning + 100 * kSecond, {60})}),
                           session_of(2, next, {block_of(0, "off", next, {50})})};
  const auto retention = progress(course, "squat").retention;
  ASSERT_EQ(retention.size(), 1u);
  EXPECT_EQ(retention[0].kind, Kind::kAcrossDays);
  EXPECT_DOUBLE_EQ(retention[0].change(), -10.0);
}

TEST(Progress, OtherTolerancesAreAnotherTask) {
  auto course = five_sessions();
  for (Block& block : course[2].blocks) block.tolerance_scale = 1.5;
  for (const Retention& entry : progress(course, "squat").retention) {
    EXPECT_FALSE(entry.kind == Kind::kAcrossDays) << "session 3 is alone with its tolerances";
  }
}

TEST(Progress, SchedulesAreComparedByTheirFirstAndLastBlockAndByWhatStays) {
  const auto schedules = progress(five_sessions(), "squat").schedules;
  ASSERT_EQ(schedules.size(), 4u);
  const auto expect = [&](std::size_t i, const char* name, std::size_t sessions, double first,
                          double last, std::optional<double> retention) {
    EXPECT_EQ(schedules[i].schedule, name);
    EXPECT_EQ(schedules[i].sessions, sessions) << name;
    EXPECT_NEAR(schedules[i].first, first, 1e-12) << name;
    EXPECT_NEAR(schedules[i].last, last, 1e-12) << name;
    ASSERT_EQ(schedules[i].retention.has_value(), retention.has_value()) << name;
    EXPECT_NEAR(schedules[i].retention.value_or(0), retention.value_or(0), 1e-12) << name;
  };
  expect(0, "always", 3, 50.0, 80.0, -2.5);
  expect(1, "off", 5, 46.0, 79.0, std::nullopt);
  expect(2, "fading", 1, 65.0, 65.0, -3.0);
  expect(3, "bandwidth", 1, 74.0, 74.0, 1.0);
}

TEST(Progress, OfAReferenceNobodyPractisedIsEmpty) {
  const auto none = progress(five_sessions(), "punch");
  EXPECT_TRUE(none.points.empty());
  EXPECT_TRUE(none.retention.empty());
  EXPECT_TRUE(none.schedules.empty());
  EXPECT_EQ(practised_references(five_sessions()), (std::vector<std::string>{"kick", "squat"}));
}

}  // namespace
}  // namespace secondskin::history
