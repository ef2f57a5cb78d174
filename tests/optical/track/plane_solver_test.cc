#include "server/optical/track/plane_solver.h"

#include <gtest/gtest.h>

#include <Eigen/LU>
#include <array>
#include <cmath>
#include <limits>
#include <random>

#include "ring_rig.h"

namespace secondskin::server {
namespace {

std::vector<Plane> planes_at(const ProjectorRig& rig, const Eigen::Vector3d& p_W,
                             const std::vector<std::size_t>& slots) {
  std::vector<Plane> planes;
  for (const std::size_t p : slots) {
    planes.push_back(rig.projectors[p]->plane(rig.projectors[p]->value(p_W)));
  }
  return planes;
}

double residual_norm(const std::vector<Plane>& planes, const Eigen::Vector3d& p_W) {
  double sum = 0.0;
  for (const Plane& plane : planes) sum += std::pow(plane.a.dot(p_W) - plane.b, 2);
  return std::sqrt(sum);
}

TEST(Planes, MeetAtTheDetector) {  // 2.2.3
  const ProjectorRig rig = ring_rig();
  const Eigen::Vector3d p_W(0.3, -0.4, 1.2);
  const auto point = intersect(planes_at(rig, p_W, {0, 1, 2, 3}));
  ASSERT_TRUE(point);
  EXPECT_LT((point->p_W - p_W).norm(), 1e-9);
  EXPECT_LT(point->residual_norm, 1e-9);
  EXPECT_EQ(point->rows, 4U);
}

TEST(Planes, ResidualIsTheErrorInCountsWhateverTheUnitOfLength) {
  const ProjectorRig rig = ring_rig();
  const Projector& projector = *rig.projectors[0];
  const Eigen::Vector3d p_W(0.0, 0.2, 0.0);
  const double v = projector.value(p_W);
  const double h = projector.P.row(1).head<3>().dot(p_W) + 1.0;
  const Plane metres = projector.plane(v + 2.0);
  EXPECT_NEAR(metres.a.dot(p_W) - metres.b, -2.0 * h, 1e-9);
  Projector tenths = projector;  // p in 0.1 inch, the paper's unit
  tenths.P.leftCols<3>() *= 0.00254;
  const Plane plane = tenths.plane(v + 2.0);
  EXPECT_NEAR(plane.a.dot(p_W / 0.00254) - plane.b, -2.0 * h, 1e-9);
}

TEST(Planes, NeedFourAndAllDirections) {
  const ProjectorRig rig = ring_rig();
  const Eigen::Vector3d p_W(0.1, 0.1, 1.0);
  EXPECT_FALSE(intersect(planes_at(rig, p_W, {0, 1, 2})));
  EXPECT_FALSE(intersect({}));
  const Plane floor{Eigen::Vector3d::UnitZ(), 0.0};
  EXPECT_FALSE(intersect(std::vector<Plane>(6, floor)));
  auto planes = planes_at(rig, p_W, {0, 1, 2, 3, 4});
  planes[2].b = std::numeric_limits<double>::quiet_NaN();
  EXPECT_FALSE(intersect(planes));
  std::array<std::uint8_t, 5> used{};
  EXPECT_FALSE(intersect_filtered(planes, 10.0, used));
}

TEST(FilteredLeastSquares, RemovesOneOutlierOfFive) {  // the example of 2.2.5
  const ProjectorRig rig = ring_rig();
  const Eigen::Vector3d p_W(0.2, 0.3, 0.9);
  // Two upright planes and three that lie: any of the three can be told wrong by the other two.
  const std::vector<std::size_t> slots{0, 1, 2, 3, 5};
  for (const std::size_t wild : {1U, 3U, 4U}) {
    auto planes = planes_at(rig, p_W, slots);
    const Projector& projector = *rig.projectors[slots[wild]];
    planes[wild] = projector.plane(projector.value(p_W) + 60.0);
    std::array<std::uint8_t, 5> used{};
    const auto point = intersect_filtered(planes, 10.0, used);
    ASSERT_TRUE(point);
    EXPECT_LT((point->p_W - p_W).norm(), 1e-9);
    EXPECT_EQ(point->rows, 4U);
    EXPECT_EQ(used[wild], 0);
  }
}

TEST(FilteredLeastSquares, RemovesTwoOutliersOfEight) {
  const ProjectorRig rig = ring_rig();
  const Eigen::Vector3d p_W(0.2, 0.3, 0.9);
  const std::vector<std::size_t> slots{0, 1, 2, 3, 4, 5, 6, 7};
  auto planes = planes_at(rig, p_W, slots);
  planes[1] = rig.projectors[1]->plane(20.0);
  planes[6] = rig.projectors[6]->plane(220.0);
  std::array<std::uint8_t, 8> used{};
  const auto point = intersect_filtered(planes, std::sqrt(kPaperVarianceLimit), used);
  ASSERT_TRUE(point);
  EXPECT_LT((point->p_W - p_W).norm(), 1e-9);
  EXPECT_EQ(used, (std::array<std::uint8_t, 8>{1, 0, 1, 1, 1, 1, 0, 1}));
  // The plain solution is far off (2.2.5: "quite far away from the correct solution").
  EXPECT_GT((intersect(planes)->p_W - p_W).norm(), 0.1);
}

TEST(FilteredLeastSquares, GivesNothingWhenFourRowsStillDisagree) {  // the paper's 9999
  const ProjectorRig rig = ring_rig();
  const Eigen::Vector3d p_W(0.2, 0.3, 0.9);
  auto planes = planes_at(rig, p_W, {0, 1, 2, 3});
  planes[1] = rig.projectors[1]->plane(250.0);
  std::array<std::uint8_t, 4> used{};
  EXPECT_FALSE(intersect_filtered(planes, 10.0, used));
}

TEST(FilteredLeastSquares, RemovesTheRowWhoseRemovalLeavesLeast) {
  // Against solving anew without each row, as the paper does.
  const ProjectorRig rig = ring_rig();
  std::mt19937 random(1);
  std::uniform_real_distribution<double> place(-0.8, 0.8), value(1.0, 254.0);
  std::normal_distribution<double> normal;
  int removed = 0;
  for (int draw = 0; draw < 1000; ++draw) {
    const Eigen::Vector3d p_W(place(random), place(random), 1.0 + place(random));
    std::vector<Plane> planes;
    for (std::size_t p = 0; p < 7; ++p) {
      planes.push_back(rig.projectors[p]->plane(rig.projectors[p]->value(p_W) + normal(random)));
    }
    planes[static_cast<std::size_t>(draw % 7)] =
        rig.projectors[static_cast<std::size_t>(draw % 7)]->plane(value(random));
    std::array<std::uint8_t, 7> used{};
    const auto point = intersect_filtered(planes, 5.0, used);
    if (!point || point->rows != 6) continue;
    ++removed;
    double least = 1e300;
    for (std::size_t leave = 0; leave < 7; ++leave) {
      auto rest = planes;
      rest.erase(rest.begin() + static_cast<std::ptrdiff_t>(leave));
      if (const auto other = intersect(rest)) least = std::min(least, other->residual_norm);
    }
    EXPECT_NEAR(point->residual_norm, least, 1e-6);
  }
  EXPECT_GT(removed, 500);
}

TEST(Planes, LeastSquaresPointHasTheSmallestResidual) {
  const ProjectorRig rig = ring_rig();
  std::mt19937 random(2);
  std::normal_distribution<double> normal;
  std::vector<Plane> planes;
  for (std::size_t p = 0; p < 6; ++p) {
    const double v = rig.projectors[p]->value({0.1, 0.2, 1.1}) + normal(random);
    planes.push_back(rig.projectors[p]->plane(v));
  }
  const auto point = intersect(planes);
  ASSERT_TRUE(point);
  EXPECT_NEAR(point->residual_norm, residual_norm(planes, point->p_W), 1e-9);
  for (int i = 0; i < 100; ++i) {
    const Eigen::Vector3d other =
        point->p_W + 1e-3 * Eigen::Vector3d(normal(random), normal(random), normal(random));
    EXPECT_GT(residual_norm(planes, other), point->residual_norm);
  }
}

}  // namespace
}  // namespace secondskin::server
