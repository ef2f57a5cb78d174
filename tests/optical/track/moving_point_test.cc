#include "server/optical/track/moving_point.h"

#include <gtest/gtest.h>

#include <Eigen/Eigenvalues>
#include <cmath>
#include <random>

#include "ring_rig.h"

namespace secondskin::server {
namespace {

using Vector9 = Eigen::Matrix<double, 9, 1>;
using Matrix9 = Eigen::Matrix<double, 9, 9>;

MovingPoint from(const Vector9& x, const Matrix9& P) {
  return {x.head<3>(),         x.segment<3>(3),     x.tail<3>(),
          P.block<3, 3>(0, 0), P.block<3, 3>(0, 3), P.block<3, 3>(0, 6),
          P.block<3, 3>(3, 3), P.block<3, 3>(3, 6), P.block<3, 3>(6, 6)};
}

MovingPoint any_point(std::mt19937& random) {
  std::normal_distribution<double> normal;
  Matrix9 A;
  Vector9 x;
  for (double& a : A.reshaped()) a = normal(random);
  for (double& a : x.reshaped()) a = normal(random);
  return from(x, A * A.transpose());
}

// dx/dt = A x of Singer's model, by many small steps.
Matrix9 transition(double memory, double dt) {
  Matrix9 A = Matrix9::Zero();
  A.block<3, 3>(0, 3).setIdentity();
  A.block<3, 3>(3, 6).setIdentity();
  A.block<3, 3>(6, 6) = -Eigen::Matrix3d::Identity() / memory;
  Matrix9 F = Matrix9::Identity(), term = Matrix9::Identity();
  for (int k = 1; k < 30; ++k) {
    term = (term * A * dt / k).eval();
    F += term;
  }
  return F;
}

TEST(MovingPoint, PredictsAsTheMatricesDo) {
  std::mt19937 random(5);
  for (int draw = 0; draw < 200; ++draw) {
    const MovingPoint before = any_point(random);
    const double dt = 0.001 + 0.0005 * draw, memory = 0.2, jerk = 30.0;
    MovingPoint after = before;
    predict(after, {jerk, memory}, dt);
    const Matrix9 F = transition(memory, dt);
    Matrix9 Q = Matrix9::Zero();
    const double q = jerk * jerk;
    const double terms[3][3] = {
        {std::pow(dt, 5) / 20.0, std::pow(dt, 4) / 8.0, std::pow(dt, 3) / 6.0},
        {std::pow(dt, 4) / 8.0, std::pow(dt, 3) / 3.0, dt * dt / 2.0},
        {std::pow(dt, 3) / 6.0, dt * dt / 2.0, dt}};
    for (int i = 0; i < 3; ++i) {
      for (int j = 0; j < 3; ++j)
        Q.block<3, 3>(3 * i, 3 * j).diagonal().setConstant(q * terms[i][j]);
    }
    EXPECT_LT((after.state() - F * before.state()).norm(), 1e-9);
    EXPECT_LT((after.covariance() - F * before.covariance() * F.transpose() - Q).norm(), 1e-8);
  }
}

TEST(MovingPoint, CorrectsAsTheJosephFormDoes) {
  std::mt19937 random(6);
  std::normal_distribution<double> normal;
  for (int draw = 0; draw < 200; ++draw) {
    const MovingPoint before = any_point(random);
    const Eigen::RowVector3d g(normal(random), normal(random), normal(random));
    const double nu = normal(random), R = 0.3;
    MovingPoint after = before;
    const Innovation i = innovation(after, g, nu, R);
    correct(after, i);
    Eigen::Matrix<double, 1, 9> H = Eigen::Matrix<double, 1, 9>::Zero();
    H.head<3>() = g;
    const Matrix9 P = before.covariance();
    const double S = (H * P * H.transpose())(0) + R;
    const Vector9 K = P * H.transpose() / S;
    const Matrix9 I_KH = Matrix9::Identity() - K * H;
    EXPECT_NEAR(i.S, S, 1e-9 * S);
    EXPECT_LT((after.state() - before.state() - K * nu).norm(), 1e-9);
    EXPECT_LT((after.covariance() - I_KH * P * I_KH.transpose() - R * K * K.transpose()).norm(),
              1e-8 * P.norm());
  }
}

TEST(MovingPoint, BlendKeepsTheMomentsOfTheMixture) {
  std::mt19937 random(7);
  const MovingPoint a = any_point(random), b = any_point(random);
  const MovingPoint m = blend(a, b, 0.3);
  const Vector9 mean = 0.3 * a.state() + 0.7 * b.state();
  const auto moment = [&](const MovingPoint& x) -> Matrix9 {
    const Vector9 d = x.state() - mean;
    return x.covariance() + d * d.transpose();
  };
  EXPECT_LT((m.state() - mean).norm(), 1e-12);
  EXPECT_LT((m.covariance() - 0.3 * moment(a) - 0.7 * moment(b)).norm(), 1e-11);
}

TEST(MovingPoint, CovarianceStaysSymmetricAndPositive) {
  const ProjectorRig rig = ring_rig();
  std::mt19937 random(8);
  std::uniform_int_distribution<std::size_t> projector(0, 15);
  std::uniform_real_distribution<double> dt(0.0, 0.016);
  MovingPoint point = MovingPoint::at({0.1, 0.2, 1.0}, 0.3, 1.0, 10.0);
  for (int step = 0; step < 20000; ++step) {
    predict(point, {10.0, 0.3}, dt(random));
    const auto& p = *rig.projectors[projector(random)];
    correct(point, innovation(point, p.gradient({0.1, 0.2, 1.0}), 0.0, 0.37));
    if (step % 100 != 0) continue;
    const Matrix9 P = point.covariance();
    EXPECT_LT((P - P.transpose()).norm(), 1e-12 * P.norm());
    EXPECT_GT(Eigen::SelfAdjointEigenSolver<Matrix9>(P).eigenvalues().minCoeff(), 0.0);
  }
}

TEST(Projector, AnalyticGradientIsTheNumericalOne) {
  const ProjectorRig rig = ring_rig();
  std::mt19937 random(9);
  std::uniform_real_distribution<double> place(-1.0, 1.0);
  for (int draw = 0; draw < 1000; ++draw) {
    const Projector& projector = *rig.projectors[static_cast<std::size_t>(draw % 16)];
    const Eigen::Vector3d p_W(place(random), place(random), 1.0 + place(random));
    for (int axis = 0; axis < 3; ++axis) {
      const Eigen::Vector3d step = 1e-5 * Eigen::Vector3d::Unit(axis);
      EXPECT_NEAR(projector.gradient(p_W)[axis],
                  (projector.value(p_W + step) - projector.value(p_W - step)) / 2e-5, 1e-4);
    }
  }
}

}  // namespace
}  // namespace secondskin::server
