#include "server/optical/calibrate/projector_fit.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <random>

#include "tests/optical/calibrate/synthetic.h"

namespace secondskin::server {
namespace {

// 2.2.2: twelve detectors on 4 x 4 feet, at two heights 36 inches apart.
std::vector<Eigen::Vector3d> grid_places(double raised = 36.0 * 0.0254) {
  std::vector<Eigen::Vector3d> out;
  for (const double z : {0.4, 0.4 + raised}) {
    for (int k = 0; k < 12; ++k) {
      out.emplace_back(-0.61 + 1.22 / 3.0 * (k % 4), -0.61 + 0.61 * (k / 4), z);
    }
  }
  return out;
}

std::vector<Reading> exact(const Projector& projector, const std::vector<Eigen::Vector3d>& places) {
  std::vector<Reading> out;
  for (const auto& p : places) out.push_back({p, projector.value(p)});
  return out;
}

double worst(const Projector& fit, const Projector& truth) {
  double worst = 0.0;
  for (const auto& p : grid_places()) {
    worst = std::max(worst, std::fabs(fit.value(p) - truth.value(p)));
  }
  return worst;
}

TEST(ProjectorFit, FindsTheSevenNumbersOfExactReadings) {
  for (const Projector& truth : test::make_rig()) {
    const auto readings = exact(truth, grid_places());
    const auto paper = fit_projector_algebraic(readings);
    const auto ours = fit_projector(readings);
    ASSERT_TRUE(paper && ours);
    EXPECT_LT((paper->P - truth.P).norm(), 1e-7 * truth.P.norm());
    EXPECT_LT((ours->projector.P - truth.P).norm(), 1e-7 * truth.P.norm());
    EXPECT_LT(ours->residual, 1e-7);
    EXPECT_EQ(ours->fitting, 24U);
  }
}

TEST(ProjectorFit, IsHardlyMovedByWildReadings) {
  std::mt19937 random(7);
  std::normal_distribution<double> normal;
  for (const Projector& truth : test::make_rig()) {
    auto readings = exact(truth, grid_places());
    for (auto& r : readings) r.value += 0.2 * normal(random);
    readings[3].value = 17.0;
    readings[11].value = 240.0;
    readings[20].value += 40.0;
    const auto ours = fit_projector(readings);
    ASSERT_TRUE(ours);
    EXPECT_LT(worst(ours->projector, truth), 1.0);
    EXPECT_LE(ours->fitting, 21U);
    const auto paper = fit_projector_algebraic(readings);
    ASSERT_TRUE(paper);
    EXPECT_GT(worst(*paper, truth), 3.0);
  }
}

TEST(ProjectorFit, RefusesWhatCannotDetermineAProjector) {
  const Projector truth = test::make_rig().front();
  const auto places = grid_places();
  const auto kind = [&](const std::vector<Eigen::Vector3d>& at) {
    const auto fit = fit_projector(exact(truth, at));
    const auto paper = fit_projector_algebraic(exact(truth, at));
    EXPECT_EQ(fit.has_value(), paper.has_value());
    return fit ? std::optional<RefusalKind>() : fit.error().kind;
  };
  EXPECT_EQ(kind({places.begin(), places.begin() + 6}), RefusalKind::kTooFewPoints);
  EXPECT_EQ(kind({}), RefusalKind::kTooFewPoints);
  // Many readings of few places.
  std::vector<Eigen::Vector3d> repeated;
  for (int k = 0; k < 50; ++k) repeated.push_back(places[static_cast<std::size_t>(k % 5)]);
  EXPECT_EQ(kind(repeated), RefusalKind::kTooFewPoints);
  // One height only, a tilted plane too.
  EXPECT_EQ(kind({places.begin(), places.begin() + 12}), RefusalKind::kDegenerate);
  auto tilted = grid_places(0.0);
  for (auto& p : tilted) p.z() += 0.3 * p.x();
  EXPECT_EQ(kind({tilted.begin(), tilted.begin() + 12}), RefusalKind::kDegenerate);
  std::vector<Eigen::Vector3d> line;
  for (int k = 0; k < 12; ++k) line.emplace_back(0.1 * k, 0.05 * k, 0.02 * k);
  EXPECT_EQ(kind(line), RefusalKind::kDegenerate);
}

TEST(ProjectorFit, RefusesValuesThatSayNothing) {
  std::vector<Reading> constant;
  for (const auto& p : grid_places()) constant.push_back({p, 100.0});
  const auto fit = fit_projector(constant);
  ASSERT_FALSE(fit);
  EXPECT_EQ(fit.error().kind, RefusalKind::kDegenerate);
  EXPECT_THAT(fit.error().text, testing::HasSubstr("seven numbers"));
}

}  // namespace
}  // namespace secondskin::server
