#include "server/optical/track/segment_filter.h"

#include <gtest/gtest.h>

#include <Eigen/Eigenvalues>
#include <random>

#include "motion/rotation.h"
#include "ring_rig.h"

namespace secondskin::server {
namespace {

const SegmentMotion kMotion{{50.0, 0.3}, {500.0, 0.3}};

Eigen::Vector3d any(std::mt19937& random, double size) {
  std::normal_distribution<double> normal(0.0, size);
  return {normal(random), normal(random), normal(random)};
}

// A limb somewhere in motion with five detectors on it.
SegmentFilter any_limb(std::mt19937& random) {
  SegmentFilter filter(5, kMotion, {});
  filter.begin({0.1, 0.2, 1.0}, any(random, 0.5));
  for (std::size_t i = 0; i < 5; ++i) {
    filter.place(i, Eigen::Vector3d(0.1, 0.2, 1.0) + any(random, 0.08),
                 2e-5 * Eigen::Matrix3d::Identity(), 0.0);
  }
  return filter;
}

TEST(SegmentFilter, ADetectorIsWhereItWasPlacedAndKnownAsWell) {
  std::mt19937 random(10);
  for (int draw = 0; draw < 50; ++draw) {
    SegmentFilter filter(4, kMotion, {});
    filter.begin({0.1, 0.2, 1.0}, any(random, 1.0));
    for (int k = 0; k < 10; ++k) filter.predict(0.016);
    const Eigen::Vector3d p_WD = Eigen::Vector3d(0.2, 0.1, 1.1) + any(random, 0.1);
    const Eigen::Matrix3d covariance = Eigen::Vector3d(1e-5, 2e-5, 3e-5).asDiagonal();
    filter.place(2, p_WD, covariance, 0.008);
    const auto point = filter.point(2, 0.008);
    EXPECT_LT((point.p_WD - p_WD).norm(), 1e-12);
    // What is not known of the limb's pose is not added: the place is relative to it.
    EXPECT_NEAR(filter.sigma(2, point), std::sqrt(6e-5), 1e-9);
  }
}

TEST(SegmentFilter, KnowsHowAValueDependsOnItsState) {
  // A value that is measured without noise ends at nu = 0 after one correction, to first order; and
  // the variance falls as S says.
  const ProjectorRig rig = ring_rig();
  std::mt19937 random(11);
  for (int draw = 0; draw < 200; ++draw) {
    SegmentFilter filter = any_limb(random);
    for (int k = 0; k < 2; ++k) filter.predict(0.004);
    const Projector& projector = *rig.projectors[static_cast<std::size_t>(draw % 16)];
    const double lead = 0.001 * (draw % 16) - 0.008;
    const std::size_t i = static_cast<std::size_t>(draw % 5);
    const auto before = filter.point(i, lead);
    const double z = projector.value(before.p_WD) + 0.05;
    const double S = filter.innovation_variance(i, before, projector.gradient(before.p_WD), 1e-9);
    filter.correct(0.05, S);
    const auto after = filter.point(i, lead);
    EXPECT_NEAR(projector.value(after.p_WD), z, 5e-4);
    EXPECT_NEAR(filter.innovation_variance(i, after, projector.gradient(after.p_WD), 0.0), 0.0,
                1e-3 * S);
  }
}

TEST(SegmentFilter, CovarianceStaysSymmetricAndPositive) {
  const ProjectorRig rig = ring_rig();
  std::mt19937 random(12);
  std::normal_distribution<double> normal;
  SegmentFilter filter = any_limb(random);
  for (int cycle = 0; cycle < 500; ++cycle) {
    filter.predict(0.016);
    for (std::size_t p = 0; p < 16; ++p) {
      const std::size_t i = (p + static_cast<std::size_t>(cycle)) % 5;
      const auto point = filter.point(i, 0.0);
      const auto& projector = *rig.projectors[p];
      const double S = filter.innovation_variance(i, point, projector.gradient(point.p_WD), 0.37);
      filter.correct(0.6 * normal(random), S);
    }
    if (cycle % 20 != 0) continue;
    const Eigen::MatrixXd& P = filter.covariance();
    EXPECT_LT((P - P.transpose()).norm(), 1e-9 * P.norm());
    EXPECT_GT(Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd>(P).eigenvalues().minCoeff(), -1e-12);
  }
}

TEST(SegmentFilter, PlacesDriftButNeverAllTogether) {
  std::mt19937 random(13);
  SegmentFilter filter = any_limb(random);
  std::vector<Eigen::Vector3d> places;
  for (std::size_t i = 0; i < 5; ++i) places.push_back(filter.point(i, 0.0).p_BD_W);
  const Eigen::MatrixXd before = filter.covariance().bottomRightCorner(15, 15);
  filter.predict(0.3);
  const Eigen::MatrixXd added = filter.covariance().bottomRightCorner(15, 15) - before;
  EXPECT_NEAR(added.trace(), 0.3 * 0.002 * 0.002 * 9.0, 1e-9);  // 15 less 6 rigid motions
  for (int axis = 0; axis < 3; ++axis) {
    Eigen::VectorXd shift(15), turn(15);
    for (std::size_t i = 0; i < 5; ++i) {
      shift.segment<3>(3 * static_cast<Eigen::Index>(i)) = Eigen::Vector3d::Unit(axis);
      turn.segment<3>(3 * static_cast<Eigen::Index>(i)) =
          Eigen::Vector3d::Unit(axis).cross(places[i]);
    }
    EXPECT_NEAR(shift.dot(added * shift), 0.0, 1e-12);
    EXPECT_NEAR(turn.dot(added * turn), 0.0, 1e-12);
  }
}

TEST(SegmentFilter, MixKeepsTwoFiltersThatAgreeAsTheyAre) {
  std::mt19937 random(14);
  SegmentFilter a = any_limb(random);
  SegmentFilter b = a;
  const Eigen::MatrixXd before = a.covariance();
  const auto point = a.point(3, 0.005);
  SegmentFilter::mix(a, b, 0.9, 0.2);
  EXPECT_LT((a.covariance() - before).norm(), 1e-12);
  EXPECT_LT((b.covariance() - before).norm(), 1e-12);
  EXPECT_LT((a.point(3, 0.005).p_WD - point.p_WD).norm(), 1e-12);
}

TEST(SegmentFilter, MixMovesEachByItsShare) {
  std::mt19937 random(15);
  SegmentFilter a = any_limb(random);
  SegmentFilter b = a;
  const auto point = b.point(1, 0.0);
  const double S = b.innovation_variance(1, point, {100.0, 20.0, 30.0}, 0.3);
  b.correct(2.0, S);
  const Eigen::Vector3d p_a = a.point(1, 0.0).p_WD, p_b = b.point(1, 0.0).p_WD;
  SegmentFilter::mix(a, b, 0.75, 0.0);
  EXPECT_LT((a.point(1, 0.0).p_WD - (0.75 * p_a + 0.25 * p_b)).norm(),
            1e-4 * (p_a - p_b).norm() + 1e-7);
  EXPECT_LT((b.point(1, 0.0).p_WD - p_b).norm(), 1e-12);
}

TEST(SegmentFilter, AForgottenDetectorLeavesNothing) {
  std::mt19937 random(16);
  SegmentFilter filter = any_limb(random);
  filter.forget(4);
  EXPECT_FALSE(filter.placed(4));
  EXPECT_EQ(filter.covariance().bottomRows(3).norm(), 0.0);
  EXPECT_EQ(filter.covariance().rightCols(3).norm(), 0.0);
}

}  // namespace
}  // namespace secondskin::server
