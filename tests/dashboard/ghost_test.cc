#include "clients/dashboard/ghost.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <numbers>

#include "coach/correct/correction.h"
#include "motion/kinematics.h"
#include "motion/rotation.h"

namespace secondskin::dashboard {
namespace {

double lowest(const Skeleton& body, const Pose& pose) {
  std::vector<Eigen::Isometry3d> X_WB(body.size());
  forward_kinematics(body, pose.p_WR, pose.q_PB, X_WB);
  double z = 1e9;
  for (std::size_t j = 0; j < body.size(); ++j) {
    z = std::min({z, X_WB[j].translation().z(), (X_WB[j] * body[j].p_BE).z()});
  }
  return z;
}

class GhostTest : public testing::Test {
 protected:
  std::shared_ptr<const coach::Reference> load(const char* name) {
    const std::filesystem::path root = SECONDSKIN_SOURCE_DIR;
    return std::make_shared<const coach::Reference>(
        coach::load_reference(root / "reference_motions" / name, root / "joint_maps"));
  }
  // The expert's own pose, elsewhere, turned about the vertical.
  static Pose elsewhere(const Pose& pose, double heading, const Eigen::Vector3d& by) {
    Pose moved = pose;
    const Eigen::AngleAxisd turn(heading, Eigen::Vector3d::UnitZ());
    moved.q_PB[0] = turn * pose.q_PB[0];
    moved.p_WR += by;
    return moved;
  }
};

// A learner who does exactly as the expert is covered by the ghost, wherever they stand.
TEST_F(GhostTest, CoversALearnerWithoutErrors) {
  const auto reference = load("squat");
  const Skeleton& body = reference->motion.skeleton;
  Ghost ghost(reference, body);
  Pose out;
  for (std::size_t i = 0; i < reference->motion.poses.size(); ++i) {
    const Pose learner = elsewhere(reference->motion.poses[i], 2.0, {3.0, -1.0, 0.0});
    ghost.place(static_cast<double>(i) / reference->motion.rate_hz, learner, out);
    for (std::size_t j = 0; j < kJointCount; ++j) {
      EXPECT_LT(geodesic_distance(out.q_PB[j], learner.q_PB[j]), 1e-6) << i << " " << j;
    }
    EXPECT_NEAR(out.p_WR.x(), learner.p_WR.x(), 1e-9);
    EXPECT_NEAR(out.p_WR.y(), learner.p_WR.y(), 1e-9);
    // The floor is known by the lowest pose so far, and forgotten by half a millimetre a pose.
    EXPECT_NEAR(out.p_WR.z(), learner.p_WR.z(), 0.02) << i;
  }
}

TEST_F(GhostTest, StandsOnTheLearnersFloorWithTheLearnersLegs) {
  const auto reference = load("squat");
  const Skeleton child = canonical_skeleton(1.20);
  Ghost ghost(reference, child);
  Pose learner(kJointCount);
  learner.p_WR = {0.0, 0.0, 5.0};
  const double floor = lowest(child, learner);
  Pose out;
  double deepest = 1e9, highest = -1e9;
  for (double t = 0.0; t < reference->motion.duration(); t += 0.02) {
    ghost.place(t, learner, out);
    EXPECT_GE(lowest(child, out), floor - 1e-9);
    EXPECT_LT(lowest(child, out), floor + 0.05);  // a squat does not leave the ground
    deepest = std::min(deepest, out.p_WR.z());
    highest = std::max(highest, out.p_WR.z());
  }
  EXPECT_GT(highest - deepest, 0.1);  // and yet it goes down
}

// The ghost's pelvis is where joint_errors() wants the learner's: the error of a learner at the
// ghost's pose is none, and its size is the distance to the ghost.
TEST_F(GhostTest, TiltsThePelvisByTheErrorThatTheCoachSees) {
  const auto reference = load("deep_squat");
  Ghost ghost(reference, reference->motion.skeleton);
  const double t = 0.5 * reference->motion.duration();
  Pose learner;
  learner = reference->motion.poses[reference->motion.poses.size() / 2];
  learner.q_PB[0] = Eigen::AngleAxisd(1.0, Eigen::Vector3d::UnitZ()) * learner.q_PB[0] *
                    Eigen::AngleAxisd(0.3, Eigen::Vector3d::UnitY());
  Pose out;
  ghost.place(t, learner, out);
  auto error = coach::zero_vectors();
  joint_errors(*reference, t, learner, error);
  EXPECT_NEAR(geodesic_distance(out.q_PB[0], learner.q_PB[0]), error[0].norm(), 1e-6);
  joint_errors(*reference, t, out, error);
  EXPECT_LT(error[0].norm(), 1e-6);
}

}  // namespace
}  // namespace secondskin::dashboard
