#include <gtest/gtest.h>

#include "tests/coach_align/trials.h"

// Repetitions of real performances. The truth was read off the recordings' joint speeds and is in
// the data's notes: CMU 135_05 (blocks at 1.1 2.8 | 4.7 6.6 | 8.8 10.4 | 12.1 13.9 s), 135_07
// (kicks at 1.0 3.7 | 6.4 9.4 s), 135_09 (punches at 6.3 8.2 | 10.9 12.6 | 14.2 15.8 s), 135_10
// (blocks at 1.9 3.4 | 4.9 6.4 | 8.0 9.8 | 11.4 12.9 | 14.4 s), 14_14 (three jumping jacks, two
// squats). The first pair is the reference, or the second of 135_09; learner.bvh is what follows
// it, with turns, walking off and other exercises.
namespace secondskin::coach {
namespace {

struct Count {
  int finished = 0;
  std::uint32_t last = 0;
};

Count count(const std::shared_ptr<const Reference>& reference, const Motion& learner,
            double rate_hz) {
  Aligner aligner(reference);
  const Motion stream = resample(learner, rate_hz);
  Count result;
  Phase before = Phase::kWaiting;
  for (std::size_t i = 0; i < stream.poses.size(); ++i) {
    const auto e = aligner.update(stamp(static_cast<double>(i) / rate_hz), stream.poses[i]);
    if (e.phase == Phase::kFinished && before != Phase::kFinished) ++result.finished;
    before = e.phase;
    result.last = e.repetition;
  }
  return result;
}

struct Case {
  const char* name;
  int repetitions;
};

class RepetitionCount : public ::testing::TestWithParam<Case> {};

TEST_P(RepetitionCount, IsRightForTheShippedLearnerAtAnyRate) {
  const auto [name, repetitions] = GetParam();
  const auto reference = shipped(name);
  const Motion learner = shipped_learner(name);
  for (const double rate_hz : {30.0, 60.0, 62.5, 100.0, 120.0}) {
    const Count c = count(reference, learner, rate_hz);
    EXPECT_EQ(c.finished, repetitions) << name << " at " << rate_hz << " Hz";
  }
}

TEST_P(RepetitionCount, IsOneForTheExpert) {
  const auto reference = shipped(GetParam().name);
  const Count c = count(reference, reference->motion, 62.5);
  EXPECT_EQ(c.finished, 1);
  EXPECT_EQ(c.last, 1U);
}

INSTANTIATE_TEST_SUITE_P(ReferenceMotions, RepetitionCount,
                         ::testing::Values(Case{"low_block", 3}, Case{"roundhouse_kick", 1},
                                           Case{"stepping_punch", 2}, Case{"knife_hand_block", 3},
                                           Case{"squat", 1}, Case{"jumping_jack", 2},
                                           Case{"wave_hello", 1}, Case{"deep_squat", 3},
                                           Case{"sit_to_stand", 3}, Case{"shoulder_abduction", 3}),
                         [](const auto& info) { return info.param.name; });

TEST(Repetitions, AreNotCountedInAnotherMotion) {
  for (const char* reference : {"low_block", "stepping_punch", "knife_hand_block",
                                "roundhouse_kick", "squat", "jumping_jack", "wave_hello"}) {
    for (const char* learner : {"low_block", "stepping_punch", "knife_hand_block",
                                "roundhouse_kick", "squat", "jumping_jack", "wave_hello"}) {
      if (std::string(reference) == learner) continue;
      EXPECT_EQ(count(shipped(reference), shipped_learner(learner), 62.5).finished, 0)
          << learner << " followed in " << reference;
    }
  }
}

// In joint angles a squat and sitting down on a chair are much the same; the arm is not.
TEST(Repetitions, OfAnArmAreNotCountedInTheLegsExercisesNorTheOtherWayRound) {
  for (const char* legs : {"deep_squat", "sit_to_stand", "squat"}) {
    EXPECT_EQ(count(shipped(legs), shipped_learner("shoulder_abduction"), 62.5).finished, 0);
    EXPECT_EQ(count(shipped("shoulder_abduction"), shipped_learner(legs), 62.5).finished, 0);
  }
}

// 135_07's first kick alone is the reference: of the following two only the same side counts.
TEST(Repetitions, OfTheOtherSideAreNotCounted) {
  const auto whole = shipped("roundhouse_kick");
  const auto one_side = reference_of(slice(whole->motion, 0, 168));
  EXPECT_EQ(count(one_side, slice(whole->motion, 150, whole->motion.poses.size()), 62.5).finished,
            0);
  EXPECT_EQ(count(one_side, shipped_learner("roundhouse_kick"), 62.5).finished, 1);
}

TEST(Repetitions, WithoutABreakAreCounted) {
  const auto reference = shipped("jumping_jack");
  Motion learner = reference->motion;
  const auto once = learner.poses;
  for (int i = 1; i < 8; ++i) learner.poses.insert(learner.poses.end(), once.begin(), once.end());
  EXPECT_EQ(count(reference, learner, 62.5).finished, 8);
}

TEST(Repetitions, BrokenOffMidwayAreNotCounted) {
  const auto reference = shipped("squat");
  const auto& expert = reference->motion.poses;
  Motion learner = reference->motion;
  const std::size_t part = expert.size() * 2 / 5;
  // Down, and the way back up again, then a whole one.
  learner.poses.assign(expert.begin(), expert.begin() + static_cast<std::ptrdiff_t>(part));
  learner.poses.insert(learner.poses.end(), expert.rend() - static_cast<std::ptrdiff_t>(part),
                       expert.rend());
  learner.poses.insert(learner.poses.end(), 30, expert.front());
  learner.poses.insert(learner.poses.end(), expert.begin(), expert.end());
  const Count c = count(reference, learner, 62.5);
  EXPECT_GE(c.finished, 1);
  EXPECT_LE(c.finished, 2);  // the squat up and down again may be taken for one without its depth
}

TEST(Repetitions, BegunAgainFromTheStartAreCountedOnce) {
  const auto reference = shipped("low_block");
  const auto& expert = reference->motion.poses;
  Motion learner = reference->motion;
  const auto part = static_cast<std::ptrdiff_t>(expert.size() / 4);
  learner.poses.assign(expert.begin(), expert.begin() + part);
  learner.poses.insert(learner.poses.end(), 30, expert.front());  // breaks off, stands as at first
  learner.poses.insert(learner.poses.end(), expert.begin(), expert.end());
  EXPECT_EQ(count(reference, learner, 62.5).finished, 1);
}

}  // namespace
}  // namespace secondskin::coach
