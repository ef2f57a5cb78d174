#include "coach/correct/correction_model.h"

#include <gtest/gtest.h>

#include <Eigen/Eigenvalues>

#include "problems.h"

namespace secondskin::coach {
namespace {

std::vector<double> random_inside(std::mt19937& generator, const CorrectionModel& model) {
  std::uniform_real_distribution<double> share(0.0, 1.0);
  std::vector<double> delta(model.size());
  for (std::size_t i = 0; i < delta.size(); ++i) {
    delta[i] = model.lower()[i] + share(generator) * (model.upper()[i] - model.lower()[i]);
    delta[i] *= 0.5;
  }
  return delta;
}

TEST(MinimumJerk, StartsAndEndsAtRestAndIsHalfDoneHalfWay) {
  EXPECT_EQ(minimum_jerk(0.0), 0.0);
  EXPECT_DOUBLE_EQ(minimum_jerk(0.5), 0.5);
  EXPECT_DOUBLE_EQ(minimum_jerk(1.0), 1.0);
  EXPECT_NEAR(minimum_jerk(1e-3), 0.0, 1e-8);
  // Its peak velocity, half way, is 1.875 of the mean (Flash & Hogan 1985).
  EXPECT_NEAR((minimum_jerk(0.5 + 1e-5) - minimum_jerk(0.5 - 1e-5)) / 2e-5, 1.875, 1e-6);
}

TEST(CorrectionModel, HasEveryMovementOfTheBodyButTheHeading) {
  CorrectionModel model(shared(moving_reference()), canonical_skeleton(), {});
  EXPECT_GE(model.size(), 40u);
  for (const DegreeOfFreedom& freedom : model.freedoms()) {
    const auto movement = static_cast<std::size_t>(freedom.movement);
    const AngleRange range = canonical_anatomy()[index(freedom.joint)].range[movement];
    EXPECT_LT(range.min, range.max);
    EXPECT_FALSE(freedom.joint == Joint::kPelvis && freedom.movement == Movement::kRotation);
  }
}

TEST(CorrectionModel, RefusesABodyThatIsNotCanonical) {
  const Skeleton stick({Segment{.name = "root", .parent = std::nullopt}});
  EXPECT_THROW(CorrectionModel(shared(moving_reference()), stick, {}), std::invalid_argument);
  EXPECT_THROW(CorrectionModel(shared(moving_reference()), canonical_skeleton(), {.horizon = 0.0}),
               std::invalid_argument);
}

TEST(CorrectionModel, GradientAgreesWithDifferences) {
  std::mt19937 generator(1);
  CorrectionModel model(shared(moving_reference()), canonical_skeleton(1.6), {});
  std::vector<double> gradient(model.size());
  for (int draw = 0; draw < 1000; ++draw) {
    ASSERT_TRUE(model.pose(random_problem(generator)));
    std::vector<double> delta = random_inside(generator, model);
    model.gradient(delta, gradient);
    const double largest =
        1.0 + std::abs(*std::max_element(gradient.begin(), gradient.end(), [](double a, double b) {
          return std::abs(a) < std::abs(b);
        }));
    for (std::size_t i = draw % 3; i < delta.size(); i += 3) {
      const double at = delta[i], step = 1e-6;
      delta[i] = at + step;
      const double above = model.cost(delta);
      delta[i] = at - step;
      const double below = model.cost(delta);
      delta[i] = at;
      ASSERT_NEAR(gradient[i], (above - below) / (2.0 * step), 1e-6 * largest)
          << "draw " << draw << ", " << joint_name(model.freedoms()[i].joint);
    }
  }
}

TEST(CorrectionModel, BalanceJacobianAgreesWithDifferences) {
  std::mt19937 generator(2);
  Reference reference = moving_reference();
  reference.standing = true;
  CorrectionModel model(shared(reference), canonical_skeleton(1.6), {});
  ASSERT_EQ(model.constraints(), 8u);
  std::vector<double> jacobian(8 * model.size()), above(8), below(8);
  for (int draw = 0; draw < 200; ++draw) {
    ASSERT_TRUE(model.pose(random_problem(generator)));
    std::vector<double> delta = random_inside(generator, model);
    model.balance_jacobian(delta, jacobian);
    for (std::size_t i = 0; i < delta.size(); ++i) {
      const double at = delta[i], step = 1e-6;
      delta[i] = at + step;
      model.balance(delta, above);
      delta[i] = at - step;
      model.balance(delta, below);
      delta[i] = at;
      for (std::size_t c = 0; c < 8; ++c) {
        ASSERT_NEAR(jacobian[c * model.size() + i], (above[c] - below[c]) / (2.0 * step), 1e-7);
      }
    }
  }
}

TEST(CorrectionModel, HessianIsSymmetricPositiveAndSparseAsItSays) {
  std::mt19937 generator(3);
  CorrectionModel model(shared(moving_reference()), canonical_skeleton(1.6), {});
  const std::size_t n = model.size();
  std::vector<double> hessian(n * n);
  for (int draw = 0; draw < 100; ++draw) {
    ASSERT_TRUE(model.pose(random_problem(generator)));
    model.hessian(random_inside(generator, model), hessian);
    const Eigen::Map<const Eigen::MatrixXd> H(hessian.data(), static_cast<Eigen::Index>(n),
                                              static_cast<Eigen::Index>(n));
    EXPECT_LT((H - H.transpose()).cwiseAbs().maxCoeff(), 1e-9 * H.cwiseAbs().maxCoeff());
    const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> eigen(H, Eigen::EigenvaluesOnly);
    EXPECT_GT(eigen.eigenvalues()(0), -1e-9 * H.cwiseAbs().maxCoeff());
    for (std::size_t a = 0; a < n; ++a) {
      for (std::size_t b = 0; b < n; ++b) {
        ASSERT_TRUE(model.coupled(a, b) || hessian[a * n + b] == 0.0);
      }
    }
  }
}

// Gauss-Newton leaves out the curvature of the kinematics times the residual, so it is the true
// Hessian where residuals vanish.
TEST(CorrectionModel, HessianIsTheTrueOneNearZeroError) {
  std::mt19937 generator(4);
  Reference reference = moving_reference();
  reference.tolerance.fill(0.0);
  const auto held = shared(reference);
  CorrectionModel model(held, canonical_skeleton(1.6), {});
  const std::size_t n = model.size();
  std::vector<double> hessian(n * n), above(n), below(n);
  for (int draw = 0; draw < 20; ++draw) {
    ASSERT_TRUE(model.pose(swinging_problem(*held, 0.4 * draw, 0.05 * kDegree)));
    std::vector<double> delta(n, 0.0);
    model.hessian(delta, hessian);
    double largest = 0.0, worst = 0.0;
    for (std::size_t i = 0; i < n; ++i) {
      const double step = 1e-6;
      delta[i] = step;
      model.gradient(delta, above);
      delta[i] = -step;
      model.gradient(delta, below);
      delta[i] = 0.0;
      for (std::size_t k = 0; k < n; ++k) {
        const double numerical = (above[k] - below[k]) / (2.0 * step);
        largest = std::max(largest, std::abs(numerical));
        worst = std::max(worst, std::abs(numerical - hessian[i * n + k]));
      }
    }
    EXPECT_LT(worst, 0.01 * largest);
  }
}

TEST(CorrectionModel, ExactHessianAgreesWithDifferences) {
  std::mt19937 generator(7);
  Reference reference = moving_reference();
  reference.standing = true;
  CorrectionModel model(shared(reference), canonical_skeleton(1.6), {});
  const std::size_t n = model.size(), m = model.constraints();
  std::vector<double> hessian(n * n), above(n), below(n), jacobian(m * n), multipliers(m);
  std::uniform_real_distribution<double> multiplier(0.0, 20.0);
  const auto slope = [&](std::span<const double> delta, std::vector<double>& out) {
    model.gradient(delta, out);
    for (double& value : out) value *= 0.5;
    model.balance_jacobian(delta, jacobian);
    for (std::size_t c = 0; c < m; ++c) {
      for (std::size_t i = 0; i < n; ++i) out[i] += multipliers[c] * jacobian[c * n + i];
    }
  };
  for (int draw = 0; draw < 100; ++draw) {
    ASSERT_TRUE(model.pose(random_problem(generator)));
    std::vector<double> delta = random_inside(generator, model);
    for (double& value : multipliers) value = multiplier(generator);
    model.exact_hessian(delta, 0.5, multipliers, hessian);
    const double largest =
        Eigen::Map<const Eigen::VectorXd>(hessian.data(), static_cast<Eigen::Index>(n * n))
            .cwiseAbs()
            .maxCoeff();
    for (std::size_t i = 0; i < n; ++i) {
      const double at = delta[i], step = 1e-6;
      delta[i] = at + step;
      slope(delta, above);
      delta[i] = at - step;
      slope(delta, below);
      delta[i] = at;
      for (std::size_t k = 0; k < n; ++k) {
        ASSERT_NEAR(hessian[i * n + k], (above[k] - below[k]) / (2.0 * step), 1e-6 * largest)
            << "draw " << draw << ", " << joint_name(model.freedoms()[i].joint) << " " << i << ", "
            << joint_name(model.freedoms()[k].joint) << " " << k;
        ASSERT_TRUE(model.coupled(i, k) || hessian[i * n + k] == 0.0);
      }
    }
  }
}

TEST(CorrectionModel, ZeroIsAlwaysInsideTheBounds) {
  std::mt19937 generator(5);
  Reference reference = moving_reference();
  reference.standing = true;
  CorrectionModel model(shared(reference), canonical_skeleton(), {});
  const std::vector<double> none(model.size(), 0.0);
  std::vector<double> balance(model.constraints());
  for (int draw = 0; draw < 1000; ++draw) {
    CorrectionProblem problem = random_problem(generator);
    problem.learner.q_PB[draw % kJointCount] = quaternion_from({1.5, -1.0, 2.0});  // outside
    problem.velocity[3] *= 30.0;                                                   // too fast
    ASSERT_TRUE(model.pose(problem));
    for (std::size_t i = 0; i < model.size(); ++i) {
      ASSERT_LE(model.lower()[i], 0.0);
      ASSERT_GE(model.upper()[i], 0.0);
    }
    model.balance(none, balance);
    for (std::size_t c = 0; c < balance.size(); ++c)
      ASSERT_LE(balance[c], model.balance_limit()[c]);
  }
}

TEST(CorrectionModel, ClosedFormCorrectsTheLargestErrorsToTheirDeadBand) {
  CorrectionModel model(shared(still_reference(Pose(kJointCount))), canonical_skeleton(), {});
  CorrectionProblem problem;
  problem.learner = Pose(kJointCount);
  const auto bend = [&](Joint joint, const JointAngles& angles) {
    problem.learner.q_PB[index(joint)] = joint_rotation(joint, angles);
  };
  bend(Joint::kLeftElbow, {50 * kDegree, 0, 0});
  bend(Joint::kRightKnee, {40 * kDegree, 0, 0});
  bend(Joint::kHead, {0, 0, 20 * kDegree});
  ASSERT_TRUE(model.pose(problem));
  std::vector<double> delta(model.size());
  model.closed_form(2, delta);
  for (std::size_t i = 0; i < model.size(); ++i) {
    const auto [joint, movement] = model.freedoms()[i];
    const bool flexion = movement == Movement::kFlexion;
    const double expected = joint == Joint::kLeftElbow && flexion   ? -40 * kDegree
                            : joint == Joint::kRightKnee && flexion ? -30 * kDegree
                                                                    : 0.0;
    EXPECT_NEAR(delta[i], expected, 1e-3) << joint_name(joint);
  }
}

// Where experts differ the learner is free.
TEST(CorrectionModel, TakesTheDeadBandOfTheInstant) {
  Reference reference = still_reference(Pose(kJointCount));
  reference.band.assign(reference.motion.poses.size(), reference.tolerance);
  for (std::size_t f = 300; f < reference.band.size(); ++f) {
    reference.band[f][index(Joint::kHead)] = 30 * kDegree;
  }
  CorrectionModel model(shared(reference), canonical_skeleton(), {});
  CorrectionProblem problem;
  problem.learner = Pose(kJointCount);
  problem.learner.q_PB[index(Joint::kHead)] = joint_rotation(Joint::kHead, {20 * kDegree, 0, 0});
  problem.reference_time = 1.0;
  ASSERT_TRUE(model.pose(problem));
  EXPECT_TRUE(model.has_error());
  problem.reference_time = 6.0;
  ASSERT_TRUE(model.pose(problem));
  EXPECT_FALSE(model.has_error());
}

TEST(CorrectionModel, DoesNotDependOnBodySizePlaceOrHeading) {
  std::mt19937 generator(6);
  const auto reference = shared(moving_reference());
  CorrectionModel model(reference, canonical_skeleton(1.9), {});
  CorrectionProblem problem = random_problem(generator);
  ASSERT_TRUE(model.pose(problem));
  const std::vector<double> none(model.size(), 0.0);
  const double here = model.error(none);
  problem.learner.p_WR = {5.0, -3.0, 1.0};
  problem.learner.q_PB[0] =
      Eigen::AngleAxisd(2.0, Eigen::Vector3d::UnitZ()) * problem.learner.q_PB[0];
  ASSERT_TRUE(model.pose(problem));
  EXPECT_NEAR(model.error(none), here, 1e-9 * here);
  // The expert's pose on any other body is no error.
  CorrectionModel small(reference, canonical_skeleton(1.2), {});
  ASSERT_TRUE(small.pose(swinging_problem(*reference, 3.0, 0.0)));
  EXPECT_FALSE(small.has_error());
}

}  // namespace
}  // namespace secondskin::coach
