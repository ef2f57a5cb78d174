#include "coach/align/likeness.h"

#include <gtest/gtest.h>

#include "coach/align/learner_stream.h"
#include "tests/coach_align/trials.h"

namespace secondskin::coach {
namespace {

// The learner's pose at each frame of the reference, made by `change` from the expert's.
template <class Change>
Likeness::Value likeness(const std::shared_ptr<const Reference>& reference, Change&& change) {
  Likeness likeness(*reference);
  const ReferenceFeatures features(*reference, 1);
  PostureOffset posture;
  posture.clear();
  LearnerStream stream;
  LearnerFeatures learner;
  const auto& expert = reference->motion.poses;
  for (std::size_t i = 0; i < expert.size(); ++i) {
    Pose pose = expert[i];
    change(pose, i);
    EXPECT_TRUE(stream.take(static_cast<double>(i) / kReferenceRate, pose, features.weight(),
                            posture, learner));
    likeness.add(learner, static_cast<double>(i), 1.0 / kReferenceRate);
  }
  EXPECT_NEAR(likeness.time(), static_cast<double>(expert.size()) / kReferenceRate, 1e-6);
  return likeness.value();
}

TEST(Likeness, IsOneForTheExpert) {
  const auto v = likeness(shipped("low_block"), [](Pose&, std::size_t) {});
  EXPECT_NEAR(v.correlation, 1.0, 1e-6);
  EXPECT_NEAR(v.least, 1.0, 1e-6);
  EXPECT_NEAR(v.learner, v.expert, 1e-6);
}

TEST(Likeness, DoesNotMindAPostureOrALimbTurnedAboutItself) {
  std::mt19937 random(1);
  std::normal_distribution<double> normal;
  std::vector<Eigen::Quaterniond> offset(kJointCount);
  for (auto& q : offset) {
    q = quaternion_from({0.1 * normal(random), 0.1 * normal(random), 0.4 * normal(random)});
  }
  const auto v = likeness(shipped("low_block"), [&](Pose& pose, std::size_t) {
    for (std::size_t j = 1; j < kJointCount; ++j) pose.q_PB[j] = pose.q_PB[j] * offset[j];
  });
  EXPECT_GT(v.correlation, 0.93);
  EXPECT_GT(v.least, 0.9);
}

TEST(Likeness, DoesNotMindASmallerRangeOfMotion) {
  const auto reference = shipped("deep_squat");
  const Pose first = reference->motion.poses.front();
  const auto v = likeness(reference, [&](Pose& pose, std::size_t) {
    Pose half(kJointCount);
    interpolate(first, pose, 0.5, half);
    pose = half;
  });
  // A limb's direction goes round an arc, and half the arc is less bent.
  EXPECT_GT(v.correlation, 0.88);
  EXPECT_NEAR(v.learner / v.expert, 0.5, 0.05);
}

// One arm does what it should a second later.
TEST(Likeness, TellsALimbThatGoesItsOwnWay) {
  const auto reference = shipped("low_block");
  const auto v = likeness(reference, [&](Pose& pose, std::size_t i) {
    const auto& other = reference->motion.poses[(i + 60) % reference->motion.poses.size()];
    for (const Joint j : {Joint::kRightShoulder, Joint::kRightElbow, Joint::kRightWrist}) {
      pose.q_PB[index(j)] = other.q_PB[index(j)];
    }
  });
  EXPECT_LT(v.least, 0.7);
  EXPECT_GT(v.correlation, v.least + 0.1);
}

TEST(Likeness, ForgetsWhatFaded) {
  const auto reference = shipped("low_block");
  Likeness likeness(*reference);
  LearnerFeatures learner;
  learner.weight.fill(1.0F / kJointCount);
  learner.measured.fill({1.0F, 0.0F, 0.0F, 0.0F});
  likeness.add(learner, 0.0, 2.0);
  likeness.fade(0.25);
  EXPECT_DOUBLE_EQ(likeness.time(), 0.5);
  likeness.clear();
  EXPECT_EQ(likeness.time(), 0.0);
  EXPECT_EQ(likeness.value().correlation, 0.0);
}

}  // namespace
}  // namespace secondskin::coach
