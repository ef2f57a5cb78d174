#include "clients/authoring/cut.h"

#include <gtest/gtest.h>

#include <stdexcept>

#include "tests/authoring/bench.h"

// Truth for the recordings: when the repetitions begin and end by the joints' speeds, as in
// tests/coach_align/repetition_count_test.cc and docs/reference-motions.md.
namespace secondskin::authoring {
namespace {

constexpr double kRate = 60.0;

struct Case {
  const char* name;
  std::size_t repetitions;
};

class CutOfShipped : public ::testing::TestWithParam<Case> {};

TEST_P(CutOfShipped, FindsTheRepetitionsWithoutAReference) {
  const auto [name, repetitions] = GetParam();
  const Motion motion = shipped(name, "learner.bvh");
  const Cutting cutting = cut(motion);
  EXPECT_EQ(cutting.repetitions.size(), repetitions);
  double before = cutting.moving.start;
  EXPECT_GE(before, 0.0);
  for (const Span& each : cutting.repetitions) {
    EXPECT_GE(each.start, before - 1e-9);
    EXPECT_GT(each.duration(), 0.5);
    before = each.end;
  }
  EXPECT_LE(before, cutting.moving.end + 1e-9);
  EXPECT_LE(cutting.moving.end, motion.duration() + 1e-9);
}

TEST_P(CutOfShipped, TakesTheExpertsCutAsOneMovement) {
  EXPECT_EQ(cut(shipped(GetParam().name, "motion.bvh")).repetitions.size(), 1U);
}

// Of squat and jumping_jack the recording goes on with other exercises, so no movement is repeated
// in most of it, and it is cut by hand.
INSTANTIATE_TEST_SUITE_P(ReferenceMotions, CutOfShipped,
                         ::testing::Values(Case{"low_block", 3}, Case{"roundhouse_kick", 1},
                                           Case{"stepping_punch", 2}, Case{"knife_hand_block", 3},
                                           Case{"wave_hello", 1}, Case{"deep_squat", 3},
                                           Case{"sit_to_stand", 3}, Case{"shoulder_abduction", 3}),
                         [](const auto& info) { return info.param.name; });

TEST(Cut, PutsTheCutsOfTheBlocksWhereTheJointSpeedsHaveThem) {
  // CMU 135_05 from 3.9 s: pairs of blocks within 4.7 to 6.6, 8.8 to 10.4, 12.1 to 13.9 s.
  const double blocks[3][2] = {{0.8, 2.7}, {4.9, 6.5}, {8.2, 10.0}};
  const Cutting cutting = cut(shipped("low_block", "learner.bvh"));
  ASSERT_EQ(cutting.repetitions.size(), 3U);
  for (std::size_t i = 0; i < 3; ++i) {
    EXPECT_LT(cutting.repetitions[i].start, blocks[i][0]) << i;
    EXPECT_GT(cutting.repetitions[i].end, blocks[i][1]) << i;
  }
}

TEST(Cut, FindsRepetitionsWithPausesAndTrimsTheRest) {
  std::vector<double> way;
  rest(way, 2.0, kRate);
  for (const double seconds : {1.5, 2.0, 1.2}) {
    raise(way, seconds, kRate);
    rest(way, 1.0, kRate);
  }
  rest(way, 2.0, kRate);
  const Cutting cutting = cut(arms(way, kRate));
  EXPECT_NEAR(cutting.moving.start, 2.0, 0.35);
  EXPECT_NEAR(cutting.moving.end, 2.0 + 1.5 + 2.0 + 1.2 + 2.0, 0.35);
  ASSERT_EQ(cutting.repetitions.size(), 3U);
  const double starts[] = {2.0, 4.5, 7.5}, ends[] = {3.5, 6.5, 8.7};
  for (std::size_t i = 0; i < 3; ++i) {
    EXPECT_NEAR(cutting.repetitions[i].start, starts[i], 0.35) << i;
    EXPECT_NEAR(cutting.repetitions[i].end, ends[i], 0.35) << i;
  }
}

TEST(Cut, FindsRepetitionsWithoutABreak) {
  std::vector<double> way;
  rest(way, 1.0, kRate);
  for (int i = 0; i < 6; ++i) raise(way, 1.1, kRate);
  rest(way, 1.0, kRate);
  const Cutting cutting = cut(arms(way, kRate));
  ASSERT_EQ(cutting.repetitions.size(), 6U);
  for (std::size_t i = 0; i < 6; ++i) {
    EXPECT_NEAR(cutting.repetitions[i].start, 1.0 + 1.1 * static_cast<double>(i), 0.25) << i;
  }
}

TEST(Cut, TakesOneMovementAsOne) {
  std::vector<double> way;
  rest(way, 1.0, kRate);
  raise(way, 2.0, kRate);
  rest(way, 1.0, kRate);
  const Cutting cutting = cut(arms(way, kRate));
  ASSERT_EQ(cutting.repetitions.size(), 1U);
  EXPECT_NEAR(cutting.repetitions[0].start, 1.0, 0.35);
  EXPECT_NEAR(cutting.repetitions[0].end, 3.0, 0.35);
}

TEST(Cut, KeepsATakeInWhichNobodyMovesWhole) {
  std::vector<double> way;
  rest(way, 3.0, kRate);
  const Cutting cutting = cut(arms(way, kRate));
  ASSERT_EQ(cutting.repetitions.size(), 1U);
  EXPECT_NEAR(cutting.repetitions[0].duration(), 3.0, 0.1);
}

TEST(Cut, DoesNotDependOnTheRate) {
  for (const double rate : {30.0, 100.0}) {
    EXPECT_EQ(cut(resample(shipped("deep_squat", "learner.bvh"), rate)).repetitions.size(), 3U)
        << rate;
  }
}

TEST(Cut, RefusesWhatIsTooShort) {
  EXPECT_THROW(cut(arms({0.0, 0.1, 0.2}, kRate)), std::invalid_argument);
}

}  // namespace
}  // namespace secondskin::authoring
