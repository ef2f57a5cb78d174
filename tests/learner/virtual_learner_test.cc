#include "sim/learner/virtual_learner.h"

#include <gtest/gtest.h>

#include "motion/rotation.h"
#include "tests/coach_align/trials.h"

namespace secondskin::sim {
namespace {

using coach::kDegree;
using Amplitude = std::array<double, wire::kTactorCount>;

// Stands still; the wrong idea of it is the person's own.
Motion stand() {
  Motion motion{canonical_skeleton(), 60.0, {}};
  motion.poses.assign(121, Pose(kJointCount));
  return motion;
}

std::vector<WornTactor> arm() {
  std::vector<WornTactor> tactors;
  for (std::size_t c = 0; c < 8; ++c) {
    tactors.push_back({c, c < 4 ? Joint::kRightElbow : Joint::kRightShoulder,
                       0.5 * std::numbers::pi * static_cast<double>(c % 4)});
  }
  return tactors;
}

Lesson lesson(const Motion& motion) {
  Lesson lesson;
  lesson.reference = &motion;
  lesson.weight.fill(1.0);
  lesson.tactors = arm();
  return lesson;
}

LearnerParameters exact() {
  LearnerParameters p;
  p.bias = p.bias_of_quarter = p.noise = p.tremor = p.tempo = 0.0;
  p.missed = p.misread = p.misread_with_each = p.weber = p.reaction_deviation = 0.0;
  return p;
}

TEST(VirtualLearner, WithoutErrorsIsTheExpert) {
  const auto reference = coach::shipped("low_block");
  VirtualLearner learner(lesson(reference->motion), exact(), 1);
  learner.see(false);
  Pose expert(kJointCount);
  int compared = 0;
  for (int i = 0; i < 600; ++i) {
    const Pose& pose = learner.move(i / 60.0);
    ASSERT_TRUE(pose.is_valid());
    if (const auto at = learner.reference_time()) {
      sample(reference->motion, *at, expert);
      EXPECT_LT(coach::rms_distance(pose, expert), 1e-6);
      ++compared;
    }
  }
  EXPECT_GT(compared, 200);
  EXPECT_GE(learner.repetitions(), 1u);
}

TEST(VirtualLearner, IsTheSamePersonWithTheSameSeedOnly) {
  const Motion motion = stand();
  VirtualLearner one(lesson(motion), {}, 7), same(lesson(motion), {}, 7),
      other(lesson(motion), {}, 8);
  for (int i = 0; i < 300; ++i) {
    const Pose a = one.move(i / 60.0), b = same.move(i / 60.0), c = other.move(i / 60.0);
    EXPECT_EQ(coach::rms_distance(a, b), 0.0);
    EXPECT_GT(coach::rms_distance(a, c), 1.0 * kDegree);
  }
}

TEST(VirtualLearner, HasErrorsOfTheSizeThatItsParametersSay) {
  const Motion motion = stand();
  double square = 0.0;
  int count = 0;
  for (std::uint64_t seed = 0; seed < 400; ++seed) {
    LearnerParameters p = exact();
    p.bias = 10.0 * kDegree;
    VirtualLearner learner(lesson(motion), p, seed);
    const Pose& pose = learner.move(0.0);
    // The shoulder has three movements.
    square += rotation_vector(pose.q_PB[index(Joint::kRightShoulder)]).squaredNorm();
    // The knee has one that counts, or less than three.
    EXPECT_TRUE(pose.is_valid());
    ++count;
  }
  EXPECT_NEAR(std::sqrt(square / count / 3.0) / kDegree, 10.0, 0.7);
}

// Degrees that a joint has moved after two seconds of one tactor.
Eigen::Vector3d moved(std::size_t channel, Joint joint, bool repulsive, double strength,
                      double until = 1.0) {
  const Motion motion = stand();
  Lesson told = lesson(motion);
  told.repulsive = repulsive;
  VirtualLearner learner(told, exact(), 1);
  learner.see(false);
  Pose pose;
  for (int i = 0; i < static_cast<int>(until * 60.0); ++i) {
    Amplitude level{};
    level[channel] = strength;
    pose = learner.move(i / 60.0);
    for (int k = 1; k <= 8; ++k) learner.feel((i + k / 8.0) / 60.0, level);
  }
  return rotation_vector(pose.q_PB[index(joint)]) / kDegree;
}

TEST(VirtualLearner, MovesTheLimbAwayFromTheVibrationOrTowardsIt) {
  const Skeleton body = canonical_skeleton();
  for (std::size_t c = 4; c < 8; ++c) {
    const double angle = arm()[c].angle;
    const Eigen::Vector3d outward(std::cos(angle), std::sin(angle), 0.0);
    for (const bool repulsive : {true, false}) {
      const Eigen::Vector3d v = moved(c, Joint::kRightShoulder, repulsive, 1.0);
      const Eigen::Vector3d way = v.cross(body[index(Joint::kRightShoulder)].p_BE);
      EXPECT_GT((repulsive ? -1.0 : 1.0) * way.normalized().dot(outward), 0.99) << c;
      EXPECT_GT(v.norm(), 5.0);
    }
  }
  EXPECT_TRUE(moved(4, Joint::kRightElbow, true, 1.0).isZero(1e-9)) << "only the cued joint moves";
}

TEST(VirtualLearner, DoesNotMoveBeforeItsReactionTimeNorForADeadTactor) {
  EXPECT_TRUE(moved(4, Joint::kRightShoulder, true, 1.0, 0.38).isZero(1e-9));
  EXPECT_FALSE(moved(4, Joint::kRightShoulder, true, 1.0, 0.60).isZero(1e-3));
  EXPECT_TRUE(moved(4, Joint::kRightShoulder, true, 0.0).isZero(1e-9));
  EXPECT_TRUE(moved(12, Joint::kRightShoulder, true, 1.0).isZero(1e-9)) << "not worn";
}

TEST(VirtualLearner, AStrongerCueIsFollowedFurther) {
  double last = 0.0;
  for (const double strength : {0.3, 0.5, 0.7, 1.0}) {
    const double now = moved(4, Joint::kRightShoulder, true, strength).norm();
    EXPECT_GT(now, last);
    last = now;
  }
}

TEST(VirtualLearner, DoesNotDoWhatAJointCannot) {
  // A forearm does not move sideways against the upper arm.
  EXPECT_TRUE(moved(1, Joint::kRightElbow, true, 1.0).isZero(1e-9));
  EXPECT_FALSE(moved(2, Joint::kRightElbow, true, 1.0).isZero(1e-3));
}

TEST(VirtualLearner, LearnsALittleFromSeeingAndNothingWithout) {
  const auto late_error = [](bool sees) {
    const Motion motion = stand();
    LearnerParameters p;
    p.noise = p.tremor = 0.0;
    VirtualLearner learner(lesson(motion), p, 3);
    learner.see(sees);
    double first = 0.0, last = 0.0;
    for (int i = 0; learner.repetitions() < 30; ++i) {
      const double e = coach::rms_distance(learner.move(i / 60.0), motion.poses[0]);
      if (learner.repetitions() == 0) first = e;
      last = e;
    }
    return last / first;
  };
  EXPECT_LT(late_error(true), 0.95);
  EXPECT_NEAR(late_error(false), 1.0, 0.01);
}

}  // namespace
}  // namespace secondskin::sim
