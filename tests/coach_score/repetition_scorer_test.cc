#include "coach/score/repetition_scorer.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

namespace secondskin::coach {
namespace {

constexpr double kDegree = std::numbers::pi / 180.0;

// Four seconds of standing; the right knee matters twice as much as the left, nothing else does.
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
  std::optional<RepetitionScore> frame(Phase phase, double reference_time, std::uint32_t repetition,
                                       std::uint64_t cues = 0) {
    stamp_ns_ += 16'000'000;
    JointVectors error = zero_vectors();
    joint_errors(*reference_, reference_time, pose_, error);
    return scorer_.update(stamp_ns_, pose_, {reference_time, 1.0, 1.0, phase, repetition}, error,
                          cues);
  }
  void moving(double from, double to, std::uint32_t repetition, std::uint64_t cues = 0) {
    for (double t = from; t < to; t += 0.016) {
      ASSERT_FALSE(frame(Phase::kMoving, t, repetition, cues));
    }
  }
  RepetitionScore whole() {
    moving(0.0, 3.9, 1);
    const auto score = frame(Phase::kFinished, 3.9, 1);
    EXPECT_TRUE(score);
    return score.value_or(RepetitionScore{});
  }
  // Flexed by so much more than the expert's.
  void err(Joint joint, double degrees) {
    pose_.q_PB[index(joint)] = joint_rotation(joint, {degrees * kDegree, 0.0, 0.0});
  }

  std::shared_ptr<const Reference> reference_ = reference();
  RepetitionScorer scorer_{reference_};
  Pose pose_{kJointCount};
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

// docs/scoring.md, equations 1 to 4. A tolerance of 10 degrees is a spread of 5, of the difference
// of two sides 5 sqrt 2. A shank that is back by 15 all the time is so by 3 spreads, which costs
// half of one of three terms of one of its two features; it has not moved since the start, and its
// range is the expert's.
TEST_F(RepetitionScorerTest, AddsUpTheCriteria) {
  err(Joint::kRightKnee, 15.0);
  const RepetitionScore score = whole();
  const double legs = 0.5 / 3.0 / (1.0 + 1.0 + 0.5 + 0.5);
  const double symmetry = (15.0 / (5.0 * std::sqrt(2.0)) - 1.0) / 4.0 / 3.0 / 2.0;
  const double joints = 0.5 * (15.0 - 10.0) / 30.0 * 2.0 / 3.0;
  const auto lost = [&](Criterion c) { return score.lost[static_cast<std::size_t>(c)]; };
  EXPECT_NEAR(lost(Criterion::kLegs).value(), legs, 1e-9);
  EXPECT_NEAR(lost(Criterion::kSymmetry).value(), symmetry, 1e-9);
  EXPECT_NEAR(lost(Criterion::kDepth).value(), 0.0, 1e-9);  // the other leg stands
  EXPECT_NEAR(score.lost[kCriterionCount].value(), joints, 1e-9);
  EXPECT_FALSE(lost(Criterion::kTrunk));  // has no weight
  EXPECT_FALSE(lost(Criterion::kArms));
  EXPECT_NEAR(score.total, 100.0 * (1.0 - (legs + symmetry + joints) / 4.0), 1e-9);
}

TEST_F(RepetitionScorerTest, GivesTheErrorsOfAJoint) {
  err(Joint::kRightKnee, 25.0);
  const JointScore knee = whole().joints[index(Joint::kRightKnee)];
  EXPECT_TRUE(knee.measured);
  EXPECT_NEAR(knee.rms, 25.0 * kDegree, 1e-9);
  EXPECT_NEAR(knee.peak, 25.0 * kDegree, 1e-9);
  EXPECT_DOUBLE_EQ(knee.in_band, 0.0);
  EXPECT_FALSE(knee.timing_error);  // neither moves
  EXPECT_FALSE(knee.smoothness);
}

TEST_F(RepetitionScorerTest, FallsAsTheErrorGrows) {
  double before = 100.0;
  for (const double degrees : {8.0, 12.0, 16.0, 20.0, 28.0, 36.0}) {
    err(Joint::kRightKnee, degrees);
    err(Joint::kLeftKnee, degrees);
    const double total = whole().total;
    EXPECT_LT(total, before) << degrees;
    EXPECT_GE(total, 0.0);
    before = total;
  }
}

TEST_F(RepetitionScorerTest, DoesNotCountWhatIsNotMeasured) {
  err(Joint::kRightKnee, 40.0);
  pose_.confidence[index(Joint::kRightKnee)] = 0.0F;
  RepetitionScore score = whole();
  EXPECT_DOUBLE_EQ(score.total, 100.0);  // the left knee is all that is known
  EXPECT_FALSE(score.joints[index(Joint::kRightKnee)].measured);
  EXPECT_TRUE(score.joints[index(Joint::kLeftKnee)].measured);
  EXPECT_FALSE(score.lost[static_cast<std::size_t>(Criterion::kSymmetry)]);

  pose_ = Pose(kJointCount);
  pose_.q_PB[index(Joint::kRightKnee)].coeffs().fill(std::nan(""));
  score = whole();
  EXPECT_DOUBLE_EQ(score.total, 100.0);

  // A hip that is not seen hides where the shank points, but the knee is judged by itself.
  pose_ = Pose(kJointCount);
  err(Joint::kRightKnee, 25.0);
  pose_.confidence[index(Joint::kRightHip)] = 0.0F;
  score = whole();
  EXPECT_DOUBLE_EQ(score.lost[static_cast<std::size_t>(Criterion::kLegs)].value(), 0.0);
  EXPECT_GT(score.lost[kCriterionCount].value(), 0.1);
}

// Turning round, walking away and being another size change nothing.
TEST_F(RepetitionScorerTest, DoesNotDependOnHeadingAndPlace) {
  err(Joint::kRightKnee, 15.0);
  pose_.q_PB[0] = joint_rotation(Joint::kPelvis, {8.0 * kDegree, 3.0 * kDegree, 0.0});
  const double here = whole().total;
  pose_.q_PB[0] = Eigen::AngleAxisd(2.0, Eigen::Vector3d::UnitZ()) * pose_.q_PB[0];
  pose_.p_WR = {3.0, -5.0, 0.4};
  EXPECT_NEAR(whole().total, here, 1e-9);
  EXPECT_LT(here, 99.0);
}

TEST_F(RepetitionScorerTest, IgnoresJointsWithoutWeightInTheTotal) {
  err(Joint::kHead, 90.0);
  moving(0.0, 3.9, 1);
  const auto score = frame(Phase::kFinished, 3.9, 1);
  ASSERT_TRUE(score);
  EXPECT_DOUBLE_EQ(score->total, 100.0);
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
