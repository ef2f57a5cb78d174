#include "coach/align/posture_offset.h"

#include <gtest/gtest.h>

#include "tests/coach_align/trials.h"

namespace secondskin::coach {
namespace {

class PostureOffsetTest : public ::testing::Test {
 protected:
  PostureOffsetTest() {
    posture_.clear();
    learner_.weight.fill(1.0F / kJointCount);
  }

  // Expert's poses at random, the learner's with an offset of each joint on its own side.
  void draw(double size) {
    for (std::size_t j = 0; j < kJointCount; ++j) {
      const Eigen::Quaterniond q = Eigen::Quaterniond::UnitRandom();
      const Eigen::Vector3d axis(normal_(random_), normal_(random_), normal_(random_));
      const Eigen::Quaterniond offset = quaternion_from(size * axis.normalized());
      expert_[j] = joint_feature(static_cast<Joint>(j), q);
      learner_.measured[j] = joint_feature(static_cast<Joint>(j), q * offset);
    }
  }

  // Between what is left without the posture and the expert [rad].
  double left(std::size_t j) const {
    const JointFeature f = posture_.without(j, learner_.measured[j]);
    double cosine = 0.0;
    for (std::size_t c = 0; c < 4; ++c) cosine += static_cast<double>(f[c]) * expert_[j][c];
    const bool tilt = j == index(Joint::kPelvis);
    return (tilt ? 1.0 : 2.0) * std::acos(std::min(tilt ? cosine : std::fabs(cosine), 1.0));
  }

  PostureOffset posture_;
  LearnerFeatures learner_;
  std::array<JointFeature, kJointCount> expert_{};
  std::mt19937 random_{3};
  std::normal_distribution<double> normal_;
};

TEST_F(PostureOffsetTest, ChangesNothingBeforeItHasLearned) {
  draw(0.3);
  for (std::size_t j = 0; j < kJointCount; ++j) {
    EXPECT_EQ(posture_.without(j, learner_.measured[j]), learner_.measured[j]);
  }
}

TEST_F(PostureOffsetTest, TakesMostOfAnOffsetOff) {
  for (int i = 0; i < 200; ++i) {
    posture_.clear();
    draw(20.0 * kDegree);
    posture_.learn(learner_, expert_, 1.0F);
    // 20 (6 / 20)^2 = 1.8 degrees are left to noise.
    for (std::size_t j = 1; j < kJointCount; ++j) EXPECT_NEAR(left(j), 1.8 * kDegree, 0.002);
    EXPECT_LT(left(0), 6.1 * kDegree);  // a tilt is smaller than the turn that it came from
  }
}

TEST_F(PostureOffsetTest, LeavesAnOffsetAloneThatMayBeNoise) {
  draw(5.5 * kDegree);
  posture_.learn(learner_, expert_, 1.0F);
  for (std::size_t j = 0; j < kJointCount; ++j) {
    for (std::size_t c = 0; c < 4; ++c) {
      EXPECT_NEAR(posture_.without(j, learner_.measured[j])[c], learner_.measured[j][c], 1e-6);
    }
  }
}

TEST_F(PostureOffsetTest, BelievesNoMoreThanThirtyDegrees) {
  draw(80.0 * kDegree);
  posture_.learn(learner_, expert_, 1.0F);
  for (std::size_t j = 1; j < kJointCount; ++j) EXPECT_GT(left(j), 50.0 * kDegree);
}

TEST_F(PostureOffsetTest, ForgetsWhenInDoubt) {
  draw(20.0 * kDegree);
  posture_.learn(learner_, expert_, 1.0F);
  for (int i = 0; i < 500; ++i) posture_.forget(0.02F);
  for (std::size_t j = 1; j < kJointCount; ++j) EXPECT_NEAR(left(j), 20.0 * kDegree, 0.002);
}

TEST_F(PostureOffsetTest, LeavesJointsAloneThatAreNotCompared) {
  draw(20.0 * kDegree);
  learner_.weight[index(Joint::kHead)] = 0.0F;
  expert_[index(Joint::kNeck)] = {};
  posture_.learn(learner_, expert_, 1.0F);
  for (const Joint j : {Joint::kHead, Joint::kNeck}) {
    EXPECT_EQ(posture_.without(index(j), learner_.measured[index(j)]), learner_.measured[index(j)]);
  }
}

}  // namespace
}  // namespace secondskin::coach
