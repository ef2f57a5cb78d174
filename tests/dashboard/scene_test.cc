#include "clients/dashboard/scene.h"

#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

#include "motion/kinematics.h"

namespace secondskin::dashboard {
namespace {

using nlohmann::json;

TEST(Scene, PlacesEveryJointInItsParent) {
  const Skeleton body = canonical_skeleton();
  Pose pose(kJointCount);
  pose.p_WR = {1.0, 2.0, 3.0};
  pose.q_PB[index(Joint::kLeftElbow)] =
      Eigen::AngleAxisd(-0.5, Eigen::Vector3d::UnitY()) * Eigen::Quaterniond::Identity();
  const Figure figure{body, pose};
  const json tf = json::parse(frame_transforms(1'500'000'007, "ann", figure, &figure));
  ASSERT_EQ(tf["transforms"].size(), 2 * kJointCount);

  // Followed from the world, the tree gives forward kinematics back.
  std::vector<Eigen::Isometry3d> X_WB(kJointCount);
  forward_kinematics(body, pose.p_WR, pose.q_PB, X_WB);
  std::map<std::string, Eigen::Isometry3d> X_W{{"world", Eigen::Isometry3d::Identity()}};
  for (const json& t : tf["transforms"]) {
    EXPECT_EQ(t["timestamp"], json({{"sec", 1}, {"nsec", 500'000'007}}));
    const json &p = t["translation"], &q = t["rotation"];
    const Eigen::Isometry3d X_PB = Eigen::Translation3d(p["x"], p["y"], p["z"]) *
                                   Eigen::Quaterniond(q["w"].get<double>(), q["x"].get<double>(),
                                                      q["y"].get<double>(), q["z"].get<double>());
    X_W[t["child_frame_id"]] = X_W.at(t["parent_frame_id"]) * X_PB;
  }
  for (const std::string prefix : {"ann/", "ann/expert/"}) {
    for (std::size_t j = 0; j < kJointCount; ++j) {
      EXPECT_TRUE(X_W.at(prefix + body[j].name).isApprox(X_WB[j], 1e-9)) << body[j].name;
    }
  }
}

TEST(Scene, LightsATactorByItsStrongestSlot) {
  wire::BoardState state{};
  EXPECT_EQ(levels(state), (std::array<double, wire::kTactorCount>{}));
  state[wire::continuous_slot(2)] = 255;
  state[wire::pulsed_slot(9)] = 100;
  state[wire::saltation_slot(3, true)] = 54;
  const auto level = levels(state);
  EXPECT_EQ(level[2], 1.0);
  EXPECT_EQ(level[9], wire::drive_of(100).level);
  for (std::size_t t = 12; t < 16; ++t) EXPECT_EQ(level[t], wire::drive_of(54).level);
  EXPECT_EQ(level[3], 0.0);
}

TEST(Scene, DrawsLearnerExpertAndTactors) {
  const Skeleton body = canonical_skeleton();
  const Pose pose(kJointCount);
  const Figure figure{body, pose};
  const auto map = coach::BodyMap::load(SECONDSKIN_SOURCE_DIR "/body_maps/full_body.toml");
  std::array<double, wire::kTactorCount> level{};
  level[map.tactors[1].channel] = 1.0;
  const json scene = json::parse(scene_update(0, figure, &figure, map.tactors, level));
  ASSERT_EQ(scene["entities"].size(), 3u);
  EXPECT_EQ(scene["entities"][0]["id"], "learner");
  EXPECT_EQ(scene["entities"][1]["id"], "expert");
  const json& lit = scene["entities"][2]["spheres"];
  ASSERT_EQ(lit.size(), map.tactors.size());
  EXPECT_GT(lit[1]["size"]["x"], lit[0]["size"]["x"]);
  EXPECT_NE(lit[1]["color"], lit[0]["color"]);
  EXPECT_EQ(json::parse(scene_update(0, figure, nullptr, {}, level))["entities"].size(), 2u);
}

}  // namespace
}  // namespace secondskin::dashboard
