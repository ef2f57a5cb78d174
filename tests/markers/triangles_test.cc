#include "server/markers/triangles.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "motion/rotation.h"
#include "moving_body.h"
#include "tests/motion/random_pose.h"

namespace secondskin::server {
namespace {

using Eigen::Isometry3d;
using Eigen::Quaterniond;
using Eigen::Vector3d;

Isometry3d random_motion(std::mt19937& generator) {
  Isometry3d X = Isometry3d::Identity();
  X.linear() = random_rotation(generator).toRotationMatrix();
  X.translation() = random_vector(generator, 1.0);
  return X;
}

// Second Skin, 3.2: x to the second vertex, y = x * (third - first), z = x * y.
TEST(TrianglePose, HasThePapersAxes) {
  const auto X = triangle_pose({1, 1, 1}, {3, 1, 1}, {1, 2, 1});
  ASSERT_TRUE(X);
  EXPECT_TRUE(X->translation().isApprox(Vector3d(1, 1, 1)));
  EXPECT_TRUE(X->linear().col(0).isApprox(Vector3d::UnitX()));
  EXPECT_TRUE(X->linear().col(1).isApprox(Vector3d::UnitZ()));
  EXPECT_TRUE(X->linear().col(2).isApprox(-Vector3d::UnitY()));
  EXPECT_NEAR(X->linear().determinant(), 1.0, 1e-12);
}

TEST(TrianglePose, RefusesThreePointsOnALine) {
  EXPECT_FALSE(triangle_pose({0, 0, 0}, {0.1, 0, 0}, {0.2, 0.001, 0}));
  EXPECT_FALSE(triangle_pose({0, 0, 0}, {0, 0, 0}, {0.2, 0.1, 0}));
  EXPECT_FALSE(triangle_pose({0, 0, 0}, {NAN, 0, 0}, {0.2, 0.1, 0}));
  EXPECT_TRUE(triangle_pose({0, 0, 0}, {0.1, 0, 0}, {0.2, 0.05, 0}));
}

TEST(MeanRotation, OfATurnBothWaysIsNone) {
  std::mt19937 generator(1);
  for (int i = 0; i < 100; ++i) {
    const Quaterniond q = random_rotation(generator);
    const Vector3d v = random_vector(generator, 0.3);
    const std::array<Quaterniond, 2> both{q * quaternion_from(v), q * quaternion_from(-v)};
    EXPECT_LT(geodesic_distance(mean_rotation(both), q), 1e-6);
  }
}

// A trunk of four markers and an arm of two on it; the triangles find both again however they move.
TEST(TriangleSkeleton, GivesTheJointsBackForAnyMovement) {
  std::mt19937 generator(2);
  const std::vector<Vector3d> trunk{{0.1, 0, 0}, {-0.1, 0.1, 0.1}, {-0.1, -0.1, 0.2}, {0, 0, 0.3}};
  const std::vector<Vector3d> arm{{0.03, 0.02, -0.1}, {-0.03, 0.02, -0.3}};
  const Vector3d p_TA(0.0, 0.2, 0.3);
  const auto frame_of = [&](const Isometry3d& X_WT, const Isometry3d& X_WA) {
    MarkerFrame frame(6);
    for (std::size_t i = 0; i < 4; ++i) frame.p_WM[i] = X_WT * trunk[i];
    for (std::size_t i = 0; i < 2; ++i) frame.p_WM[4 + i] = X_WA * arm[i];
    frame.visible.assign(6, 1);
    return frame;
  };
  const auto shoulder = [&](const Isometry3d& X_WT, const Quaterniond& q) {
    Isometry3d X = X_WT;
    X.translate(p_TA);
    X.rotate(q);
    return X;
  };
  const Isometry3d X_WT0 = random_motion(generator);
  const Isometry3d X_WA0 = shoulder(X_WT0, random_rotation(generator));
  TriangleSkeleton skeleton(
      {{Joint::kSpineUpper, X_WT0, {0, 1, 2, 3}}, {Joint::kLeftShoulder, X_WA0, {4, 5}}},
      frame_of(X_WT0, X_WA0));
  Pose pose;
  for (int i = 0; i < 1000; ++i) {
    const Isometry3d X_WT = random_motion(generator);
    const Quaterniond q_TA = random_rotation(generator);
    const Isometry3d X_WA = shoulder(X_WT, q_TA);
    MarkerFrame frame = frame_of(X_WT, X_WA);
    frame.visible[static_cast<std::size_t>(i) % 4] = 0;  // one triangle of the trunk is enough
    skeleton.update(frame, pose);
    ASSERT_TRUE(skeleton.joint(Joint::kLeftShoulder));
    EXPECT_TRUE(skeleton.joint(Joint::kLeftShoulder)->isApprox(X_WA, 1e-9));
    EXPECT_TRUE(skeleton.joint(Joint::kSpineUpper)->isApprox(X_WT, 1e-9));
    // Between trunk and arm lies the clavicle, which has no markers and is at rest.
    EXPECT_LT(geodesic_distance(pose.q_PB[index(Joint::kLeftShoulder)], q_TA), 1e-6);
    EXPECT_EQ(pose.confidence[index(Joint::kLeftClavicle)], 0.0F);
  }
}

TEST(TriangleSkeleton, ShowsNothingOfAJointWithoutATriangle) {
  const Isometry3d X = Isometry3d::Identity();
  MarkerFrame frame(4);
  frame.p_WM = {{0.1, 0, 0}, {0, 0.1, 0}, {0, 0, 0.1}, {0.1, 0.1, 0.1}};
  frame.visible.assign(4, 1);
  TriangleSkeleton skeleton({{Joint::kPelvis, X, {0, 1, 2, 3}}}, frame);
  EXPECT_EQ(skeleton.triangles(), 8u);
  frame.visible[0] = frame.visible[1] = 0;
  Pose pose;
  skeleton.update(frame, pose);
  EXPECT_FALSE(skeleton.joint(Joint::kPelvis));
  EXPECT_EQ(pose.confidence[0], 0.0F);
}

TEST(TriangleSkeleton, NamesTheJointThatCannotBeCalibrated) {
  MarkerFrame frame(3);
  frame.p_WM = {{0, 0, 0}, {0.1, 0, 0}, {0.2, 0, 0}};
  frame.visible.assign(3, 1);
  try {
    (void)TriangleSkeleton({{Joint::kPelvis, Isometry3d::Identity(), {0, 1, 2}}}, frame);
    FAIL();
  } catch (const std::invalid_argument& error) {
    EXPECT_THAT(error.what(), testing::HasSubstr("pelvis"));
  }
}

TEST(CentreOfMarkers, IsTheTongsMiddle) {
  MarkerMotion motion{{"a", "b"}, 60.0, {MarkerFrame(2), MarkerFrame(2)}};
  for (MarkerFrame& frame : motion.frames) {
    frame.p_WM = {{1, 0, 0}, {1, 0.1, 0}};
    frame.visible.assign(2, 1);
  }
  motion.frames[1].p_WM[0] = {9, 9, 9};
  motion.frames[1].visible[1] = 0;  // not both: not used
  const std::array<std::size_t, 2> tongs{0, 1};
  EXPECT_TRUE(centre_of_markers(motion, tongs)->isApprox(Vector3d(1, 0.05, 0)));
}

// Two segments that turn about a common point by up to `degrees` about each of `axes` axes.
struct Turning {
  std::vector<Isometry3d> X_WP, X_WB;
};
Turning turning(double degrees, int axes, double noise) {
  std::mt19937 generator(3);
  std::uniform_real_distribution<double> uniform(-degrees * kDegree, degrees * kDegree);
  Turning result;
  const Vector3d p_PJ(0.1, 0.2, -0.3), p_BJ(0.0, 0.05, 0.2);
  for (int i = 0; i < 200; ++i) {
    const Isometry3d X_WP = random_motion(generator);
    Vector3d v(uniform(generator), uniform(generator), uniform(generator));
    for (int k = axes; k < 3; ++k) v[k] = 0.0;
    Isometry3d X_WB = X_WP;
    X_WB.linear() = X_WP.linear() * quaternion_from(v).toRotationMatrix();
    X_WB.translation() = X_WP * p_PJ - X_WB.linear() * p_BJ + random_vector(generator, noise);
    result.X_WP.push_back(X_WP);
    result.X_WB.push_back(X_WB);
  }
  return result;
}

TEST(CentreOfRotation, IsFoundWhereTheSegmentsMove) {
  const Turning t = turning(40.0, 3, 0.005);
  const auto centre = centre_of_rotation(t.X_WP, t.X_WB);
  ASSERT_TRUE(centre);
  EXPECT_LT((centre->p_PJ - Vector3d(0.1, 0.2, -0.3)).norm(), 0.005);
  EXPECT_LT((centre->p_BJ - Vector3d(0.0, 0.05, 0.2)).norm(), 0.005);
  EXPECT_NEAR(centre->residual, 0.005 * std::sqrt(3.0), 0.002);
}

TEST(CentreOfRotation, IsRefusedWithAReason) {
  const Turning little = turning(3.0, 3, 0.0), hinge = turning(40.0, 1, 0.0);
  EXPECT_EQ(centre_of_rotation(little.X_WP, little.X_WB).error(), NoCentre::kTooLittleMovement);
  EXPECT_EQ(centre_of_rotation(hinge.X_WP, hinge.X_WB).error(), NoCentre::kOneAxis);
  const Turning full = turning(40.0, 3, 0.0);
  EXPECT_EQ(
      centre_of_rotation(std::span(full.X_WP).first(5), std::span(full.X_WB).first(5)).error(),
      NoCentre::kTooFewFrames);
}

}  // namespace
}  // namespace secondskin::server
