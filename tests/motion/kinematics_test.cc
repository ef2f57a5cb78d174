#include "motion/kinematics.h"

#include <gtest/gtest.h>

#include <numbers>
#include <vector>

#include "motion/anatomy.h"
#include "random_pose.h"

namespace secondskin {
namespace {

using Placed = std::vector<Eigen::Isometry3d>;

Placed place(const Skeleton& skeleton, const Pose& pose) {
  Placed X_WB(skeleton.size());
  forward_kinematics(skeleton, pose.p_WR, pose.q_PB, X_WB);
  return X_WB;
}

// A planar arm of two unit links in the x-z plane: elbow at l1 e(a), hand at l1 e(a) + l2 e(a + b).
TEST(ForwardKinematics, OfAPlanarArmIsTheClosedForm) {
  Segment upper{.name = "upper", .parent = {}};
  Segment lower{.name = "lower", .parent = 0};
  lower.p_PB = {0.3, 0, 0};
  lower.p_BE = {0.25, 0, 0};
  const Skeleton arm({upper, lower});
  const double a = 0.7, b = -1.1;
  Pose pose(2);
  pose.p_WR = {1, 2, 3};
  pose.q_PB[0] = quaternion_from({0, 0, a});
  pose.q_PB[1] = quaternion_from({0, 0, b});
  const Placed X_WB = place(arm, pose);
  const Eigen::Vector3d elbow(1 + 0.3 * std::cos(a), 2 + 0.3 * std::sin(a), 3);
  const Eigen::Vector3d hand(elbow.x() + 0.25 * std::cos(a + b), elbow.y() + 0.25 * std::sin(a + b),
                             3);
  EXPECT_LT((X_WB[1].translation() - elbow).norm(), 1e-14);
  EXPECT_LT((X_WB[1] * lower.p_BE - hand).norm(), 1e-14);
}

TEST(ForwardKinematics, KeepsSegmentLengthsForAnyPose) {
  const Skeleton body = canonical_skeleton();
  std::mt19937 generator(7);
  for (int n = 0; n < 1000; ++n) {
    const Placed X_WB = place(body, random_pose(generator, body.size()));
    for (std::size_t i = 1; i < body.size(); ++i) {
      const double length = (X_WB[i].translation() - X_WB[*body[i].parent].translation()).norm();
      EXPECT_NEAR(length, body[i].p_PB.norm(), 1e-12);
      EXPECT_TRUE((X_WB[i].linear().transpose() * X_WB[i].linear()).isIdentity(1e-12));
    }
  }
}

// Moves one coordinate of the pose as the Jacobian's columns say.
Pose moved(const Pose& pose, std::size_t column, double step) {
  Pose result = pose;
  if (column < 3) {
    result.p_WR[static_cast<Eigen::Index>(column)] += step;
  } else {
    Eigen::Quaterniond& q = result.q_PB[(column - 3) / 3];
    q = q *
        quaternion_from(step * Eigen::Vector3d::Unit(static_cast<Eigen::Index>((column - 3) % 3)));
  }
  return result;
}

TEST(PositionJacobian, IsTheDerivativeOfForwardKinematics) {
  const Skeleton body = canonical_skeleton();
  std::mt19937 generator(8);
  std::uniform_int_distribution<std::size_t> any(0, body.size() - 1);
  const auto columns = 3 + 3 * body.size();
  constexpr double kStep = 1e-6;
  Eigen::Matrix3Xd J(3, columns);
  for (int n = 0; n < 1000; ++n) {
    const Pose pose = random_pose(generator, body.size());
    const std::size_t segment = any(generator);
    const Eigen::Vector3d p_BQ = random_vector(generator, 0.3);
    J.setConstant(99.0);  // what is left of it would show
    position_jacobian(body, place(body, pose), segment, p_BQ, J);
    for (std::size_t c = 0; c < columns; ++c) {
      const Eigen::Vector3d ahead = place(body, moved(pose, c, kStep))[segment] * p_BQ;
      const Eigen::Vector3d behind = place(body, moved(pose, c, -kStep))[segment] * p_BQ;
      ASSERT_LT((J.col(static_cast<Eigen::Index>(c)) - (ahead - behind) / (2 * kStep)).norm(), 1e-7)
          << "segment " << segment << " column " << c;
    }
  }
}

TEST(OrientationJacobian, IsTheDerivativeOfForwardKinematics) {
  const Skeleton body = canonical_skeleton();
  std::mt19937 generator(9);
  std::uniform_int_distribution<std::size_t> any(0, body.size() - 1);
  const auto columns = 3 + 3 * body.size();
  constexpr double kStep = 1e-6;
  Eigen::Matrix3Xd J(3, columns);
  for (int n = 0; n < 1000; ++n) {
    const Pose pose = random_pose(generator, body.size());
    const std::size_t segment = any(generator);
    J.setConstant(99.0);
    orientation_jacobian(body, place(body, pose), segment, J);
    for (std::size_t c = 0; c < columns; ++c) {
      const Eigen::Quaterniond ahead(place(body, moved(pose, c, kStep))[segment].linear());
      const Eigen::Quaterniond behind(place(body, moved(pose, c, -kStep))[segment].linear());
      const Eigen::Vector3d w = rotation_vector(ahead * behind.conjugate()) / (2 * kStep);
      ASSERT_LT((J.col(static_cast<Eigen::Index>(c)) - w).norm(), 1e-7)
          << "segment " << segment << " column " << c;
    }
  }
}

TEST(CentreOfMass, IsTheWeightedMeanAndTheRootWithoutMasses) {
  Segment a{.name = "a", .parent = {}};
  Segment b{.name = "b", .parent = 0};
  b.p_PB = {1, 0, 0};
  Pose pose(2);
  pose.p_WR = {5, 0, 0};
  const Skeleton massless({a, b});
  EXPECT_EQ(centre_of_mass(massless, place(massless, pose)), pose.p_WR);
  a.mass_fraction = 0.75;
  b.mass_fraction = 0.25;
  b.p_BC = {0, 0, 2};
  const Skeleton massive({a, b});
  EXPECT_LT((centre_of_mass(massive, place(massive, pose)) - Eigen::Vector3d(5.25, 0, 0.5)).norm(),
            1e-14);
}

// Standing, the centre of mass lies at 0.55 to 0.58 of stature (Winter, fig. 4.1 and table 4.1 give
// 0.56 to 0.57).
TEST(CentreOfMass, OfAStandingBodyIsNearTheNavel) {
  const Skeleton body = canonical_skeleton(1.75);
  Pose pose(body.size());
  pose.p_WR.z() = 0.530 * 1.75;
  const Eigen::Vector3d c = centre_of_mass(body, place(body, pose));
  EXPECT_NEAR(c.z() / 1.75, 0.565, 0.015);
  EXPECT_NEAR(c.y(), 0.0, 1e-12);
  EXPECT_NEAR(c.x(), 0.0, 0.02);
}

}  // namespace
}  // namespace secondskin
