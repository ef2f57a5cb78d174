#include "sim/learner/motor_memory.h"

#include <gtest/gtest.h>

namespace secondskin::sim {
namespace {

const Eigen::Vector3d kBend(0.0, 0.2, 0.0);
constexpr std::size_t kElbow = index(Joint::kRightElbow);

// Repetitions in which whatever is still missing of `wanted` is found out.
void practise(MotorMemory& memory, int repetitions, const Eigen::Vector3d& wanted, bool by_touch) {
  for (int n = 0; n < repetitions; ++n) {
    for (const double share : {0.1, 0.4, 0.6, 0.9}) {
      memory.note(kElbow, share, wanted - memory.correction(kElbow, share, by_touch), by_touch);
    }
    memory.learn(by_touch);
  }
}

TEST(Quarters, SumToOneEverywhere) {
  for (double share = -0.2; share <= 1.2; share += 0.01) {
    double sum = 0.0;
    for (const double hat : quarters_at(share)) {
      EXPECT_GE(hat, 0.0);
      sum += hat;
    }
    EXPECT_NEAR(sum, 1.0, 1e-12);
  }
}

TEST(MotorMemory, GoesWhereTheTwoRateModelGoes) {
  // Smith et al. 2006: with x = k e, k = B_f / (1 - A_f) + B_s / (1 - A_s), and e = p - x, the end
  // is x = p k / (1 + k).
  const LearnerParameters p;
  MotorMemory memory(p);
  practise(memory, 3000, kBend, false);
  const double k = p.fast_rate / (1.0 - p.fast_retention) + p.slow_rate / (1.0 - p.slow_retention);
  EXPECT_NEAR(memory.correction(kElbow, 0.5, false).y(), 0.2 * k / (1.0 + k), 2e-3);
  EXPECT_NEAR(k / (1.0 + k), 0.751, 1e-3);
}

TEST(MotorMemory, LearnsFasterAtFirst) {
  MotorMemory memory({});
  double last = 0.0, gain = 1.0;
  for (int n = 0; n < 30; ++n) {
    practise(memory, 1, kBend, false);
    const double now = memory.correction(kElbow, 0.5, false).y();
    EXPECT_GT(now, last);
    EXPECT_LT(now - last, gain + 1e-6);
    gain = now - last;
    last = now;
  }
}

TEST(MotorMemory, ForgetsMostOfTheFastPartInAPauseAndTheRestSlowly) {
  MotorMemory memory({});
  practise(memory, 20, kBend, false);
  const double before = memory.correction(kElbow, 0.5, false).y();
  MotorMemory minutes = memory, day = memory;
  minutes.rest(600.0);
  day.rest(86'400.0);
  const double soon = minutes.correction(kElbow, 0.5, false).y();
  const double late = day.correction(kElbow, 0.5, false).y();
  EXPECT_LT(soon, 0.9 * before);
  EXPECT_GT(soon, 0.2 * before);
  EXPECT_LT(late, 0.5 * soon);
  EXPECT_GT(late, 0.0);
}

TEST(MotorMemory, RepetitionsWithoutNewsForgetToo) {
  MotorMemory memory({});
  practise(memory, 20, kBend, false);
  const double before = memory.correction(kElbow, 0.5, false).y();
  for (int n = 0; n < 5; ++n) memory.learn(false);
  EXPECT_LT(memory.correction(kElbow, 0.5, false).y(), before);
}

TEST(MotorMemory, WhoIsAlwaysCuedComesToDependOnItAndWhoSeesDoesNot) {
  MotorMemory cued({}), seen({});
  practise(cued, 30, kBend, true);
  practise(seen, 30, kBend, false);
  EXPECT_GT(cued.dependence(), 0.9);
  EXPECT_EQ(seen.dependence(), 0.0);
  EXPECT_NEAR(cued.correction(kElbow, 0.5, true).y(), seen.correction(kElbow, 0.5, false).y(), 1e-9)
      << "with its cues the one is as good as the other";
  EXPECT_LT(cued.correction(kElbow, 0.5, false).y(), 0.8 * seen.correction(kElbow, 0.5, false).y());
  const double bound = cued.dependence();
  for (int n = 0; n < 10; ++n) cued.learn(false);
  EXPECT_LT(cued.dependence(), 0.5 * bound);
}

TEST(MotorMemory, FadedCuesLeaveMoreThanConstantOnes) {
  const auto without_cues = [](int cued_in) {
    MotorMemory memory({});
    for (int n = 0; n < 40; ++n) {
      // The same is found out, by touch in some repetitions, else by sight.
      practise(memory, 1, kBend, n % 4 < cued_in);
    }
    return memory.correction(kElbow, 0.5, false).y();
  };
  EXPECT_GT(without_cues(1), without_cues(2));
  EXPECT_GT(without_cues(2), without_cues(4));
}

TEST(MotorMemory, LearnsEachQuarterAndJointForItself) {
  MotorMemory memory({});
  for (int n = 0; n < 10; ++n) {
    memory.note(kElbow, 0.125, kBend, false);
    memory.learn(false);
  }
  EXPECT_GT(memory.correction(kElbow, 0.1, false).y(), 0.01);
  EXPECT_EQ(memory.correction(kElbow, 0.9, false).y(), 0.0);
  EXPECT_EQ(memory.correction(kElbow + 1, 0.1, false).y(), 0.0);
}

}  // namespace
}  // namespace secondskin::sim
