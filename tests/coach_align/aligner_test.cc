#include "coach/align/aligner.h"

#include <gtest/gtest.h>

#include <limits>
#include <stdexcept>

#include "tests/coach_align/trials.h"

namespace secondskin::coach {
namespace {

// An arm that swings up to 1.2 rad and a knee that bends once, and still parts at both ends.
Motion swing() {
  Motion motion{canonical_skeleton(), 60.0, {}};
  for (int i = 0; i < 240; ++i) {
    const double u = std::clamp((i - 30) / 180.0, 0.0, 1.0);
    Pose pose(kJointCount);
    pose.q_PB[index(Joint::kRightShoulder)] =
        quaternion_from({0.0, -1.2 * std::sin(3.1 * u), 0.3 * u});
    pose.q_PB[index(Joint::kLeftKnee)] =
        quaternion_from({0.0, 0.9 * (1.0 - std::cos(2.0 * std::numbers::pi * u)), 0.0});
    motion.poses.push_back(pose);
  }
  return motion;
}

class AlignerTest : public ::testing::Test {
 protected:
  AlignmentEstimate play(Aligner& aligner, double from, double to, double tempo = 1.0) {
    Pose pose(kJointCount);
    AlignmentEstimate e;
    for (double x = from; tempo * (to - x) > 0.0; x += tempo / kLearnerRate) {
      sample(motion_, x, pose);
      e = aligner.update(stamp(time_), pose);
      time_ += 1.0 / kLearnerRate;
    }
    return e;
  }
  AlignmentEstimate hold(Aligner& aligner, double at, double seconds) {
    Pose pose(kJointCount);
    sample(motion_, at, pose);
    AlignmentEstimate e;
    for (double t = 0.0; t < seconds; t += 1.0 / kLearnerRate, time_ += 1.0 / kLearnerRate) {
      e = aligner.update(stamp(time_), pose);
    }
    return e;
  }

  Motion motion_ = swing();
  std::shared_ptr<const Reference> reference_ = reference_of(motion_);
  double time_ = 0.0;
};

TEST_F(AlignerTest, WaitsWhileTheLearnerStandsAtTheStart) {
  Aligner aligner(reference_);
  const auto e = hold(aligner, 0.0, 3.0);
  EXPECT_EQ(e.phase, Phase::kWaiting);
  EXPECT_EQ(e.repetition, 0U);
  EXPECT_LT(e.reference_time, 1.0);
}

TEST_F(AlignerTest, GoesThroughWaitingMovingAndFinished) {
  Aligner aligner(reference_);
  EXPECT_EQ(hold(aligner, 0.0, 0.5).phase, Phase::kWaiting);
  const auto middle = play(aligner, 0.0, 2.0);
  EXPECT_EQ(middle.phase, Phase::kMoving);
  EXPECT_EQ(middle.repetition, 1U);
  EXPECT_NEAR(middle.reference_time, 2.0, 0.05);
  EXPECT_NEAR(middle.tempo, 1.0, 0.15);
  EXPECT_GT(middle.confidence, 0.7);
  const auto end = play(aligner, 2.0, 4.0);
  EXPECT_EQ(end.phase, Phase::kFinished);
  EXPECT_EQ(end.repetition, 1U);
}

TEST_F(AlignerTest, TellsTheTempo) {
  for (const double tempo : {0.5, 0.75, 1.5, 2.0}) {
    Aligner aligner(reference_);
    hold(aligner, 0.0, 0.3);
    const auto e = play(aligner, 0.0, 2.2, tempo);
    EXPECT_NEAR(e.tempo, tempo, 0.15 * tempo);
    EXPECT_NEAR(e.reference_time, 2.2, 0.06);
  }
}

TEST_F(AlignerTest, SaysPausedWhenTheLearnerStopsMidwayAndGoesOn) {
  Aligner aligner(reference_);
  play(aligner, 0.0, 1.5);
  const auto still = hold(aligner, 1.5, 2.0);
  EXPECT_EQ(still.phase, Phase::kPaused);
  EXPECT_NEAR(still.reference_time, 1.5, 0.05);
  EXPECT_LE(still.tempo, 0.12);
  const auto on = play(aligner, 1.5, 2.0);
  EXPECT_EQ(on.phase, Phase::kMoving);
  EXPECT_NEAR(on.reference_time, 2.0, 0.06);
}

TEST_F(AlignerTest, SaysLostWhenTheLearnerDoesSomethingElse) {
  Aligner aligner(reference_);
  play(aligner, 0.0, 1.5);
  Pose other(kJointCount);
  for (auto& q : other.q_PB) q = quaternion_from({0.9, 0.0, 0.9});
  AlignmentEstimate e;
  for (int i = 0; i < 60; ++i, time_ += 1.0 / kLearnerRate) e = aligner.update(stamp(time_), other);
  EXPECT_EQ(e.phase, Phase::kLost);
  EXPECT_LT(e.confidence, 0.3);
  for (int i = 0; i < 150; ++i, time_ += 1.0 / kLearnerRate)
    e = aligner.update(stamp(time_), other);
  EXPECT_EQ(e.phase, Phase::kWaiting);
  EXPECT_EQ(e.repetition, 0U);
}

TEST_F(AlignerTest, FollowsALearnerWhoJoinsInTheMiddle) {
  Aligner aligner(reference_);
  const auto e = play(aligner, 1.0, 2.6);
  EXPECT_EQ(e.phase, Phase::kMoving);
  EXPECT_NEAR(e.reference_time, 2.6, 0.1);
}

TEST_F(AlignerTest, IsTheSameForAnyPlaceAndFacingDirection) {
  const Motion motion = shipped_learner("low_block");
  const auto reference = shipped("low_block");
  Aligner here(reference), there(reference), turned(reference);
  for (std::size_t i = 0; i < motion.poses.size(); ++i) {
    const std::int64_t at = stamp(static_cast<double>(i) / motion.rate_hz);
    Pose pose = motion.poses[i];
    const auto a = here.update(at, pose);
    pose.p_WR += Eigen::Vector3d(12.0, -3.0, 0.4);
    const auto b = there.update(at, pose);
    pose.q_PB[0] = Eigen::AngleAxisd(2.1, Eigen::Vector3d::UnitZ()) * pose.q_PB[0];
    const auto c = turned.update(at, pose);
    ASSERT_EQ(a.reference_time, b.reference_time);  // the place is never read
    ASSERT_EQ(a.phase, b.phase);
    ASSERT_EQ(a.phase, c.phase);
    ASSERT_EQ(a.repetition, c.repetition);
    ASSERT_NEAR(a.reference_time, c.reference_time, 1e-3);  // but for rounding to float
  }
}

TEST_F(AlignerTest, SeesTheTiltOfThePelvis) {
  Motion bow{canonical_skeleton(), 60.0, {}};
  for (int i = 0; i < 180; ++i) {
    Pose pose(kJointCount);
    pose.q_PB[0] = quaternion_from({0.0, 0.8 * std::sin(std::numbers::pi * i / 180.0), 0.0});
    bow.poses.push_back(pose);
  }
  Reference reference = make_reference("bow", bow);
  reference.weight.fill(0.0);
  reference.weight[index(Joint::kPelvis)] = 1.0;
  motion_ = bow;
  Aligner aligner(std::make_shared<const Reference>(reference));
  hold(aligner, 0.0, 0.3);
  EXPECT_NEAR(play(aligner, 0.0, 1.0).reference_time, 1.0, 0.06);
}

TEST_F(AlignerTest, DropsWrongPosesAndCountsThem) {
  Aligner aligner(reference_);
  const auto before = play(aligner, 0.0, 1.5);
  Pose pose(kJointCount);
  pose.q_PB[3].x() = std::numeric_limits<double>::quiet_NaN();
  auto e = aligner.update(stamp(time_), pose);
  EXPECT_EQ(e.reference_time, before.reference_time);
  EXPECT_EQ(aligner.dropped(), 1U);
  e = aligner.update(stamp(time_), Pose(5));
  EXPECT_EQ(aligner.dropped(), 2U);
  Pose unseen(kJointCount);
  std::fill(unseen.confidence.begin(), unseen.confidence.end(), 0.0F);
  e = aligner.update(stamp(time_), unseen);
  EXPECT_EQ(e.reference_time, before.reference_time);
  EXPECT_EQ(aligner.dropped(), 3U);
  EXPECT_NEAR(play(aligner, 1.5, 2.0).reference_time, 2.0, 0.06);
}

TEST_F(AlignerTest, RepeatsTheLastEstimateForAStampThatIsNotLater) {
  Aligner aligner(reference_);
  const auto before = play(aligner, 0.0, 1.5);
  Pose pose(kJointCount);
  sample(motion_, 0.2, pose);
  for (const double late : {0.02, 0.5, 1.0}) {
    const auto e = aligner.update(stamp(time_ - late), pose);
    EXPECT_EQ(e.reference_time, before.reference_time);
    EXPECT_EQ(e.tempo, before.tempo);
  }
  EXPECT_NEAR(play(aligner, 1.5, 2.0).reference_time, 2.0, 0.06);
}

TEST_F(AlignerTest, SurvivesALongGap) {
  Aligner aligner(reference_);
  play(aligner, 0.0, 1.5);
  time_ += 5.0;
  EXPECT_NEAR(play(aligner, 1.5, 2.6).reference_time, 2.6, 0.1);
}

TEST_F(AlignerTest, IgnoresJointsWithoutWeightOrConfidence) {
  Reference reference = make_reference("arm", motion_);
  reference.weight.fill(0.0);
  reference.weight[index(Joint::kRightShoulder)] = 1.0;
  reference.weight[index(Joint::kHead)] = 1.0;
  Aligner aligner(std::make_shared<const Reference>(reference));
  AlignmentEstimate e;
  Pose pose(kJointCount);
  for (double x = 0.0; x < 1.2; x += 1.0 / kLearnerRate, time_ += 1.0 / kLearnerRate) {
    sample(motion_, x, pose);
    pose.q_PB[index(Joint::kHead)] = quaternion_from({1.0, 1.0, 0.0});
    pose.confidence[index(Joint::kHead)] = 0.0F;
    pose.q_PB[index(Joint::kLeftHip)] = quaternion_from({0.0, 1.0, 1.0});
    e = aligner.update(stamp(time_), pose);
  }
  EXPECT_NEAR(e.reference_time, 1.2, 0.06);
  EXPECT_GT(e.confidence, 0.6);
}

TEST_F(AlignerTest, BridgesGapsOfAJointInTheReference) {
  Motion gappy = motion_;
  for (std::size_t i = 100; i < 110; ++i) {
    gappy.poses[i].q_PB[index(Joint::kRightShoulder)] = Eigen::Quaterniond::Identity();
    gappy.poses[i].confidence[index(Joint::kRightShoulder)] = 0.0F;
  }
  Aligner aligner(reference_of(gappy));
  play(aligner, 0.0, 1.7);
  EXPECT_NEAR(play(aligner, 1.7, 1.75).reference_time, 1.75, 0.05);
}

TEST_F(AlignerTest, ResetBringsTheSameEstimatesAgain) {
  Aligner aligner(reference_);
  const auto first = play(aligner, 0.0, 1.7);
  play(aligner, 1.7, 4.0);
  aligner.reset();
  time_ = 100.0;
  const auto again = play(aligner, 0.0, 1.7);
  EXPECT_EQ(again.repetition, first.repetition);
  EXPECT_NEAR(again.reference_time, first.reference_time, 1e-4);
  EXPECT_NEAR(again.confidence, first.confidence, 1e-3);
}

TEST_F(AlignerTest, SameStreamGivesTheSameEstimatesBitForBit) {
  const Motion learner = shipped_learner("squat");
  const auto reference = shipped("squat");
  Aligner a(reference), b(reference);
  for (std::size_t i = 0; i < learner.poses.size(); ++i) {
    const std::int64_t at = stamp(static_cast<double>(i) / learner.rate_hz);
    const auto x = a.update(at, learner.poses[i]), y = b.update(at, learner.poses[i]);
    ASSERT_EQ(x.reference_time, y.reference_time);
    ASSERT_EQ(x.confidence, y.confidence);
  }
}

TEST_F(AlignerTest, TakesReferencesOfAnyLength) {
  for (const std::size_t frames : {1UL, 2UL, 3UL, 10UL, 240UL}) {
    motion_ = slice(swing(), 0, frames);
    Aligner aligner(reference_of(motion_));
    const auto e = hold(aligner, 0.0, 0.5);
    EXPECT_TRUE(std::isfinite(e.reference_time));
    EXPECT_LE(e.reference_time, motion_.duration());
    EXPECT_TRUE(std::isfinite(e.confidence));
  }
}

TEST_F(AlignerTest, RefusesWhatCannotWork) {
  EXPECT_THROW(Aligner(nullptr), std::invalid_argument);
  EXPECT_THROW(Aligner(reference_, {.window = 0.0}), std::invalid_argument);
  EXPECT_THROW(Aligner(reference_, {.min_tempo = 2.0, .max_tempo = 1.0}), std::invalid_argument);
}

// Any finite input: the estimate stays inside the reference.
TEST_F(AlignerTest, StaysInsideTheReferenceForRandomPoses) {
  std::mt19937 random(3);
  std::uniform_real_distribution<double> uniform(-3.0, 3.0);
  Aligner aligner(reference_);
  Pose pose(kJointCount);
  for (int i = 0; i < 1000; ++i) {
    for (auto& q : pose.q_PB)
      q = quaternion_from({uniform(random), uniform(random), uniform(random)});
    for (auto& c : pose.confidence) c = uniform(random) > -2.0 ? 1.0F : 0.0F;
    time_ += std::fabs(uniform(random)) * 0.02 + 1e-4;
    const auto e = aligner.update(stamp(time_), pose);
    ASSERT_GE(e.reference_time, 0.0);
    ASSERT_LE(e.reference_time, motion_.duration());
    ASSERT_GE(e.tempo, 0.0);
    ASSERT_LE(e.tempo, 2.3);
    ASSERT_GE(e.confidence, 0.0);
    ASSERT_LE(e.confidence, 1.0);
  }
}

}  // namespace
}  // namespace secondskin::coach
