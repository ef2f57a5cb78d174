#include "coach/correct/correction.h"

#include <gtest/gtest.h>

#include <limits>

#include "motion/kinematics.h"
#include "problems.h"

namespace secondskin::coach {
namespace {

constexpr SolveLimit kNoHurry{.deadline = 10.0, .iterations = std::nullopt};

CorrectionProblem learner_at_rest() {
  CorrectionProblem problem;
  problem.learner = Pose(kJointCount);
  problem.reference_time = 5.0;
  return problem;
}

void bend(Pose& pose, Joint joint, const JointAngles& angles) {
  pose.q_PB[index(joint)] = joint_rotation(joint, angles);
}

bool same(const CorrectionResult& a, const CorrectionResult& b) {
  return a.frame == b.frame && a.status == b.status && a.target == b.target &&
         a.benefit == b.benefit && a.iterations == b.iterations;
}

TEST(JointErrors, AreTheTurnFromTheLearnerToTheExpert) {
  std::mt19937 generator(1);
  const Reference reference = moving_reference();
  for (int draw = 0; draw < 100; ++draw) {
    const CorrectionProblem problem = random_problem(generator);
    JointVectors error;
    joint_errors(reference, problem.reference_time, problem.learner, error);
    Pose expert(kJointCount);
    sample(reference.motion, problem.reference_time, expert);
    for (std::size_t j = 1; j < kJointCount; ++j) {
      const Eigen::Quaterniond reached = problem.learner.q_PB[j] * quaternion_from(error[j]);
      EXPECT_LT(geodesic_distance(reached, expert.q_PB[j]), 1e-6);
    }
    const Eigen::Quaterniond pelvis = problem.learner.q_PB[0] * quaternion_from(error[0]);
    const Eigen::Vector3d up = pelvis.conjugate() * Eigen::Vector3d::UnitZ();
    const Eigen::Vector3d up_expert = expert.q_PB[0].conjugate() * Eigen::Vector3d::UnitZ();
    EXPECT_LT((up - up_expert).norm(), 1e-9);
  }
}

TEST(JointErrors, SeeNoHeadingInThePelvis) {
  const Reference reference = still_reference(Pose(kJointCount));
  Pose learner(kJointCount);
  learner.q_PB[0] = Eigen::AngleAxisd(2.5, Eigen::Vector3d::UnitZ());
  JointVectors error;
  joint_errors(reference, 1.0, learner, error);
  EXPECT_LT(error[0].norm(), 1e-9);
  learner.q_PB[0] = learner.q_PB[0] * Eigen::AngleAxisd(0.3, Eigen::Vector3d::UnitY());
  joint_errors(reference, 1.0, learner, error);
  EXPECT_LT((error[0] - Eigen::Vector3d(0.0, -0.3, 0.0)).norm(), 1e-9);
  // Upside down there is no shortest way, but still a way.
  learner.q_PB[0] = Eigen::Quaterniond(0.0, 1.0, 0.0, 0.0);
  joint_errors(reference, 1.0, learner, error);
  EXPECT_NEAR(error[0].norm(), std::numbers::pi, 1e-9);
}

TEST(JointErrors, AreZeroWhereNothingIsMeasuredOrWanted) {
  Reference reference = still_reference(Pose(kJointCount));
  reference.weight[3] = 0.0;
  reference.motion.poses[60].confidence[5] = 0.0f;
  Pose learner(kJointCount);
  for (Eigen::Quaterniond& q : learner.q_PB) q = quaternion_from({0.4, 0.1, 0.0});
  learner.confidence[1] = 0.0f;
  learner.q_PB[2].x() = std::numeric_limits<double>::quiet_NaN();
  JointVectors error;
  joint_errors(reference, 1.0, learner, error);
  for (const std::size_t j : {1u, 2u, 3u, 5u}) EXPECT_TRUE(error[j].isZero());
  EXPECT_FALSE(error[4].isZero());
}

TEST(CorrectionSolver, AsksNothingOfALearnerWithoutError) {
  const auto reference = shared(moving_reference());
  CorrectionSolver solver(reference, canonical_skeleton(1.6));
  for (double t = 0.0; t < 9.0; t += 0.5) {
    const auto result = solver.solve(swinging_problem(*reference, t, 0.0), kNoHurry);
    EXPECT_EQ(result.status, SolverStatus::kConverged);
    EXPECT_EQ(asked_count(result), 0u);
  }
}

TEST(CorrectionSolver, AsksNothingInsideTheDeadBand) {
  const auto reference = shared(still_reference(Pose(kJointCount)));
  CorrectionSolver solver(reference, canonical_skeleton());
  CorrectionProblem problem = learner_at_rest();
  for (std::size_t j = 0; j < kJointCount; ++j) {
    problem.learner.q_PB[j] = quaternion_from({0.0, 9.0 * kDegree, 0.0});
  }
  EXPECT_EQ(asked_count(solver.solve(problem, kNoHurry)), 0u);
}

// docs/correction.md, eq. 5b: what is usual comes back, what is not fades.
TEST(CorrectionSolver, ExpectsWhatIsUsualAndLittleOfWhatIsNot) {
  const auto reference = shared(still_reference(Pose(kJointCount)));
  CorrectionSolver solver(reference, canonical_skeleton());
  constexpr std::size_t kElbow = index(Joint::kLeftElbow);
  const Eigen::Vector3d thirty(0.0, -30.0 * kDegree, 0.0);
  const auto habit_of = [&](const Eigen::Vector3d& error) {
    Habit habit(reference->motion.duration());
    JointVectors errors = zero_vectors();
    errors[kElbow] = error;
    for (int repetition = 0; repetition < 20; ++repetition) {
      for (double t = 0.0; t < reference->motion.duration(); t += 0.02) habit.note(t, errors);
    }
    return habit;
  };
  CorrectionProblem problem = learner_at_rest();
  problem.reference_time = 0.5;
  problem.learner.q_PB[kElbow] = quaternion_from(-thirty);
  const auto first = solver.solve(problem, kNoHurry);
  EXPECT_LT((first.expected[kElbow] - thirty).norm(), 1e-6) << "nothing is known: the error stays";

  problem.habit = habit_of(thirty);
  const auto usual = solver.solve(problem, kNoHurry);
  EXPECT_LT((usual.expected[kElbow] - thirty).norm(), 0.5 * kDegree);
  EXPECT_LT((usual.target[kElbow] - first.target[kElbow]).norm(), 1.0 * kDegree);

  problem.habit = habit_of(Eigen::Vector3d::Zero());
  const auto unusual = solver.solve(problem, kNoHurry);
  EXPECT_LT(unusual.target[kElbow].norm(), 0.5 * first.target[kElbow].norm());

  // Not wrong yet, but about to be.
  problem.habit = habit_of(thirty);
  problem.learner.q_PB[kElbow].setIdentity();
  const auto coming = solver.solve(problem, kNoHurry);
  EXPECT_GT(coming.expected[kElbow].dot(thirty.normalized()), 15.0 * kDegree);
  EXPECT_GT(coming.target[kElbow].dot(thirty), 0.0);
}

struct OneError {
  Joint joint;
  JointAngles learner;
};
class SingleJoint : public testing::TestWithParam<OneError> {};

// Forty degrees off in one joint: that joint is asked back, nothing else.
TEST_P(SingleJoint, IsAskedBackAlone) {
  const auto [joint, angles] = GetParam();
  const auto reference = shared(still_reference(Pose(kJointCount)));
  CorrectionSolver solver(reference, canonical_skeleton(1.9));
  CorrectionProblem problem = learner_at_rest();
  bend(problem.learner, joint, angles);
  JointVectors error;
  joint_errors(*reference, problem.reference_time, problem.learner, error);
  const auto result = solver.solve(problem, kNoHurry);
  ASSERT_EQ(result.status, SolverStatus::kConverged);
  EXPECT_EQ(asked_count(result), 1u);
  const Eigen::Vector3d& target = result.target[index(joint)];
  const Eigen::Vector3d& e = error[index(joint)];
  EXPECT_GT(target.dot(e), 0.95 * target.norm() * e.norm());
  EXPECT_GT(target.norm(), 20.0 * kDegree);  // out of the dead band, less the price
  EXPECT_LT(target.norm(), 42.0 * kDegree);
  EXPECT_GT(result.benefit[index(joint)], 0.8);
}

INSTANTIATE_TEST_SUITE_P(Joints, SingleJoint,
                         testing::Values(OneError{Joint::kLeftElbow, {40 * kDegree, 0, 0}},
                                         OneError{Joint::kRightElbow, {0, 0, -40 * kDegree}},
                                         OneError{Joint::kLeftShoulder, {0, 40 * kDegree, 0}},
                                         OneError{Joint::kRightShoulder, {40 * kDegree, 0, 0}},
                                         OneError{Joint::kRightShoulder, {0, 0, 40 * kDegree}},
                                         OneError{Joint::kRightKnee, {40 * kDegree, 0, 0}},
                                         OneError{Joint::kLeftHip, {40 * kDegree, 0, 0}},
                                         OneError{Joint::kRightHip, {0, 0, -40 * kDegree}},
                                         OneError{Joint::kSpineLower, {40 * kDegree, 0, 0}},
                                         OneError{Joint::kHead, {0, 0, 40 * kDegree}},
                                         OneError{Joint::kPelvis, {40 * kDegree, 0, 0}},
                                         OneError{Joint::kRightWrist, {-40 * kDegree, 0, 0}}));

TEST(CorrectionSolver, AsksTwoJointsWhenTwoAreWrong) {
  CorrectionSolver solver(shared(still_reference(Pose(kJointCount))), canonical_skeleton());
  CorrectionProblem problem = learner_at_rest();
  bend(problem.learner, Joint::kLeftElbow, {40 * kDegree, 0, 0});
  bend(problem.learner, Joint::kRightKnee, {35 * kDegree, 0, 0});
  bend(problem.learner, Joint::kNeck, {9 * kDegree, 0, 0});
  const auto result = solver.solve(problem, kNoHurry);
  EXPECT_EQ(asked_count(result), 2u);
  EXPECT_FALSE(result.target[index(Joint::kLeftElbow)].isZero());
  EXPECT_FALSE(result.target[index(Joint::kRightKnee)].isZero());
}

TEST(CorrectionSolver, ValuesAJointByWhatItCarries) {
  CorrectionSolver solver(shared(still_reference(Pose(kJointCount))), canonical_skeleton());
  CorrectionProblem problem = learner_at_rest();
  bend(problem.learner, Joint::kLeftShoulder, {0, 22 * kDegree, 0});
  bend(problem.learner, Joint::kLeftElbow, {24 * kDegree, 0, 0});  // the larger error
  const auto result = solver.solve(problem, kNoHurry);
  EXPECT_GT(result.benefit[index(Joint::kLeftShoulder)], result.benefit[index(Joint::kLeftElbow)]);
}

TEST(CorrectionSolver, LeavesJointsAloneThatAreUnmeasuredUnwantedOrNoNumbers) {
  Reference reference = still_reference(Pose(kJointCount));
  reference.weight[index(Joint::kRightKnee)] = 0.0;
  CorrectionSolver solver(shared(reference), canonical_skeleton());
  CorrectionProblem problem = learner_at_rest();
  bend(problem.learner, Joint::kLeftElbow, {60 * kDegree, 0, 0});
  problem.learner.confidence[index(Joint::kLeftElbow)] = 0.0f;
  bend(problem.learner, Joint::kRightKnee, {60 * kDegree, 0, 0});
  bend(problem.learner, Joint::kLeftHip, {40 * kDegree, 0, 0});
  problem.learner.q_PB[index(Joint::kRightShoulder)].coeffs().setConstant(
      std::numeric_limits<double>::quiet_NaN());
  problem.velocity[index(Joint::kLeftHip)].setConstant(std::numeric_limits<double>::infinity());
  const auto result = solver.solve(problem, kNoHurry);
  EXPECT_EQ(result.status, SolverStatus::kConverged);
  EXPECT_EQ(asked_count(result), 1u);
  EXPECT_FALSE(result.target[index(Joint::kLeftHip)].isZero());
  for (const Eigen::Vector3d& v : result.target) EXPECT_TRUE(v.allFinite());
}

TEST(CorrectionSolver, AnswersANonsenseProblemWithNothing) {
  CorrectionSolver solver(shared(still_reference(Pose(kJointCount))), canonical_skeleton());
  CorrectionProblem problem;  // no joints
  EXPECT_EQ(solver.solve(problem).status, SolverStatus::kFallback);
  problem = learner_at_rest();
  problem.tempo = std::numeric_limits<double>::quiet_NaN();
  const auto result = solver.solve(problem);
  EXPECT_EQ(result.status, SolverStatus::kFallback);
  EXPECT_EQ(asked_count(result), 0u);
}

TEST(CorrectionSolver, AsksAtMostSoManyJointsAndNoneThatMayNotBeAsked) {
  std::mt19937 generator(8);
  std::bernoulli_distribution coin;
  Reference given = moving_reference();
  given.standing = true;
  const auto reference = shared(given);
  for (const std::size_t most : {0u, 1u, 2u, 3u, 5u}) {
    CorrectionOptions options;
    options.max_joints = most;
    CorrectionSolver solver(reference, canonical_skeleton(1.6), options);
    std::size_t largest = 0;
    for (int draw = 0; draw < 40; ++draw) {
      CorrectionProblem problem = random_problem(generator);
      for (std::size_t j = 0; j < kJointCount; ++j) problem.askable[j] = coin(generator);
      SolveLimit limit = kNoHurry;
      if (draw % 4 == 3) limit.iterations = draw % 5;
      const auto result = solver.solve(problem, limit);
      ASSERT_LE(asked_count(result), most);
      for (std::size_t j = 0; j < kJointCount; ++j) {
        ASSERT_TRUE(problem.askable[j] || result.target[j].isZero());
      }
      largest = std::max(largest, asked_count(result));
    }
    EXPECT_EQ(largest, most);
  }
}

// A trunk that leans carries both arms and the head along: their errors are the trunk's.
TEST(CorrectionSolver, AsksTheCauseRatherThanTheLargestErrors) {
  CorrectionOptions one;
  one.max_joints = 1;
  CorrectionSolver solver(shared(still_reference(Pose(kJointCount))), canonical_skeleton(), one);
  CorrectionProblem problem = learner_at_rest();
  bend(problem.learner, Joint::kSpineLower, {24 * kDegree, 0, 0});
  bend(problem.learner, Joint::kRightAnkle, {27 * kDegree, 0, 0});
  const auto result = solver.solve(problem, kNoHurry);
  EXPECT_FALSE(result.target[index(Joint::kSpineLower)].isZero());
  EXPECT_EQ(asked_count(result), 1u);
}

// The chosen joints are asked for what serves best, not for less because asking has a price.
TEST(CorrectionSolver, AsksForTheWholeAmount) {
  CorrectionSolver solver(shared(still_reference(Pose(kJointCount))), canonical_skeleton());
  CorrectionProblem problem = learner_at_rest();
  bend(problem.learner, Joint::kLeftElbow, {40 * kDegree, 0, 0});
  const auto result = solver.solve(problem, kNoHurry);
  EXPECT_GT(result.target[index(Joint::kLeftElbow)].norm(), 29 * kDegree);  // the band is 10 wide
}

TEST(CorrectionSolver, NeverLeavesTheJointsLimits) {
  std::mt19937 generator(2);
  const auto reference = shared(moving_reference());
  CorrectionSolver solver(reference, canonical_skeleton(1.6));
  std::uniform_int_distribution<std::uint32_t> iterations(0, 12);
  for (int draw = 0; draw < 300; ++draw) {
    const CorrectionProblem problem = random_problem(generator);
    SolveLimit limit = kNoHurry;
    if (draw % 2 == 1) limit.iterations = iterations(generator);
    const auto result = solver.solve(problem, limit);
    for (std::size_t j = 1; j < kJointCount; ++j) {
      const auto joint = static_cast<Joint>(j);
      const JointAngles before = joint_angles(joint, problem.learner.q_PB[j]);
      const JointAngles after =
          joint_angles(joint, problem.learner.q_PB[j] * quaternion_from(result.target[j]));
      for (std::size_t m = 0; m < 3; ++m) {
        const AngleRange range = canonical_anatomy()[j].range[m];
        ASSERT_GE(after[m], std::min(range.min, before[m]) - 1e-6) << joint_name(joint);
        ASSERT_LE(after[m], std::max(range.max, before[m]) + 1e-6) << joint_name(joint);
      }
      ASSERT_GE(result.benefit[j], 0.0);
      ASSERT_LE(result.benefit[j], 1.0);
    }
  }
}

TEST(CorrectionSolver, AsksNoFasterMovementThanAPersonCanMake) {
  CorrectionOptions hurried;
  hurried.horizon = 0.05;
  CorrectionSolver solver(shared(still_reference(Pose(kJointCount))), canonical_skeleton(),
                          hurried);
  CorrectionProblem problem = learner_at_rest();
  bend(problem.learner, Joint::kLeftElbow, {90 * kDegree, 0, 0});
  const auto result = solver.solve(problem, kNoHurry);
  const double fastest = canonical_anatomy()[index(Joint::kLeftElbow)].max_speed[0];
  const double asked = result.target[index(Joint::kLeftElbow)].norm();
  // The peak of a minimum-jerk movement is 1.875 times its mean speed.
  EXPECT_LE(asked * 1.875 / hurried.horizon, fastest * (1.0 + 1e-9));
  EXPECT_GT(asked, 0.5 * fastest * hurried.horizon / 1.875);
}

// The expert leans far forward. A standing learner may follow only as far as the feet carry.
TEST(CorrectionSolver, KeepsAStandingLearnerOverTheFeet) {
  Pose leaning(kJointCount);
  bend(leaning, Joint::kPelvis, {45 * kDegree, 0, 0});
  bend(leaning, Joint::kSpineLower, {60 * kDegree, 0, 0});
  for (const Joint hip : {Joint::kLeftHip, Joint::kRightHip})
    bend(leaning, hip, {45 * kDegree, 0, 0});
  Reference reference = still_reference(leaning);
  const Skeleton body = canonical_skeleton();
  const auto overhang = [&](bool standing) {
    reference.standing = standing;
    CorrectionSolver solver(shared(reference), body);
    const CorrectionProblem problem = learner_at_rest();
    const auto result = solver.solve(problem, kNoHurry);
    EXPECT_NE(result.status, SolverStatus::kFallback);
    Pose corrected = problem.learner;
    for (std::size_t j = 0; j < kJointCount; ++j) {
      corrected.q_PB[j] = corrected.q_PB[j] * quaternion_from(result.target[j]);
    }
    std::vector<Eigen::Isometry3d> X_WB(kJointCount);
    forward_kinematics(body, corrected.p_WR, corrected.q_PB, X_WB);
    double front = -1.0;
    for (const Joint ankle : {Joint::kLeftAnkle, Joint::kRightAnkle}) {
      front = std::max(front, (X_WB[index(ankle)] * body[index(ankle)].p_BE).x());
    }
    return centre_of_mass(body, X_WB).x() - front;
  };
  EXPECT_GT(overhang(false), 0.01);
  EXPECT_LT(overhang(true), 0.002);
}

TEST(CorrectionSolver, GivesTheLastFeasibleIterateAtTheDeadline) {
  const auto reference = shared(moving_reference());
  CorrectionSolver solver(reference, canonical_skeleton());
  const SolveLimit at_once{.deadline = 0.0, .iterations = std::nullopt};
  const auto cold = solver.solve(swinging_problem(*reference, 2.0, 0.4), at_once);
  EXPECT_EQ(cold.status, SolverStatus::kDeadline);  // where the selection let it start
  EXPECT_EQ(cold.iterations, 0u);
  EXPECT_GE(asked_count(cold), 1u);
  EXPECT_LE(asked_count(cold), 2u);
  EXPECT_EQ(solver.solve(swinging_problem(*reference, 2.0, 0.4), kNoHurry).status,
            SolverStatus::kConverged);
  const auto warm = solver.solve(swinging_problem(*reference, 2.02, 0.4), at_once);
  EXPECT_EQ(warm.status, SolverStatus::kDeadline);  // the last solution is better than a new guess
  EXPECT_GE(asked_count(warm), 1u);
}

TEST(CorrectionSolver, FallbackKeepsAStandingLearnerOverTheFeet) {
  Pose leaning(kJointCount);
  bend(leaning, Joint::kPelvis, {40 * kDegree, 0, 0});
  bend(leaning, Joint::kSpineLower, {40 * kDegree, 0, 0});
  Reference reference = still_reference(leaning);
  reference.standing = true;
  const auto result = CorrectionSolver(shared(reference), canonical_skeleton())
                          .solve(learner_at_rest(), {.deadline = 0.0, .iterations = std::nullopt});
  EXPECT_EQ(result.status, SolverStatus::kFallback);
  EXPECT_LT(asked_count(result), 2u);  // both together would fall over
}

TEST(CorrectionSolver, GivesTheSameAnswersToTheSameProblems) {
  std::mt19937 generator(3);
  Reference given = moving_reference();
  given.standing = true;
  const auto reference = shared(given);
  std::vector<CorrectionProblem> problems;
  for (int i = 0; i < 30; ++i) problems.push_back(swinging_problem(*reference, 0.1 * i, 0.3));
  for (int i = 0; i < 10; ++i) problems.push_back(random_problem(generator));
  CorrectionSolver first(reference, canonical_skeleton()), second(reference, canonical_skeleton());
  for (const CorrectionProblem& problem : problems) {
    EXPECT_TRUE(same(first.solve(problem, kNoHurry), second.solve(problem, kNoHurry)));
  }
}

// What a live session does against the clock, a replay does again from the iterations alone:
// converged solves, interrupted ones and fallbacks.
TEST(CorrectionSolver, ReplaysBitForBitFromTheIterations) {
  std::mt19937 generator(4);
  for (const bool standing : {false, true}) {
    Reference given = moving_reference();
    given.standing = standing;
    const auto reference = shared(given);
    CorrectionSolver live(reference, canonical_skeleton(1.7));
    CorrectionSolver replay(reference, canonical_skeleton(1.7));
    std::uniform_real_distribution<double> patience(0.0, 0.004);
    std::array<int, 4> seen{};
    for (int i = 0; i < 300; ++i) {
      CorrectionProblem problem =
          i % 25 == 24 ? random_problem(generator) : swinging_problem(*reference, 0.02 * i, 0.3);
      problem.frame = static_cast<std::uint64_t>(i);
      const double deadline = i % 3 == 0 ? 1.0 : patience(generator);
      const auto a = live.solve(problem, {.deadline = deadline, .iterations = std::nullopt});
      const auto b = replay.solve(problem, {.deadline = 0.0, .iterations = a.iterations});
      ASSERT_TRUE(same(a, b)) << "problem " << i << ", status " << static_cast<int>(a.status)
                              << " and " << static_cast<int>(b.status);
      ++seen[static_cast<std::size_t>(a.status)];
    }
    EXPECT_GT(seen[static_cast<std::size_t>(SolverStatus::kConverged)], 50);
    EXPECT_GT(seen[static_cast<std::size_t>(SolverStatus::kDeadline)] +
                  seen[static_cast<std::size_t>(SolverStatus::kFallback)],
              20);
  }
}

TEST(CorrectionSolver, ConvergesInFewIterationsOnALiveSequence) {
  const auto reference = shared(moving_reference());
  CorrectionSolver solver(reference, canonical_skeleton());
  std::uint32_t iterations = 0;
  int solved = 0;
  for (double t = 1.0; t < 6.0; t += 1.0 / 15.0, ++solved) {
    const auto result = solver.solve(swinging_problem(*reference, t, 0.25), kNoHurry);
    EXPECT_EQ(result.status, SolverStatus::kConverged);
    iterations += result.iterations;
  }
  EXPECT_LT(static_cast<double>(iterations) / solved, 15.0);
}

}  // namespace
}  // namespace secondskin::coach
