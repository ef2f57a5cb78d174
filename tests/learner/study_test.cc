#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>
#include <random>

#include "clients/study/experiment.h"
#include "clients/study/processes.h"
#include "clients/study/statistics.h"
#include "coach/correct/simulated_source.h"
#include "tests/coach_align/trials.h"

// People in the study's groups, through the whole chain; and its arithmetic.

namespace secondskin::study {
namespace {

using coach::kDegree;

// Few repetitions of people who see nothing, so that whatever changes comes through the skin.
Protocol blind() {
  Protocol protocol;
  protocol.map = coach::BodyMap::load(SECONDSKIN_SOURCE_DIR "/body_maps/right_arm.toml");
  protocol.reference = of_worn_joints(*coach::shipped("shoulder_abduction"), protocol.map);
  protocol.before = 1;
  protocol.practice = 5;
  protocol.retention = 1;
  protocol.learner.glance = 1e9;
  protocol.settings.tolerance_scale = 0.25;  // so that everybody has something to be told
  return protocol;
}

double mean(const std::vector<double>& error, std::size_t begin, std::size_t end) {
  double sum = 0.0;
  for (std::size_t n = begin; n < end; ++n) sum += error[n];
  return sum / static_cast<double>(end - begin);
}

TEST(Experiment, WithTrueCuesThatAreAlwaysReadTheErrorFalls) {
  Protocol protocol = blind();
  auto& p = protocol.learner;
  p.noise = p.tremor = p.missed = p.misread = p.misread_with_each = p.weber = 0.0;
  for (const std::uint64_t seed : {1u, 2u, 3u}) {
    const Person cued = run_person(protocol, Group::kTactile, seed);
    const Person seeing = run_person(protocol, Group::kVisual, seed);
    ASSERT_EQ(cued.error.size(), protocol.repetitions());
    EXPECT_EQ(cued.error[0], seeing.error[0]) << "the same person before any cue";
    EXPECT_GT(cued.cues, 5u);
    EXPECT_GT(cued.reactions, 5u);
    EXPECT_LT(mean(cued.error, 1, 6), mean(seeing.error, 1, 6));
    EXPECT_EQ(seeing.reactions, 0u);
    EXPECT_NEAR(mean(seeing.error, 1, 6), seeing.error[0], 1.0 * kDegree);
    EXPECT_GE(cued.counted, protocol.repetitions() - 2) << "the coach counts what was done";
  }
}

// Root mean square of the error of each movement of the joints that matter, while the coach sees
// the learner move [deg].
double error_of_movements(const std::string& reference_name, const Motion& learner) {
  const auto reference = coach::shipped(reference_name);
  coach::NoSource none;
  coach::Coach coach(reference, blind().map, {}, none);
  coach::CoachOutput out;
  double square = 0.0;
  std::size_t count = 0;
  std::uint64_t frame = 0;
  for (const Pose& pose : learner.poses) {
    ++frame;
    coach.step({frame, coach::stamp(static_cast<double>(frame) / learner.rate_hz), pose}, out);
    if (out.alignment.phase != coach::Phase::kMoving) continue;
    for (std::size_t j = 0; j < kJointCount; ++j) {
      const JointAnatomy& anatomy = canonical_anatomy()[j];
      for (std::size_t m = 0; m < 3; ++m) {
        if (reference->weight[j] < 0.3 || anatomy.range[m].max <= anatomy.range[m].min) continue;
        square += std::pow(out.error[j].dot(anatomy.axis[m]), 2.0);
        ++count;
      }
    }
  }
  return std::sqrt(square / static_cast<double>(count)) / kDegree;
}

TEST(Experiment, PeopleErrAsMuchAsTheRealLearnersThatComeWithTheReferences) {
  double least = 1e9, most = 0.0;
  for (const char* name : {"deep_squat", "sit_to_stand", "shoulder_abduction", "low_block",
                           "knife_hand_block", "stepping_punch"}) {
    const double error = error_of_movements(name, coach::shipped_learner(name));
    std::printf("%s: %.1f deg\n", name, error);
    least = std::min(least, error);
    most = std::max(most, error);
  }
  const auto reference = coach::shipped("shoulder_abduction");
  double sum = 0.0;
  constexpr int kPeople = 6;
  for (std::uint64_t seed = 1; seed <= kPeople; ++seed) {
    sim::Lesson lesson;
    lesson.reference = &reference->motion;
    lesson.weight = reference->weight;
    sim::VirtualLearner person(lesson, {}, seed);
    person.see(false);
    Motion motion{reference->motion.skeleton, 60.0, {}};
    for (int i = 0; i < 600; ++i) motion.poses.push_back(person.move(i / 60.0));
    sum += error_of_movements("shoulder_abduction", motion);
  }
  std::printf("virtual learners: %.1f deg\n", sum / kPeople);
  EXPECT_GT(sum / kPeople, least);
  EXPECT_LT(sum / kPeople, most);
}

TEST(Experiment, IsTheSameEveryTime) {
  const Protocol protocol = blind();
  const Person one = run_person(protocol, Group::kTactile, 5);
  const Person again = run_person(protocol, Group::kTactile, 5);
  EXPECT_EQ(one.error, again.error);
  EXPECT_EQ(one.cues, again.cues);
}

TEST(Experiment, ShamCuesAtOtherJointsDoNotHelp) {
  const Protocol protocol = blind();
  const std::vector<Joint> among = served(protocol);
  double sham_sum = 0.0, blind_sum = 0.0, cued_sum = 0.0;
  for (std::uint64_t seed = 1; seed <= 6; ++seed) {
    const Person cued = run_person(protocol, Group::kTactile, seed);
    const Person sham =
        run_person(protocol, Group::kSham, seed, coach::shuffled(cued.given, among, seed));
    EXPECT_GT(sham.reactions, 5u) << "it is felt and followed";
    sham_sum += mean(sham.error, 1, 6);
    cued_sum += mean(cued.error, 1, 6);
    blind_sum += mean(run_person(protocol, Group::kVisual, seed).error, 1, 6);
  }
  EXPECT_GT(sham_sum, 0.98 * blind_sum);
  EXPECT_GT(sham_sum, cued_sum);
}

TEST(Statistics, LearningRateIsTheSlopeOfALogarithm) {
  Curve curve;
  for (int n = 0; n < 12; ++n) curve.push_back(0.3 * std::exp(-0.07 * n));
  const std::vector<const Curve*> people{&curve};
  EXPECT_NEAR(learning_rate(people, {2, 12}), 0.07, 1e-9);
  EXPECT_NEAR(mean_error(people, {0, 1}), 0.3, 1e-12);
}

TEST(Statistics, TheBootstrapCoversTheTruthAsOftenAsItSays) {
  std::mt19937_64 random(1);
  std::normal_distribution<double> normal(1.0, 0.3);
  const Comparison difference = [](auto a, auto b) {
    return mean_error(a, {0, 1}) - mean_error(b, {0, 1});
  };
  int covered = 0;
  constexpr int kTrials = 300;
  for (int trial = 0; trial < kTrials; ++trial) {
    std::vector<Curve> a, b;
    for (int i = 0; i < 30; ++i) {
      a.push_back({normal(random)});
      b.push_back({normal(random)});
    }
    const Interval interval = bootstrap(a, b, difference, 3, 400);
    EXPECT_LE(interval.low, interval.high);
    covered += interval.low <= 0.0 && 0.0 <= interval.high ? 1 : 0;
  }
  EXPECT_NEAR(static_cast<double>(covered) / kTrials, 0.94, 0.04);
}

TEST(Processes, GiveEachTaskItsResultAndPassErrorsOn) {
  std::size_t last = 0;
  const auto results = in_processes(
      7, 3, [](std::size_t i) { return std::vector<double>(i + 1, static_cast<double>(i)); },
      [&](std::size_t done) { last = done; });
  EXPECT_EQ(last, 7u);
  for (std::size_t i = 0; i < 7; ++i) {
    EXPECT_EQ(results[i], std::vector<double>(i + 1, static_cast<double>(i)));
  }
  EXPECT_THROW(in_processes(
                   3, 2,
                   [](std::size_t i) -> std::vector<double> {
                     if (i == 2) throw std::runtime_error("no");
                     return {1.0};
                   },
                   [](std::size_t) {}),
               std::runtime_error);
}

}  // namespace
}  // namespace secondskin::study
