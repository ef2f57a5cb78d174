#include "coach/score/repetition_scorer.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

namespace secondskin::coach {
namespace {

constexpr double kDegree = std::numbers::pi / 180.0;

// Four seconds of reference; the right knee matters twice as much as the left, nothing else does.
std::shared_ptr<const Reference> reference() {
  Motion motion{canonical_skeleton(), 60.0, std::vector<Pose>(241, Pose(kJointCount))};
  Reference r = make_reference("score", motion);
  r.weight.fill(0.0);
  r.weight[index(Joint::kLeftKnee)] = 0.5;
  r.weight[index(Joint::kRightKnee)] = 1.0;
  return std::make_shared<const Reference>(r);
}

class RepetitionScorerTest : public ::testing::Test {
 protected:
  RepetitionScorerTest() { error_.fill(Eigen::Vector3d::Zero()); }

  std::optional<RepetitionScore> frame(Phase phase, double reference_time, std::uint32_t repetition,
                                       std::uint64_t cues = 0) {
    stamp_ns_ += 16'000'000;
    return scorer_.update(stamp_ns_, {reference_time, 1.0, 1.0, phase, repetition}, error_, cues);
  }
  void moving(double from, double to, std::uint32_t repetition, std::uint64_t cues = 0) {
    for (double t = from; t < to; t += 0.016) {
      ASSERT_FALSE(frame(Phase::kMoving, t, repetition, cues));
    }
  }
  void err(Joint joint, double degrees) {
    error_[index(joint)] = Eigen::Vector3d(0.0, degrees * kDegree, 0.0);
  }

  RepetitionScorer scorer_{reference()};
  JointVectors error_;
  std::int64_t stamp_ns_ = 1'000'000'000;
};

TEST_F(RepetitionScorerTest, GivesAHundredForNoError) {
  moving(0.2, 3.9, 1);
  const auto score = frame(Phase::kFinished, 3.9, 1);
  ASSERT_TRUE(score);
  EXPECT_EQ(score->repetition, 1U);
  EXPECT_DOUBLE_EQ(score->total, 100.0);
  EXPECT_DOUBLE_EQ(score->joints[index(Joint::kLeftKnee)].in_band, 1.0);
  EXPECT_EQ(score->end_ns, stamp_ns_);
  EXPECT_NEAR(static_cast<double>(score->end_ns - score->start_ns) * 1e-9, 3.7, 0.05);
}

// docs/scoring.md, equation 1: 10 degrees of tolerance, 25 of error: half of the excess that costs
// all (30), by the right knee's share of the weight (2/3).
TEST_F(RepetitionScorerTest, TakesOffTheWeightedExcess) {
  err(Joint::kRightKnee, 25.0);
  moving(0.0, 3.9, 1);
  const auto score = frame(Phase::kFinished, 3.9, 1);
  ASSERT_TRUE(score);
  EXPECT_NEAR(score->total, 100.0 * (1.0 - 0.5 * 2.0 / 3.0), 1e-9);
  EXPECT_NEAR(score->joints[index(Joint::kRightKnee)].rms, 25.0 * kDegree, 1e-9);
  EXPECT_NEAR(score->joints[index(Joint::kRightKnee)].peak, 25.0 * kDegree, 1e-9);
  EXPECT_DOUBLE_EQ(score->joints[index(Joint::kRightKnee)].in_band, 0.0);
}

TEST_F(RepetitionScorerTest, FallsWithTheErrorUntilNothingIsLeft) {
  double before = 101.0;
  for (const double degrees : {5.0, 12.0, 20.0, 28.0, 36.0, 40.0}) {
    err(Joint::kRightKnee, degrees);
    err(Joint::kLeftKnee, degrees);
    moving(0.0, 3.9, 1);
    const auto score = frame(Phase::kFinished, 3.9, 1);
    ASSERT_TRUE(score);
    EXPECT_LT(score->total, before);
    EXPECT_GE(score->total, 0.0);
    before = score->total;
  }
  EXPECT_DOUBLE_EQ(before, 0.0);
}

TEST_F(RepetitionScorerTest, IgnoresJointsWithoutWeightInTheTotal) {
  err(Joint::kHead, 90.0);
  moving(0.0, 3.9, 1);
  const auto score = frame(Phase::kFinished, 3.9, 1);
  ASSERT_TRUE(score);
  EXPECT_DOUBLE_EQ(score->total, 100.0);
  EXPECT_NEAR(score->joints[index(Joint::kHead)].rms, 90.0 * kDegree, 1e-9);
}

TEST_F(RepetitionScorerTest, CountsTheTimeInsideTheBand) {
  moving(0.0, 2.0, 1);
  err(Joint::kLeftKnee, 15.0);
  moving(2.0, 4.0, 1);
  const auto score = frame(Phase::kFinished, 4.0, 1);
  ASSERT_TRUE(score);
  EXPECT_NEAR(score->joints[index(Joint::kLeftKnee)].in_band, 0.5, 0.01);
}

TEST_F(RepetitionScorerTest, CountsTheCuesOfEachRepetition) {
  moving(0.0, 3.9, 1, 5);
  EXPECT_EQ(frame(Phase::kFinished, 3.9, 1, 9)->cues, 4U);
  moving(0.0, 3.9, 2, 9);
  EXPECT_EQ(frame(Phase::kFinished, 3.9, 2, 10)->cues, 1U);
}

TEST_F(RepetitionScorerTest, SaysAFinishedRepetitionOnce) {
  moving(0.0, 3.9, 1);
  EXPECT_TRUE(frame(Phase::kFinished, 3.9, 1));
  EXPECT_FALSE(frame(Phase::kFinished, 3.9, 1));
  EXPECT_FALSE(scorer_.finish());
}

TEST_F(RepetitionScorerTest, ForgetsAnAttemptThatWasGivenUp) {
  err(Joint::kRightKnee, 40.0);
  moving(0.0, 3.0, 1);
  EXPECT_FALSE(frame(Phase::kWaiting, 0.0, 0));
  err(Joint::kRightKnee, 0.0);
  moving(0.0, 3.9, 1);
  EXPECT_DOUBLE_EQ(frame(Phase::kFinished, 3.9, 1)->total, 100.0);
}

TEST_F(RepetitionScorerTest, BeginsAgainWhenTheLearnerDoes) {
  err(Joint::kRightKnee, 40.0);
  moving(0.0, 3.0, 1);
  err(Joint::kRightKnee, 0.0);
  moving(0.0, 3.9, 1);
  EXPECT_DOUBLE_EQ(frame(Phase::kFinished, 3.9, 1)->total, 100.0);
}

TEST_F(RepetitionScorerTest, LeavesOutTheTimeThatWasLost) {
  moving(0.0, 2.0, 1);
  err(Joint::kRightKnee, 40.0);
  for (int i = 0; i < 50; ++i) EXPECT_FALSE(frame(Phase::kLost, 2.0, 1));
  err(Joint::kRightKnee, 0.0);
  moving(2.0, 3.9, 1);
  EXPECT_DOUBLE_EQ(frame(Phase::kFinished, 3.9, 1)->total, 100.0);
}

TEST_F(RepetitionScorerTest, FinishesTheOneUnderWayWhenHalfIsCovered) {
  moving(0.0, 1.9, 1);
  EXPECT_FALSE(scorer_.finish());
  moving(0.0, 2.2, 1);
  const auto score = scorer_.finish();
  ASSERT_TRUE(score);
  EXPECT_EQ(score->repetition, 1U);
  EXPECT_FALSE(scorer_.finish());
}

}  // namespace
}  // namespace secondskin::coach
