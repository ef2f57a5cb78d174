#include "server/markers/pose_solver.h"

#include <gtest/gtest.h>

#include "motion/rotation.h"
#include "moving_body.h"
#include "tests/motion/random_pose.h"

namespace secondskin::server {
namespace {

using Eigen::Vector3d;

std::vector<Site> sites_of(const MarkerSet& set) {
  std::vector<Site> sites;
  for (const MarkerPlace& p : set.places()) sites.push_back({p.segment, p.p_BM, p.sway});
  return sites;
}

PlacedPose placed(const PoseSolver& solver, const Pose& pose) {
  PlacedPose result;
  result.p_WR = pose.p_WR;
  std::copy(pose.q_PB.begin(), pose.q_PB.end(), result.q_PB.begin());
  solver.place(result);
  return result;
}

TEST(MovementRates, AgreeWithDifferencesForEveryJoint) {
  std::mt19937 generator(4);
  for (int i = 0; i < 1000; ++i) {
    const auto joint = static_cast<Joint>(static_cast<std::size_t>(i) % kJointCount);
    const Eigen::Quaterniond q = quaternion_from(random_vector(generator, 0.5));
    const Eigen::Matrix3d rates = movement_rates(joint, q);
    constexpr double h = 1e-6;
    for (int axis = 0; axis < 3; ++axis) {
      const Vector3d v = h * Vector3d::Unit(axis);
      const JointAngles up = joint_angles(joint, q * quaternion_from(v));
      const JointAngles down = joint_angles(joint, q * quaternion_from(-v));
      for (int m = 0; m < 3; ++m) {
        if (rates.row(m).norm() == 0.0) continue;  // singular there
        const auto k = static_cast<std::size_t>(m);
        EXPECT_NEAR(rates(m, axis), std::remainder(up[k] - down[k], 2 * std::numbers::pi) / (2 * h),
                    1e-4 * (1.0 + rates.norm()));
      }
    }
  }
}

TEST(PoseSolver, GradientAgreesWithDifferencesOfTheCost) {
  const Motion truth = moving_body(20);
  const MarkerSet set = plug_in_gait();
  const MarkerMotion markers = markers_on(truth, set, 0.02);
  PoseSolver solver(truth.skeleton, sites_of(set));
  std::vector<double> sigma(set.places().size(), 0.01);
  sigma[3] = 0.0;
  PlacedPose predicted = placed(solver, truth.poses[5]);
  PoseSolver::Vector information = PoseSolver::Vector::Constant(solver.dofs(), 30.0);
  for (const std::size_t f : {0u, 7u, 12u}) {
    const PlacedPose pose = placed(solver, truth.poses[f]);
    const PoseSolver::Observation seen{markers.frames[f].p_WM, sigma, 4.0, &predicted,
                                       &information};
    PoseSolver::Matrix H;
    PoseSolver::Vector g;
    solver.evaluate(pose, seen, &H, &g);
    for (int i = 0; i < solver.dofs(); ++i) {
      constexpr double h = 1e-6;
      PoseSolver::Vector dx = PoseSolver::Vector::Zero(solver.dofs());
      PlacedPose up, down;
      dx[i] = h;
      solver.step(pose, dx, up);
      dx[i] = -h;
      solver.step(pose, dx, down);
      const double slope = (solver.evaluate(up, seen, nullptr, nullptr) -
                            solver.evaluate(down, seen, nullptr, nullptr)) /
                           (2.0 * h);
      // The prediction's rotation error is taken to turn as the joint does, right to first order.
      EXPECT_NEAR(-2.0 * g[i], slope, 0.02 * std::abs(slope) + 12.0) << "coordinate " << i;
    }
  }
}

TEST(PoseSolver, FreesTheJointsThatMarkersShow) {
  const PoseSolver solver(canonical_skeleton(), sites_of(plug_in_gait()));
  EXPECT_TRUE(solver.column(Joint::kSpineLower));  // the trunk's one segment bends here,
  EXPECT_TRUE(solver.column(Joint::kSpineUpper));  // and gives way here
  EXPECT_TRUE(solver.column(Joint::kNeck));
  EXPECT_TRUE(solver.column(Joint::kHead));
  EXPECT_TRUE(solver.column(Joint::kLeftClavicle));
  EXPECT_FALSE(solver.column(Joint::kLeftToes));  // no marker beyond the foot
}

TEST(PoseSolver, FindsAPoseFromNothing) {
  const Motion truth = moving_body(30);
  const MarkerSet set = plug_in_gait();
  const MarkerMotion markers = markers_on(truth, set);
  const PoseSolver solver(truth.skeleton, sites_of(set));
  const std::vector<double> sigma(set.places().size(), 0.005);
  for (const std::size_t f : {0u, 10u, 15u, 20u}) {
    for (const PoseSolver::Root root : PoseSolver::kRoots) {
      const PoseSolver::Observation seen{markers.frames[f].p_WM, sigma, 20.0, nullptr, nullptr};
      PlacedPose pose;
      PoseSolver::Matrix H;
      ASSERT_TRUE(solver.initialise(seen, root, pose));
      solver.solve(seen, 30, pose, H);
      for (const Joint joint : {Joint::kLeftHip, Joint::kRightKnee, Joint::kLeftElbow}) {
        EXPECT_LT(geodesic_distance(pose.q_PB[index(joint)], truth.poses[f].q_PB[index(joint)]),
                  1.0 * kDegree)
            << joint_name(joint) << " in frame " << f;
      }
    }
  }
}

TEST(RigidFit, FindsAMotionAndRefusesALine) {
  std::mt19937 generator(5);
  std::vector<Vector3d> a, b;
  Eigen::Isometry3d X = Eigen::Isometry3d::Identity(), found;
  X.linear() = random_rotation(generator).toRotationMatrix();
  X.translation() = random_vector(generator, 1.0);
  for (int i = 0; i < 3; ++i) {
    a.push_back(random_vector(generator, 0.2));
    b.push_back(X * a.back());
  }
  ASSERT_TRUE(rigid_fit(a, b, found));
  EXPECT_TRUE(found.isApprox(X, 1e-9));
  a = {{0, 0, 0}, {1, 0, 0}, {2, 0, 0}};
  EXPECT_FALSE(rigid_fit(a, a, found));
}

}  // namespace
}  // namespace secondskin::server
