#include "sim/optical/suit_scene.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "scenes.h"

namespace secondskin::sim {
namespace {

constexpr double kPi = std::numbers::pi;

TEST(SuitScene, RefusesABodyThatIsNotCanonical) {
  Motion motion = standing();
  motion.poses.clear();
  EXPECT_THROW(SuitScene(motion, shipped_suit("full_body")), std::invalid_argument);
  std::vector<Segment> root(1);
  root[0].name = "root";
  const Motion other{Skeleton(root), 60.0, {Pose(1)}};
  EXPECT_THROW(SuitScene(other, shipped_suit("full_body")), std::invalid_argument);
}

TEST(SuitScene, CarriesItsDetectorsOnTheSkinOfTheTruePose) {
  const Motion motion = reference("low_block");
  SuitScene scene(motion, shipped_suit("full_body"));
  std::vector<DetectorState> states(scene.detectors());
  Pose pose;
  std::vector<Eigen::Isometry3d> X_WB(kJointCount);
  for (double time = 0.0; time < motion.duration(); time += 0.31) {
    scene.at(time, states);
    scene.pose_at(time, pose);
    forward_kinematics(scene.skeleton(), pose.p_WR, pose.q_PB, X_WB);
    for (std::size_t i = 0; i < states.size(); ++i) {
      const Eigen::Isometry3d& X = X_WB[index(scene.segment(i))];
      EXPECT_TRUE(states[i].p_W.isApprox(X * scene.place(i).p_BS, 1e-12));
      EXPECT_TRUE(states[i].n_W.isApprox(X.linear() * scene.place(i).n_B, 1e-12));
    }
  }
}

TEST(SuitScene, HoldsLoopsOrComesBack) {
  Motion motion = standing(61);  // one second
  for (std::size_t i = 0; i < 61; ++i) motion.poses[i].p_WR.x() = static_cast<double>(i) / 60.0;
  const auto x = [&](AtEnd at_end, double time) {
    const SuitScene scene(motion, {}, at_end);
    Pose pose;
    scene.pose_at(time, pose);
    return pose.p_WR.x();
  };
  EXPECT_NEAR(x(AtEnd::kHold, 0.3), 0.3, 1e-9);
  EXPECT_NEAR(x(AtEnd::kHold, 7.3), 1.0, 1e-9);
  EXPECT_NEAR(x(AtEnd::kLoop, 7.3), 0.3, 1e-9);
  EXPECT_NEAR(x(AtEnd::kThereAndBack, 0.3), 0.3, 1e-9);
  EXPECT_NEAR(x(AtEnd::kThereAndBack, 1.3), 0.7, 1e-9);
  EXPECT_NEAR(x(AtEnd::kThereAndBack, 2.3), 0.3, 1e-9);
}

// A suit of one detector.
Suit one(Joint segment, double along, double angle_deg) {
  Suit suit{"one", {{}}};
  suit.detectors[0] = {"one", 0, 0, segment, along, angle_deg * kPi / 180.0};
  return suit;
}

bool hidden(const Suit& suit, const Eigen::Vector3d& p_W, const Motion& motion = standing()) {
  SuitScene scene(motion, suit);
  std::vector<DetectorState> states(1);
  scene.at(0.0, states);
  return scene.hidden(0, p_W);
}

TEST(SuitScene, TheTrunkHidesTheFarArm) {
  // The left hand hangs at the left; its inner side looks at the right.
  const Suit inner = one(Joint::kLeftElbow, 0.5, -90.0);
  EXPECT_TRUE(hidden(inner, {0.0, -3.35, 1.05}));
  EXPECT_FALSE(hidden(inner, {3.35, 0.2, 1.05}));
  EXPECT_FALSE(hidden(inner, {-3.35, 0.2, 1.05}));
}

TEST(SuitScene, ARaisedArmHidesTheFace) {
  Motion motion = standing();
  const Suit brow = one(Joint::kHead, 0.0, 0.0);
  const Eigen::Vector3d ahead(3.35, 0.0, 1.6);
  EXPECT_FALSE(hidden(brow, ahead, motion));
  // The left arm forward and up to the height of the eyes, the forearm across before the face.
  for (Pose& pose : motion.poses) {
    pose.q_PB[index(Joint::kLeftShoulder)] = Eigen::AngleAxisd(-2.18, Eigen::Vector3d::UnitY());
    pose.q_PB[index(Joint::kLeftElbow)] = Eigen::AngleAxisd(-kPi / 2, Eigen::Vector3d::UnitX());
  }
  EXPECT_TRUE(hidden(brow, ahead, motion));
}

TEST(SuitScene, NoDetectorIsHiddenBySkinThatItSitsOn) {
  SuitScene scene(standing(), shipped_suit("full_body"));
  std::vector<DetectorState> states(scene.detectors());
  scene.at(0.0, states);
  int seen = 0;
  for (std::size_t i = 0; i < states.size(); ++i) {
    // Straight out: at rest hardly anything is in the way but between the legs and under the arms.
    seen += scene.hidden(i, states[i].p_W + 2.0 * states[i].n_W) ? 0 : 1;
  }
  EXPECT_GT(seen, 70);
  EXPECT_LT(seen, 90);
}

class StandingSuit : public testing::Test {
 protected:
  // How many projectors each detector receives, and from which side they come.
  void look(const std::string& suit) {
    SuitScene scene(standing(), shipped_suit(suit));
    VirtualRig rig(second_skin_rig(), scene, no_noise(), 1);
    values_.resize(scene.detectors() * 16);
    rig.cycle(0.0, values_);
    projectors_ = rig.projectors();
    suit_ = shipped_suit(suit);
  }
  std::size_t seen(std::size_t detector) const {
    const auto row = std::span(values_).subspan(detector * 16, 16);
    return static_cast<std::size_t>(std::count_if(row.begin(), row.end(), [](int v) { return v; }));
  }
  std::vector<std::uint8_t> values_;
  std::vector<VirtualProjector> projectors_;
  Suit suit_;
};

TEST_F(StandingSuit, MostDetectorsSeeFourProjectors) {
  for (const char* suit : {"second_skin", "full_body"}) {
    look(suit);
    std::size_t tracked = 0, sum = 0;
    for (std::size_t i = 0; i < suit_.detectors.size(); ++i) {
      tracked += seen(i) >= 4 ? 1 : 0;
      sum += seen(i);
    }
    const auto count = static_cast<double>(suit_.detectors.size());
    EXPECT_GT(static_cast<double>(tracked), 0.7 * count) << suit;
    // A detector sees at most three of the eight pairs.
    EXPECT_LT(static_cast<double>(sum), 6.5 * count) << suit;
  }
}

TEST_F(StandingSuit, EveryMeasuredSegmentHasThreeTrackedDetectors) {
  look("full_body");
  for (const Joint segment :
       {Joint::kPelvis, Joint::kSpineUpper, Joint::kLeftShoulder, Joint::kLeftElbow,
        Joint::kLeftHip, Joint::kLeftKnee, Joint::kLeftAnkle}) {
    int tracked = 0;
    for (std::size_t i = 0; i < suit_.detectors.size(); ++i) {
      tracked += suit_.detectors[i].segment == segment && seen(i) >= 4 ? 1 : 0;
    }
    EXPECT_GE(tracked, 3) << joint_name(segment);
  }
}

TEST_F(StandingSuit, TheBackSeesNoProjectorInFront) {
  look("second_skin");
  int back = 0;
  for (std::size_t i = 0; i < suit_.detectors.size(); ++i) {
    if (suit_.detectors[i].name.find("back") != 0) continue;
    ++back;
    for (std::size_t j = 0; j < 16; ++j) {
      const bool in_front = projectors_[j].X_WJ.translation().x() > 0.1;
      if (in_front) {
        EXPECT_EQ(values_[i * 16 + j], 0) << suit_.detectors[i].name;
      }
    }
    EXPECT_GE(seen(i), 4U) << suit_.detectors[i].name;
  }
  EXPECT_EQ(back, 6);
}

TEST(Recentred, TakesAWalkAwayAndLeavesTheRest) {
  Motion walk = standing(600);
  for (std::size_t i = 0; i < 600; ++i) {
    const double t = static_cast<double>(i) / 60.0;
    walk.poses[i].p_WR += Eigen::Vector3d(1.3 * t, -0.4 * t + 2.0, 0.02 * std::sin(9.0 * t));
  }
  const Motion result = recentred(walk);
  for (std::size_t i = 0; i < 600; ++i) {
    EXPECT_NEAR(result.poses[i].p_WR.head<2>().norm(), 0.0, 1e-9);
    EXPECT_EQ(result.poses[i].p_WR.z(), walk.poses[i].p_WR.z());
  }
}

TEST(Recentred, KeepsARecordedMotionInTheVolume) {
  const Motion motion = reference("stepping_punch");
  const auto farthest = [](const Motion& m) {
    double far = 0.0;
    for (const Pose& pose : m.poses) far = std::max(far, pose.p_WR.head<2>().norm());
    return far;
  };
  EXPECT_GT(farthest(motion), 0.4);
  const Motion result = recentred(motion);
  EXPECT_LT(farthest(result), 0.25);
  for (std::size_t i = 0; i < motion.poses.size(); ++i) {
    EXPECT_TRUE(result.poses[i].q_PB[5].coeffs() == motion.poses[i].q_PB[5].coeffs());
  }
}

TEST(Recentred, TakesOnlyTheMeanAwayForEver) {
  Motion motion = standing(3);
  motion.poses[0].p_WR.x() = 1.0;
  motion.poses[2].p_WR.x() = 5.0;
  const Motion result = recentred(motion, INFINITY);
  EXPECT_NEAR(result.poses[0].p_WR.x(), -1.0, 1e-12);
  EXPECT_NEAR(result.poses[1].p_WR.x(), -2.0, 1e-12);
  EXPECT_NEAR(result.poses[2].p_WR.x(), 3.0, 1e-12);
}

}  // namespace
}  // namespace secondskin::sim
