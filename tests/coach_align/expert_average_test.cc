#include "coach/align/expert_average.h"

#include <gtest/gtest.h>

#include <stdexcept>

#include "tests/coach_align/trials.h"

namespace secondskin::coach {
namespace {

std::array<double, kJointCount> even() {
  std::array<double, kJointCount> weight{};
  weight.fill(1.0);
  return weight;
}

// The motion at time x + shift(x), shift a half sine of this height [s].
Motion bent(const Motion& motion, double height) {
  Motion result = motion;
  for (std::size_t i = 0; i < motion.poses.size(); ++i) {
    const double x = static_cast<double>(i) / motion.rate_hz;
    sample(motion, x + height * std::sin(std::numbers::pi * x / motion.duration()),
           result.poses[i]);
  }
  return result;
}

// The same with one joint turned by an angle about x throughout.
Motion turned(Motion motion, Joint joint, double angle) {
  for (Pose& pose : motion.poses) {
    pose.q_PB[index(joint)] = pose.q_PB[index(joint)] * quaternion_from({angle, 0.0, 0.0});
  }
  return motion;
}

TEST(ExpertAverage, OfOneIsThatOneWithoutSpread) {
  const Motion squat = shipped("squat")->motion;
  const ExpertAverage mean = average_experts({&squat, 1}, even(), 60.0);
  ASSERT_EQ(mean.motion.poses.size(), squat.poses.size());
  ASSERT_EQ(mean.spread.size(), squat.poses.size());
  for (std::size_t i = 0; i < squat.poses.size(); ++i) {
    EXPECT_LT(rms_distance(mean.motion.poses[i], squat.poses[i]), 1e-9);
    for (const double s : mean.spread[i]) EXPECT_EQ(s, 0.0);
  }
}

TEST(ExpertAverage, UndoesTheExpertsDifferentTiming) {
  const Motion block = shipped("low_block")->motion;
  const std::vector<Motion> experts{block, bent(block, 0.25), bent(block, -0.25)};
  const ExpertAverage mean = average_experts(experts, even(), 60.0);
  // Opposite shifts cancel (to first order), so the mean is the motion itself and all agree.
  ASSERT_NEAR(mean.motion.duration(), block.duration(), 0.05);
  std::vector<double> off, spread;
  for (std::size_t i = 0; i < std::min(block.poses.size(), mean.motion.poses.size()); ++i) {
    off.push_back(rms_distance(mean.motion.poses[i], block.poses[i]));
    for (const double s : mean.spread[i]) spread.push_back(s);
  }
  std::sort(off.begin(), off.end());
  std::sort(spread.begin(), spread.end());
  EXPECT_LT(off[off.size() / 2], 3.0 * kDegree);
  EXPECT_LT(spread[spread.size() * 9 / 10], 4.0 * kDegree);
  EXPECT_GT(rms_distance(experts[1].poses[60], experts[2].poses[60]), 10.0 * kDegree);
}

TEST(ExpertAverage, TakesTheMeanOfTheirDurations) {
  const Motion squat = shipped("squat")->motion;
  Motion slow = resample(squat, 90.0);
  slow.rate_hz = 60.0;  // the same poses, one and a half times as long
  const std::vector<Motion> experts{squat, slow};
  EXPECT_NEAR(average_experts(experts, even(), 60.0).motion.duration(), 1.25 * squat.duration(),
              0.03);
}

TEST(ExpertAverage, LiesBetweenThemOnSO3AndTellsWhereTheyDiffer) {
  const Motion squat = shipped("squat")->motion;
  const Joint joint = Joint::kLeftElbow;
  const double angle = 0.4;
  const std::vector<Motion> experts{turned(squat, joint, angle), turned(squat, joint, -angle)};
  const ExpertAverage mean = average_experts(experts, even(), 60.0);
  ASSERT_EQ(mean.motion.poses.size(), squat.poses.size());
  for (std::size_t i = 0; i < squat.poses.size(); ++i) {
    EXPECT_LT(geodesic_distance(mean.motion.poses[i].q_PB[index(joint)],
                                squat.poses[i].q_PB[index(joint)]),
              0.02);
    // Two at +-a: the standard deviation is a sqrt(2).
    EXPECT_NEAR(mean.spread[i][index(joint)], angle * std::numbers::sqrt2, 0.03);
    EXPECT_LT(mean.spread[i][index(Joint::kRightKnee)], 0.02);
  }
}

TEST(ExpertAverage, DoesNotDependOnPlaceAndFacingDirection) {
  const Motion squat = shipped("squat")->motion;
  Motion elsewhere = squat;
  for (Pose& pose : elsewhere.poses) {
    pose.p_WR += Eigen::Vector3d(3.0, -2.0, 0.0);
    pose.q_PB[0] = Eigen::AngleAxisd(2.5, Eigen::Vector3d::UnitZ()) * pose.q_PB[0];
  }
  const std::vector<Motion> experts{squat, elsewhere};
  const ExpertAverage mean = average_experts(experts, even(), 60.0);
  for (std::size_t i = 0; i < squat.poses.size(); ++i) {
    EXPECT_LT(geodesic_distance(mean.motion.poses[i].q_PB[0], squat.poses[i].q_PB[0]), 0.01);
    EXPECT_LT(mean.spread[i][0], 0.01);
    EXPECT_LT((mean.motion.poses[i].p_WR - squat.poses[i].p_WR).norm(), 0.02);
  }
}

TEST(ExpertAverage, LeavesOutWhatAnExpertDoesNotShow) {
  const Motion squat = shipped("squat")->motion;
  const std::size_t wrist = index(Joint::kLeftWrist);
  Motion blind = squat;
  for (Pose& pose : blind.poses) {
    pose.q_PB[wrist] = quaternion_from({1.0, 0.0, 0.0});
    pose.confidence[wrist] = 0.0F;
  }
  const std::vector<Motion> experts{blind, squat};
  const ExpertAverage mean = average_experts(experts, even(), 60.0);
  for (std::size_t i = 0; i < squat.poses.size(); ++i) {
    EXPECT_LT(geodesic_distance(mean.motion.poses[i].q_PB[wrist], squat.poses[i].q_PB[wrist]),
              0.05);
    EXPECT_GT(mean.motion.poses[i].confidence[wrist], 0.0F);
    EXPECT_EQ(mean.spread[i][wrist], 0.0);
  }
}

TEST(ExpertAverage, RefusesNoneAndOtherBodies) {
  EXPECT_THROW(average_experts({}, even(), 60.0), std::invalid_argument);
  const Motion stick{Skeleton({Segment{.name = "stick", .parent = std::nullopt}}), 60.0,
                     std::vector<Pose>(2, Pose(1))};
  EXPECT_THROW(average_experts({&stick, 1}, even(), 60.0), std::invalid_argument);
}

TEST(WarpOnto, IsMonotoneFromEndToEndAndFindsAKnownWarp) {
  const Motion block = shipped("low_block")->motion;
  const double height = 0.25;
  const Motion learner = bent(block, height);
  const std::vector<double> path = warp_onto(learner, block, even());
  ASSERT_EQ(path.size(), learner.poses.size());
  EXPECT_NEAR(path.front(), 0.0, 1e-9);
  EXPECT_NEAR(path.back(), static_cast<double>(block.poses.size() - 1), 1e-9);
  std::vector<double> off;
  for (std::size_t i = 1; i < path.size(); ++i) {
    EXPECT_GE(path[i], path[i - 1]);
    if (rms_distance(learner.poses[i], learner.poses[i - 1]) * 60.0 < 60.0 * kDegree) continue;
    const double x = static_cast<double>(i) / 60.0;
    const double truth = x + height * std::sin(std::numbers::pi * x / block.duration());
    off.push_back(std::fabs(path[i] / 60.0 - truth));
  }
  std::sort(off.begin(), off.end());
  EXPECT_LT(off[off.size() / 2], 0.02);
}

TEST(WarpOnto, TakesMotionsOfOnePose) {
  const Motion squat = shipped("squat")->motion;
  const Motion one = slice(squat, 0, 1);
  EXPECT_EQ(warp_onto(one, squat, even()).size(), 1U);
  const std::vector<double> path = warp_onto(squat, one, even());
  for (const double k : path) EXPECT_EQ(k, 0.0);
}

}  // namespace
}  // namespace secondskin::coach
