#include "coach/plan/feedback_schedule.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <random>
#include <set>

#include "coach/plan/cue_log.h"

namespace secondskin::coach {
namespace {

using Kind = FeedbackSchedule::Kind;

std::array<double, kJointCount> even_weights() {
  std::array<double, kJointCount> weight;
  weight.fill(1.0);
  return weight;
}

std::vector<Outcome> outcomes(std::size_t count, double in_band) {
  std::vector<Outcome> done(count);
  for (Outcome& outcome : done) outcome.in_band.fill(in_band);
  return done;
}

// Whether each repetition of a block is cued, all of them done equally well.
std::vector<bool> cued(const FeedbackSchedule& schedule, std::uint64_t seed,
                       std::size_t repetitions, double in_band) {
  const auto done = outcomes(repetitions, in_band);
  std::vector<bool> result;
  for (std::size_t n = 0; n < repetitions; ++n) {
    const auto feedback = decide(schedule, seed, std::span(done).first(n), repetitions,
                                 static_cast<std::uint32_t>(n), even_weights());
    result.push_back(feedback.joints.any());
  }
  return result;
}

auto count(const std::vector<bool>& cued) { return std::count(cued.begin(), cued.end(), true); }

TEST(FeedbackSchedule, AlwaysCuesAllAndOffNothing) {
  for (std::uint64_t seed = 0; seed < 50; ++seed) {
    EXPECT_EQ(count(cued({.kind = Kind::kAlways}, seed, 20, 0.5)), 20);
    EXPECT_EQ(count(cued({.kind = Kind::kOff}, seed, 20, 0.5)), 0);
  }
  EXPECT_TRUE(decide({}, 1, {}, 0, 0, even_weights()).joints.all());
  EXPECT_EQ(decide({}, 1, {}, 0, 0, even_weights()).band, 1.0);
}

TEST(FeedbackSchedule, BandwidthWidensTheBandAndCuesEveryJoint) {
  const auto feedback =
      decide({.kind = Kind::kBandwidth, .band = 2.5}, 1, {}, 5, 0, even_weights());
  EXPECT_EQ(feedback.band, 2.5);
  EXPECT_TRUE(feedback.joints.all());
}

TEST(FeedbackSchedule, FadingOverABlockFallsAndIsNeverOffItsNumberByOne) {
  std::mt19937 random(1);
  std::uniform_real_distribution<double> uniform;
  for (int draw = 0; draw < 1000; ++draw) {
    FeedbackSchedule schedule{.kind = Kind::kFading};
    schedule.first = uniform(random);
    schedule.last = schedule.first * uniform(random);
    const std::size_t repetitions = 2 + random() % 40;
    const auto seed = random();
    const auto given = cued(schedule, seed, repetitions, uniform(random));
    double wanted = 0.0, last = 1.0;
    const auto done = outcomes(repetitions, 0.0);
    long so_far = 0;
    for (std::size_t n = 0; n < repetitions; ++n) {
      const double share =
          cued_share(schedule, std::span(done).first(n), repetitions, even_weights());
      EXPECT_LE(share, last + 1e-12);
      last = share;
      wanted += share;
      so_far += given[n] ? 1 : 0;
      EXPECT_LT(std::abs(static_cast<double>(so_far) - wanted), 1.0);
    }
    EXPECT_NEAR(last, schedule.last, 1e-12);
  }
}

TEST(FeedbackSchedule, FadingFromAllToNoneCuesTheFirstHalfMoreThanTheSecond) {
  for (std::uint64_t seed = 0; seed < 200; ++seed) {
    const auto given = cued({.kind = Kind::kFading, .first = 1.0, .last = 0.0}, seed, 20, 0.5);
    EXPECT_TRUE(given.front());
    EXPECT_GE(std::count(given.begin(), given.begin() + 10, true),
              2 + std::count(given.begin() + 10, given.end(), true));
  }
}

TEST(FeedbackSchedule, FadingWithSuccessCuesWhoDoesWellLess) {
  FeedbackSchedule schedule{.kind = Kind::kFading, .first = 1.0, .last = 0.2, .by_success = true};
  long last = 1000;
  for (const double in_band : {0.0, 0.2, 0.4, 0.6, 0.8, 0.9, 1.0}) {
    const long given = count(cued(schedule, 7, 100, in_band));
    EXPECT_LE(given, last);
    last = given;
  }
  EXPECT_EQ(count(cued(schedule, 7, 100, 0.0)), 100);
  EXPECT_NEAR(count(cued(schedule, 7, 100, 0.95)), 20, 2);
}

TEST(FeedbackSchedule, ForgetsHowABlockBeganWhenItFadesWithSuccess) {
  const FeedbackSchedule schedule{.kind = Kind::kFading, .by_success = true};
  auto done = outcomes(10, 1.0);
  EXPECT_DOUBLE_EQ(cued_share(schedule, done, 0, even_weights()), 0.0);
  for (std::size_t n = 0; n < kRecentRepetitions; ++n) done.push_back(outcomes(1, 0.0)[0]);
  EXPECT_DOUBLE_EQ(cued_share(schedule, done, 0, even_weights()), 1.0);
}

TEST(FeedbackSchedule, FadingByJointCuesTheWorseJointMore) {
  const FeedbackSchedule schedule{.kind = Kind::kFadingByJoint, .by_success = true};
  auto done = outcomes(60, 1.0);
  for (Outcome& outcome : done) {
    outcome.in_band[3] = 0.0;
    outcome.in_band[5] = 0.45;
  }
  std::array<int, kJointCount> given{};
  for (std::size_t n = 0; n < done.size(); ++n) {
    const auto feedback = decide(schedule, 3, std::span(done).first(n), 0,
                                 static_cast<std::uint32_t>(n), even_weights());
    for (std::size_t j = 0; j < kJointCount; ++j) given[j] += feedback.joints[j] ? 1 : 0;
  }
  EXPECT_EQ(given[3], 60);
  EXPECT_NEAR(given[5], 30, 2);
  for (std::size_t j = 0; j < kJointCount; ++j) {
    // The first one, before anything is known of them, is for all.
    if (j != 3 && j != 5) {
      EXPECT_LE(given[j], 2) << j;
    }
  }
}

TEST(FeedbackSchedule, TheSameSeedAndHistoryDecideTheSame) {
  const FeedbackSchedule schedule{.kind = Kind::kFading, .first = 0.7, .last = 0.3};
  std::set<std::vector<bool>> different;
  for (std::uint64_t seed = 0; seed < 50; ++seed) {
    EXPECT_EQ(cued(schedule, seed, 20, 0.5), cued(schedule, seed, 20, 0.5));
    different.insert(cued(schedule, seed, 20, 0.5));
  }
  EXPECT_GT(different.size(), 5u) << "the seed changes which repetitions are cued";
}

TEST(FeedbackSchedule, YokedGivesTheCuesOfItsRepetitionWhateverWasDone) {
  FeedbackSchedule schedule{.kind = Kind::kYoked};
  schedule.cues = {{0, 0.1, 0.2, Joint::kLeftElbow, {0.2, 0.0, 0.0}},
                   {1, 0.5, 0.6, Joint::kRightElbow, {0.0, 0.1, 0.0}},
                   {1, 0.7, 0.8, Joint::kLeftElbow, {0.0, 0.1, 0.0}}};
  for (const double in_band : {0.0, 0.5, 1.0}) {
    const auto done = outcomes(1, in_band);
    const auto feedback = decide(schedule, 1, done, 5, 1, even_weights());
    EXPECT_TRUE(feedback.yoked);
    ASSERT_EQ(feedback.cues.size(), 2u);
    EXPECT_EQ(feedback.cues[0].joint, Joint::kRightElbow);
    EXPECT_TRUE(decide(schedule, 1, done, 5, 2, even_weights()).cues.empty());
  }
}

TEST(Shuffled, KeepsTimesAndStrengthsButNeverTheJoint) {
  std::vector<GivenCue> cues;
  for (std::uint32_t i = 0; i < 300; ++i) {
    cues.push_back({i, 0.1, 0.2, i % 2 == 0 ? Joint::kLeftElbow : Joint::kRightElbow,
                    Eigen::Vector3d(0.3, 0.0, 0.0)});
  }
  const std::vector<Joint> among{Joint::kLeftElbow, Joint::kRightElbow, Joint::kLeftShoulder};
  const auto sham = shuffled(cues, among, 5);
  ASSERT_EQ(sham.size(), cues.size());
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();
  for (std::size_t i = 0; i < sham.size(); ++i) {
    EXPECT_EQ(sham[i].repetition, cues[i].repetition);
    EXPECT_EQ(sham[i].from, cues[i].from);
    EXPECT_NE(sham[i].joint, cues[i].joint);
    EXPECT_NE(std::find(among.begin(), among.end(), sham[i].joint), among.end());
    EXPECT_NEAR(sham[i].ask.norm(), 0.3, 1e-12);
    mean += sham[i].ask / 300.0;
  }
  // Standard error of each component: 0.3 / sqrt(3 * 300) = 0.01.
  EXPECT_LT(mean.norm(), 0.05) << "no direction is preferred";
}

TEST(CueLog, JoinsFramesIntoCuesAndBeginsAnewWithEachRepetition) {
  CueLog log;
  CorrectionResult correction;
  auto error = zero_vectors();
  std::array<double, kJointCount> tolerance{};
  const auto j = index(Joint::kLeftElbow);
  correction.target[j] = {0.0, 0.4, 0.0};
  error[j] = {0.0, 0.5, 0.0};
  tolerance[j] = 0.2;
  Cue elbow;
  elbow.joint = Joint::kLeftElbow;
  Cue alarm;
  alarm.joint = Joint::kRightElbow;
  alarm.alarm = true;
  const std::array<Cue, 2> cues{elbow, alarm};
  for (const double share : {0.1, 0.2, 0.3}) log.take(0, share, cues, correction, error, tolerance);
  log.take(0, 0.4, {}, correction, error, tolerance);
  log.take(0, 0.5, cues, correction, error, tolerance);
  log.take(1, 0.1, cues, correction, error, tolerance);
  const auto given = log.cues();
  ASSERT_EQ(given.size(), 3u);
  EXPECT_EQ(given[0].joint, Joint::kLeftElbow);
  EXPECT_DOUBLE_EQ(given[0].from, 0.1);
  EXPECT_DOUBLE_EQ(given[0].to, 0.3);
  EXPECT_TRUE(given[0].ask.isApprox(Eigen::Vector3d(0.0, 0.3, 0.0), 1e-12));
  EXPECT_DOUBLE_EQ(given[1].from, 0.5);
  EXPECT_EQ(given[2].repetition, 1u);
}

}  // namespace
}  // namespace secondskin::coach
