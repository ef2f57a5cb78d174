#include "coach/correct/joint_selection.h"

#include <gtest/gtest.h>

#include "problems.h"

namespace secondskin::coach {
namespace {

// What all pairs and single joints come to with their best amounts, price of asking included.
double best_of_all(JointSelection& selection, CorrectionModel& model) {
  std::vector<double> delta(model.size(), 0.0);
  double least = model.cost(delta);
  for (std::size_t a = 0; a < kJointCount; ++a) {
    for (std::size_t b = a; b < kJointCount; ++b) {
      if (!model.open()[a] || !model.open()[b]) continue;
      const JointSet set = JointSet().set(a).set(b);
      least = std::min(least, selection.amounts(set, 30, delta) +
                                  model.joint_price() * static_cast<double>(set.count()));
    }
  }
  return least;
}

TEST(JointSelection, ComesCloseToTheBestPairOfAll) {
  const auto reference = shared(moving_reference());
  CorrectionModel model(reference, canonical_skeleton(1.6), {});
  JointSelection selection(model);
  std::vector<double> delta(model.size());
  double ours = 0.0, best = 0.0;
  for (int problem = 0; problem < 40; ++problem) {
    ASSERT_TRUE(model.pose(swinging_problem(*reference, 0.2 * problem, 0.4)));
    const double none = model.cost(std::vector<double>(model.size(), 0.0));
    best += none - best_of_all(selection, model);
    const JointSet chosen = selection.select(2, {}, delta);
    selection.amounts(chosen, 30, delta);
    ours += none - model.cost(delta) - model.joint_price() * static_cast<double>(chosen.count());
  }
  EXPECT_GT(ours, 0.99 * best);
  EXPECT_LE(ours, best * (1.0 + 1e-9));
}

TEST(JointSelection, GivesAmountsInsideTheBoundsForTheChosenOnly) {
  std::mt19937 generator(1);
  Reference given = moving_reference();
  given.standing = true;
  CorrectionModel model(shared(given), canonical_skeleton(1.6), {});
  JointSelection selection(model);
  std::vector<double> delta(model.size());
  const std::vector<double> none(model.size(), 0.0);
  for (int draw = 0; draw < 300; ++draw) {
    ASSERT_TRUE(model.pose(random_problem(generator)));
    const std::size_t most = static_cast<std::size_t>(draw % 6);
    const JointSet chosen = selection.select(most, {}, delta);
    ASSERT_LE(chosen.count(), most);
    ASSERT_EQ(chosen, model.open());
    for (std::size_t i = 0; i < model.size(); ++i) {
      ASSERT_LE(delta[i], model.upper()[i]);
      ASSERT_GE(delta[i], model.lower()[i]);
      ASSERT_TRUE(chosen[index(model.freedoms()[i].joint)] || delta[i] == 0.0);
    }
    ASSERT_LE(model.cost(delta), model.cost(none));
  }
}

TEST(JointSelection, KeepsTheLastChoiceUnlessAnotherIsClearlyBetter) {
  const auto reference = shared(still_reference(Pose(kJointCount)));
  CorrectionOptions one;
  one.max_joints = 1;
  CorrectionModel model(reference, canonical_skeleton(), one);
  JointSelection selection(model);
  std::vector<double> delta(model.size());
  const auto choose = [&](double left, double right, const JointSet& last) {
    CorrectionProblem problem;
    problem.learner = Pose(kJointCount);
    problem.learner.q_PB[index(Joint::kLeftElbow)] =
        joint_rotation(Joint::kLeftElbow, {left * kDegree, 0, 0});
    problem.learner.q_PB[index(Joint::kRightElbow)] =
        joint_rotation(Joint::kRightElbow, {right * kDegree, 0, 0});
    EXPECT_TRUE(model.pose(problem));
    return selection.select(1, last, delta);
  };
  const JointSet left = JointSet().set(index(Joint::kLeftElbow));
  const JointSet right = JointSet().set(index(Joint::kRightElbow));
  EXPECT_EQ(choose(40.0, 40.4, {}), right);
  EXPECT_EQ(choose(40.0, 40.4, left), left);
  EXPECT_EQ(choose(40.0, 45.0, left), right);
}

TEST(JointSelection, ChoosesNothingThatIsNotWorthItsPrice) {
  const auto reference = shared(still_reference(Pose(kJointCount)));
  CorrectionProblem problem;
  problem.learner = Pose(kJointCount);
  problem.learner.q_PB[index(Joint::kHead)] = joint_rotation(Joint::kHead, {11 * kDegree, 0, 0});
  for (const double sparsity : {0.0, 1.0}) {
    CorrectionOptions options;
    options.sparsity = sparsity;
    CorrectionModel model(reference, canonical_skeleton(), options);
    JointSelection selection(model);
    std::vector<double> delta(model.size());
    ASSERT_TRUE(model.pose(problem));
    EXPECT_EQ(selection.select(2, {}, delta).any(), sparsity == 0.0);
  }
}

}  // namespace
}  // namespace secondskin::coach
