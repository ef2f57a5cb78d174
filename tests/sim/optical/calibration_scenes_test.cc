#include "sim/optical/calibration_scenes.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <set>

#include "scenes.h"

namespace secondskin::sim {
namespace {

constexpr double kFoot = 0.3048;

TEST(GridScene, IsTheGridOf2_2_2) {
  for (const double height : {0.0, GridScene::kRaised}) {
    GridScene scene(height);
    ASSERT_EQ(scene.detectors(), 12U);
    Eigen::AlignedBox3d box;
    std::set<std::pair<double, double>> places;
    for (const Eigen::Vector3d& p : scene.positions()) {
      box.extend(p);
      places.emplace(p.x(), p.y());
    }
    EXPECT_NEAR(box.sizes().x(), 4.0 * kFoot, 1e-12);
    EXPECT_NEAR(box.sizes().y(), 4.0 * kFoot, 1e-12);
    EXPECT_EQ(box.min().z(), height);
    EXPECT_EQ(box.max().z(), height);
    EXPECT_EQ(places.size(), 12U);
  }
  EXPECT_NEAR(GridScene::kRaised, 0.9144, 1e-12);
}

TEST(GridScene, TurnsEachDetectorTowardsEveryProjectorInPlace) {
  GridScene scene(GridScene::kRaised, 16.0);
  VirtualRig rig(second_skin_rig(), scene, no_noise(), 1);
  std::vector<std::uint8_t> values(12 * 16), best(12 * 16);
  for (double time = 0.0; time < 16.0; time += 0.2) {
    rig.cycle(time, values);
    for (std::size_t i = 0; i < values.size(); ++i) best[i] = std::max(best[i], values[i]);
  }
  const auto projectors = rig.projectors();
  for (std::size_t i = 0; i < 12; ++i) {
    for (std::size_t j = 0; j < 16; ++j) {
      const bool lit = projectors[j].coordinate(scene.positions()[i]).has_value();
      EXPECT_EQ(best[i * 16 + j] > 0, lit) << i << " " << j;
    }
  }
}

class Wand : public testing::Test {
 protected:
  WandScene scene_;
  std::vector<DetectorState> states_ = std::vector<DetectorState>(scene_.detectors());
  const std::vector<DetectorState>& at(double time) {
    scene_.at(time, states_);
    return states_;
  }
};

TEST_F(Wand, IsRigid) {
  const auto& p = scene_.options().p_TD;
  for (double time = 0.0; time < 70.0; time += 0.37) {
    at(time);
    for (std::size_t i = 0; i < p.size(); ++i) {
      for (std::size_t k = 0; k < i; ++k) {
        EXPECT_NEAR((states_[i].p_W - states_[k].p_W).norm(), (p[i] - p[k]).norm(), 1e-9);
      }
    }
  }
}

TEST_F(Wand, GoesThroughTheWholeVolumeInAllOrientations) {
  std::set<int> cells, directions;
  for (double time = 0.0; time < 60.0; time += 0.016) {
    at(time);
    for (const DetectorState& state : states_) {
      const double angle = std::atan2(state.p_W.y(), state.p_W.x());
      const int sector = static_cast<int>(4.0 * (angle / std::numbers::pi + 1.0)) % 8;
      const int ring = state.p_W.head<2>().norm() > 0.5 ? 1 : 0;
      const int floor = std::clamp(static_cast<int>(state.p_W.z() / 0.46), 0, 3);
      cells.insert(100 * floor + 10 * ring + sector);
    }
    const Eigen::Vector3d axis = (states_[1].p_W - states_[0].p_W).normalized();
    directions.insert((axis.x() > 0.3) - (axis.x() < -0.3) +
                      3 * ((axis.y() > 0.3) - (axis.y() < -0.3)) +
                      9 * ((axis.z() > 0.3) - (axis.z() < -0.3)));
  }
  EXPECT_GE(cells.size(), 60U);       // of 64
  EXPECT_GE(directions.size(), 24U);  // of 26
}

TEST_F(Wand, MovesAsAHandCan) {
  constexpr double kStep = 1e-3;
  double speed = 0.0, acceleration = 0.0;
  for (double time = kStep; time < 66.0; time += 0.05) {
    const Eigen::Vector3d a = at(time - kStep)[1].p_W, b = at(time)[1].p_W,
                          c = at(time + kStep)[1].p_W;
    speed = std::max(speed, (c - a).norm() / (2.0 * kStep));
    acceleration = std::max(acceleration, (c - 2.0 * b + a).norm() / (kStep * kStep));
  }
  EXPECT_LT(speed, 4.0);
  EXPECT_GT(speed, 0.5);
  EXPECT_LT(acceleration, 30.0);
}

TEST_F(Wand, LiesAtTheOriginInTheEnd) {
  for (const double time : {scene_.rests_from(), scene_.rests_from() + 5.0}) {
    at(time);
    for (std::size_t i = 0; i < states_.size(); ++i) {
      const Eigen::Vector3d rest(0.0, 0.0, scene_.options().rest_height);
      EXPECT_TRUE(states_[i].p_W.isApprox(scene_.options().p_TD[i] + rest, 1e-9));
    }
  }
}

TEST_F(Wand, IsLitAlsoOnTheFloor) {
  VirtualRig rig(second_skin_rig(), scene_, no_noise(), 1);
  std::vector<std::uint8_t> values(scene_.detectors() * 16);
  rig.cycle(scene_.rests_from() + 1.0, values);
  for (std::size_t i = 0; i < scene_.detectors(); ++i) {
    const auto row = std::span(values).subspan(i * 16, 16);
    EXPECT_GE(std::count_if(row.begin(), row.end(), [](int v) { return v > 0; }), 8) << i;
  }
}

TEST_F(Wand, IsAnotherForAnotherSeed) {
  WandScene other({}, 2);
  std::vector<DetectorState> states(other.detectors());
  other.at(10.0, states);
  EXPECT_GT((states[0].p_W - at(10.0)[0].p_W).norm(), 0.01);
  WandScene same;
  same.at(10.0, states);
  EXPECT_EQ(states[0].p_W, at(10.0)[0].p_W);
}

TEST(WandScene, NeedsTwoDetectors) {
  WandOptions options;
  options.p_TD.resize(1);
  EXPECT_THROW(WandScene{options}, std::invalid_argument);
}

TEST(TongsScene, HoldsTheJointInTheMiddleOutsideTheSkin) {
  SuitScene body(standing(), shipped_suit("second_skin"));
  for (const Joint joint : {Joint::kLeftShoulder, Joint::kLeftElbow, Joint::kRightKnee}) {
    TongsScene scene(body, joint);
    ASSERT_EQ(scene.detectors(), 28U);
    std::vector<DetectorState> states(28);
    scene.at(0.0, states);
    const Eigen::Vector3d centre = body.segments()[index(joint)].translation();
    EXPECT_TRUE((0.5 * (states[26].p_W + states[27].p_W)).isApprox(centre, 1e-12));
    const double radius = segment_capsule(body.skeleton(), joint).radius;
    EXPECT_GT((states[26].p_W - states[27].p_W).norm(), 2.0 * radius);
  }
}

}  // namespace
}  // namespace secondskin::sim
