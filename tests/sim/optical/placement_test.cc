#include "sim/optical/placement.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <map>

#include "scenes.h"

namespace secondskin::sim {
namespace {

constexpr double kPi = std::numbers::pi;

TEST(ScoreSuit, HasTheErrorOfTheClosedForm) {
  // A detector on the axis of two pairs that stand at right angles, each at a distance R: of the
  // four planes one is across x, one across y, two across z, each with a slope of g = 128 / (R tan
  // 15 deg) counts a metre. So trace((A^T A)^-1) = (1 + 1 + 1/2) / g^2.
  constexpr double kDistance = 4.0;
  Motion motion = standing();
  const Suit suit{"one", {{"one", 0, 0, Joint::kSpineUpper, 0.5, kPi / 4}}};
  SuitScene scene(motion, suit);
  std::vector<DetectorState> states(1);
  scene.at(0.0, states);
  std::vector<VirtualProjector> rig;
  for (const Eigen::Vector3d& side : {Eigen::Vector3d(1, 0, 0), Eigen::Vector3d(0, 1, 0)}) {
    for (const bool turned : {false, true}) {
      VirtualProjector projector;
      const Eigen::Vector3d up = Eigen::Vector3d::UnitZ();
      projector.X_WJ.linear() << up.cross(side), -up, -side;
      if (turned) projector.X_WJ.rotate(Eigen::AngleAxisd(-kPi / 2, up));
      projector.X_WJ.translation() = states[0].p_W + kDistance * side;
      rig.push_back(projector);
    }
  }
  OpticalNoise noise;
  noise.count_sigma = 0.5;
  const auto scores = score_suit(motion, suit, rig, noise);
  ASSERT_EQ(scores.size(), 1U);
  EXPECT_DOUBLE_EQ(scores[0].visible, 1.0);
  EXPECT_DOUBLE_EQ(scores[0].planes, 4.0);
  const double g = 128.0 / (kDistance * std::tan(kPi / 12.0));
  EXPECT_NEAR(scores[0].sigma, std::sqrt(2.5) / g * std::sqrt(0.25 + 1.0 / 12.0), 1e-9);
  EXPECT_EQ(scores[0].place.name, "one");

  rig.pop_back();  // three planes are no point (2.2.1)
  const auto less = score_suit(motion, suit, rig, noise);
  EXPECT_EQ(less[0].visible, 0.0);
  EXPECT_DOUBLE_EQ(less[0].planes, 3.0);
  EXPECT_TRUE(std::isnan(less[0].sigma));
}

TEST(ScoreSuit, CountsWhatTheVirtualRigGives) {
  const Motion motion = reference("squat");
  const Suit suit = shipped_suit("full_body");
  OpticalNoise noise = no_noise();
  noise.grazing = 0.0;
  const auto scores = score_suit(motion, suit, second_skin_rig(), noise);
  SuitScene scene(motion, suit);
  VirtualRig rig(second_skin_rig(), scene, noise, 1);
  std::vector<std::uint8_t> values(suit.detectors.size() * 16);
  std::vector<double> planes(suit.detectors.size());
  const auto instants = static_cast<int>(motion.duration() / 0.1) + 1;
  for (int k = 0; k < instants; ++k) {
    rig.cycle(0.1 * k, values);
    for (std::size_t i = 0; i < values.size(); ++i) planes[i / 16] += values[i] > 0 ? 1 : 0;
  }
  double difference = 0.0;
  for (std::size_t i = 0; i < planes.size(); ++i) {
    difference += std::abs(planes[i] / instants - scores[i].planes);
  }
  EXPECT_LT(difference / static_cast<double>(planes.size()), 0.1);
}

TEST(SweepPlaces, ChoosesPlacesAroundASegmentThatSeeMore) {
  const Motion motion = reference("squat");
  PlacementGrid grid;
  grid.segments = {Joint::kLeftElbow, Joint::kPelvis};
  grid.along = {0.2, 0.8};
  grid.angles = 8;
  PlacementOptions options;
  options.best = 4;
  const auto table = sweep_places(motion, grid, second_skin_rig(), {}, options);
  ASSERT_EQ(table.size(), 32U);
  for (const Joint segment : grid.segments) {
    std::map<std::size_t, PlacementScore> chosen;
    double mean = 0.0, mean_chosen = 0.0;
    for (const PlacementScore& score : table) {
      if (score.place.segment != segment) continue;
      mean += score.visible / 16.0;
      if (score.rank == 0) continue;
      EXPECT_TRUE(chosen.emplace(score.rank, score).second);
      mean_chosen += score.visible / 4.0;
    }
    ASSERT_EQ(chosen.size(), 4U);
    EXPECT_EQ(chosen.begin()->first, 1U);
    EXPECT_EQ(chosen.rbegin()->first, 4U);
    EXPECT_GE(mean_chosen, mean) << joint_name(segment);
    // Not on one line, and on more than one side.
    Eigen::Vector3d sum = Eigen::Vector3d::Zero();
    for (const auto& [rank, score] : chosen) {
      sum += skin_place(motion.skeleton, segment, score.place.along, score.place.angle).n_B;
    }
    EXPECT_LT(sum.norm(), 3.0);
  }
}

TEST(SweepPlaces, ChoosesNoPlaceThatSeesNothing) {
  auto rig = second_skin_rig();
  for (VirtualProjector& projector : rig) projector.dark = true;
  const auto table = sweep_places(standing(), {}, rig, {});
  EXPECT_EQ(table.size(), 15U * 60U);
  for (const PlacementScore& score : table) EXPECT_EQ(score.rank, 0U);
}

}  // namespace
}  // namespace secondskin::sim
