#include "coach/correct/habit.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <random>

namespace secondskin::coach {
namespace {

constexpr std::size_t kJoint = index(Joint::kLeftElbow);

// One pass through a motion of two seconds at 60 frames a second.
template <class Error>
void pass(Habit& habit, double tempo, Error error) {
  for (double t = 0.0; t <= 2.0; t += tempo / 60.0) {
    JointVectors errors = zero_vectors();
    errors[kJoint] = error(t);
    habit.note(t, errors);
  }
}

Eigen::Vector3d wave(double t) { return {0.3 * std::sin(3.0 * t), 0.1, -0.2 * std::cos(3.0 * t)}; }

TEST(Habit, KnowsNothingAtFirst) {
  const Habit habit(2.0);
  EXPECT_EQ(habit.known(1.0), 0.0);
  EXPECT_TRUE(habit.at(1.0, kJoint).isZero());
}

TEST(Habit, ComesToKnowWhatIsRepeatedWhereverAndHoweverFastItIsDone) {
  for (const double tempo : {0.5, 1.0, 2.0}) {
    Habit habit(2.0);
    double last = 0.0;
    for (int repetition = 0; repetition < 12; ++repetition) {
      pass(habit, tempo, wave);
      EXPECT_GT(habit.known(1.0), last);
      last = habit.known(1.0);
    }
    EXPECT_GT(last, 0.98);
    for (double t = 0.1; t < 1.95; t += 0.05) {
      EXPECT_LT((habit.at(t, kJoint) - wave(t)).norm(), 0.03) << t << " s, tempo " << tempo;
    }
    EXPECT_TRUE(habit.at(1.0, kJoint + 1).isZero()) << "the other joints";
  }
}

TEST(Habit, IsDrawnToZeroAsFarAsItIsNotKnown) {
  Habit habit(2.0);
  const Eigen::Vector3d always(0.0, 0.2, 0.0);
  for (int repetition = 0; repetition < 4; ++repetition) {
    pass(habit, 1.0, [&](double) { return always; });
    EXPECT_LT((habit.at(1.0, kJoint) - habit.known(1.0) * always).norm(), 1e-12);
  }
}

TEST(Habit, AveragesWhatIsNotUsual) {
  std::mt19937_64 random(4);
  std::normal_distribution<double> normal(0.0, 0.1);
  Habit habit(2.0);
  double squares = 0.0;
  int count = 0;
  for (int repetition = 0; repetition < 60; ++repetition) {
    const Eigen::Vector3d error(normal(random), 0.0, 0.0);
    pass(habit, 1.0, [&](double) { return error; });
    if (repetition < 10) continue;
    squares += habit.at(1.0, kJoint).squaredNorm();
    ++count;
  }
  // An exponential mean that takes in a share g has g / (2 - g) of the variance: half, for 0.4.
  EXPECT_LT(std::sqrt(squares / count), 0.7 * 0.1);
}

TEST(Habit, LearnsNothingFromStandingStillJumpsOrWhatIsNoNumber) {
  Habit habit(2.0);
  JointVectors errors = zero_vectors();
  errors[kJoint] = {0.5, 0.0, 0.0};
  for (int i = 0; i < 1000; ++i) habit.note(1.0, errors);
  for (int i = 0; i < 1000; ++i) habit.note(i % 2 == 0 ? 0.2 : 1.8, errors);
  habit.note(std::numeric_limits<double>::quiet_NaN(), errors);
  EXPECT_TRUE(habit.at(1.0, kJoint).isZero());
  EXPECT_EQ(habit.known(1.0), 0.0);
  errors[kJoint].x() = std::numeric_limits<double>::quiet_NaN();
  pass(habit, 1.0, [&](double) { return errors[kJoint]; });
  for (double t = -1.0; t < 3.0; t += 0.1) EXPECT_TRUE(habit.at(t, kJoint).allFinite());
}

}  // namespace
}  // namespace secondskin::coach
