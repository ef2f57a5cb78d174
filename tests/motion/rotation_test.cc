#include "motion/rotation.h"

#include <gtest/gtest.h>

#include <numbers>

#include "random_pose.h"

namespace secondskin {
namespace {

constexpr double kPi = std::numbers::pi;
constexpr int kDraws = 1000;

TEST(RotationVector, IsAxisTimesAngle) {
  const Eigen::Quaterniond q(Eigen::AngleAxisd(1.2, Eigen::Vector3d::UnitY()));
  EXPECT_TRUE(rotation_vector(q).isApprox(Eigen::Vector3d(0, 1.2, 0), 1e-14));
}

TEST(RotationVector, TakesTheShorterWayForEitherSignOfAQuaternion) {
  std::mt19937 generator(1);
  for (int i = 0; i < kDraws; ++i) {
    const Eigen::Quaterniond q = random_rotation(generator);
    const Eigen::Quaterniond minus(-q.coeffs());
    EXPECT_LE(rotation_vector(q).norm(), kPi + 1e-12);
    EXPECT_LT((rotation_vector(q) - rotation_vector(minus)).norm(), 1e-12);
  }
}

TEST(RotationVector, AndItsExponentialAreInverseFromTinyAnglesToPi) {
  std::mt19937 generator(2);
  for (int i = 0; i < kDraws; ++i) {
    const Eigen::Vector3d axis = random_vector(generator, 1.0).normalized();
    for (const double angle :
         {0.0, 1e-300, 1e-12, 1e-5, 0.99e-4, 1.01e-4, 1e-3, 0.5, 3.0, kPi - 1e-9}) {
      const Eigen::Vector3d v = angle * axis;
      EXPECT_LT((rotation_vector(quaternion_from(v)) - v).norm(), 1e-12 + 1e-12 * angle);
      EXPECT_NEAR(quaternion_from(v).norm(), 1.0, 1e-14);
    }
  }
}

TEST(GeodesicDistance, IsTheAngleBetweenOrientations) {
  std::mt19937 generator(3);
  for (int i = 0; i < kDraws; ++i) {
    const Eigen::Quaterniond a = random_rotation(generator);
    const Eigen::Vector3d v = random_vector(generator, 0.5);
    if (v.norm() > kPi) continue;
    const Eigen::Quaterniond b = a * quaternion_from(v);
    EXPECT_NEAR(geodesic_distance(a, b), v.norm(), 1e-9);
    EXPECT_NEAR(geodesic_distance(a, Eigen::Quaterniond(-b.coeffs())), v.norm(), 1e-9);
  }
}

TEST(TwistAngle, RecoversTheTwistUnderAnySwing) {
  std::mt19937 generator(4);
  std::uniform_real_distribution<double> angle(-kPi + 1e-6, kPi - 1e-6);
  for (int i = 0; i < kDraws; ++i) {
    const Eigen::Vector3d axis = random_vector(generator, 1.0).normalized();
    const Eigen::Vector3d across = axis.unitOrthogonal() * 0.9 * angle(generator);
    const double twist = angle(generator);
    const Eigen::Quaterniond q = quaternion_from(across) * quaternion_from(twist * axis);
    EXPECT_NEAR(twist_angle(q, axis), twist, 1e-9);
    EXPECT_NEAR(twist_angle(Eigen::Quaterniond(-q.coeffs()), axis), twist, 1e-9);
  }
}

TEST(TwistAngle, OfAHalfTurnIsPlusPi) {
  const Eigen::Vector3d z = Eigen::Vector3d::UnitZ();
  EXPECT_DOUBLE_EQ(twist_angle(Eigen::Quaterniond(0, 0, 0, 1), z), kPi);
  EXPECT_DOUBLE_EQ(twist_angle(Eigen::Quaterniond(0, 0, 0, -1), z), kPi);
}

// Sola et al. 2018, "A micro Lie theory", equation 144, against d log(exp(v) exp(e)) / d e.
TEST(RightJacobianInverse, IsTheDerivativeOfTheLogarithm) {
  std::mt19937 generator(5);
  constexpr double kStep = 1e-6;
  for (int i = 0; i < kDraws; ++i) {
    Eigen::Vector3d v = random_vector(generator, 1.0);
    if (i % 3 == 0) v *= 1e-3;
    if (v.norm() > 3.0) v *= 3.0 / v.norm();
    const Eigen::Matrix3d J = right_jacobian_inverse(v);
    for (int k = 0; k < 3; ++k) {
      const Eigen::Vector3d e = kStep * Eigen::Vector3d::Unit(k);
      const Eigen::Vector3d numerical =
          (rotation_vector(quaternion_from(v) * quaternion_from(e)) -
           rotation_vector(quaternion_from(v) * quaternion_from(-e))) /
          (2.0 * kStep);
      EXPECT_LT((J.col(k) - numerical).norm(), 1e-6) << v.transpose();
    }
  }
}

TEST(RightJacobian, IsTheInverseOfItsInverse) {
  std::mt19937 generator(8);
  for (int i = 0; i < 1000; ++i) {
    Eigen::Vector3d v = random_vector(generator, 1.0);
    if (i % 3 == 0) v *= 1e-3;
    if (v.norm() > 3.0) v *= 3.0 / v.norm();
    EXPECT_TRUE((right_jacobian(v) * right_jacobian_inverse(v)).isIdentity(1e-9)) << v.transpose();
    EXPECT_TRUE(
        (cross_matrix(v) * Eigen::Vector3d(1, 2, 3)).isApprox(v.cross(Eigen::Vector3d(1, 2, 3))));
  }
}

TEST(RightJacobianInverse, IsFiniteAtZeroAndAtPi) {
  EXPECT_TRUE(right_jacobian_inverse(Eigen::Vector3d::Zero()).isIdentity());
  EXPECT_TRUE(right_jacobian_inverse({kPi, 0, 0}).allFinite());
  // Across the switch between series and closed form.
  const Eigen::Vector3d axis(0.6, 0.0, 0.8);
  EXPECT_LT(
      (right_jacobian_inverse(0.0099999 * axis) - right_jacobian_inverse(0.0100001 * axis)).norm(),
      1e-6);
}

}  // namespace
}  // namespace secondskin
