#include "motion/anatomy.h"

#include <gtest/gtest.h>

#include <stdexcept>
#include <vector>

#include "motion/kinematics.h"
#include "motion/rotation.h"
#include "random_pose.h"

namespace secondskin {
namespace {

constexpr double kPi = std::numbers::pi;
constexpr std::size_t kFlexion = 0, kAbduction = 1, kRotation = 2;

double degrees(double radians) { return radians * 180.0 / kPi; }

// Where a joint's segment ends when that joint alone makes one movement of 30 degrees, relative to
// where it ends at rest.
Eigen::Vector3d displacement(Joint joint, std::size_t movement, Joint end) {
  const Skeleton body = canonical_skeleton();
  std::vector<Eigen::Isometry3d> rest(kJointCount), X_WB(kJointCount);
  Pose pose(kJointCount);
  forward_kinematics(body, pose.p_WR, pose.q_PB, rest);
  JointAngles angles{};
  angles[movement] = kPi / 6;
  pose.q_PB[index(joint)] = joint_rotation(joint, angles);
  forward_kinematics(body, pose.p_WR, pose.q_PB, X_WB);
  const Eigen::Vector3d tip = body[index(end)].p_BE;
  return X_WB[index(end)] * tip - rest[index(end)] * tip;
}

TEST(Anatomy, HasTheDesignsNamesInOrderWithParentsFirst) {
  const std::vector<std::string_view> names{
      "pelvis",         "spine_lower",    "spine_middle",  "spine_upper", "neck",
      "head",           "left_clavicle",  "left_shoulder", "left_elbow",  "left_wrist",
      "right_clavicle", "right_shoulder", "right_elbow",   "right_wrist", "left_hip",
      "left_knee",      "left_ankle",     "left_toes",     "right_hip",   "right_knee",
      "right_ankle",    "right_toes"};
  for (std::size_t i = 0; i < kJointCount; ++i) {
    const auto joint = static_cast<Joint>(i);
    EXPECT_EQ(joint_name(joint), names[i]);
    EXPECT_EQ(find_joint(names[i]), joint);
    if (i > 0) {
      EXPECT_LT(index(canonical_anatomy()[i].parent), i);
    }
  }
  EXPECT_EQ(find_joint("left_tail"), std::nullopt);
}

TEST(Anatomy, FlexionMovesLimbsForwardAndTheShankBack) {
  for (const auto& [joint, end, forward] :
       std::vector<std::tuple<Joint, Joint, double>>{{Joint::kLeftShoulder, Joint::kLeftWrist, 1},
                                                     {Joint::kRightShoulder, Joint::kRightWrist, 1},
                                                     {Joint::kLeftElbow, Joint::kLeftWrist, 1},
                                                     {Joint::kRightElbow, Joint::kRightWrist, 1},
                                                     {Joint::kLeftHip, Joint::kLeftKnee, 1},
                                                     {Joint::kRightHip, Joint::kRightKnee, 1},
                                                     {Joint::kLeftKnee, Joint::kLeftKnee, -1},
                                                     {Joint::kRightKnee, Joint::kRightKnee, -1},
                                                     {Joint::kSpineLower, Joint::kHead, 1},
                                                     {Joint::kNeck, Joint::kHead, 1}}) {
    const Eigen::Vector3d d = displacement(joint, kFlexion, end);
    EXPECT_GT(forward * d.x(), 0.05) << joint_name(joint);
    EXPECT_NEAR(d.y(), 0.0, 1e-12) << joint_name(joint);
  }
  EXPECT_GT(displacement(Joint::kLeftAnkle, kFlexion, Joint::kLeftToes).z(), 0.02);  // dorsiflexion
  EXPECT_GT(displacement(Joint::kRightAnkle, kFlexion, Joint::kRightToes).z(), 0.02);
}

TEST(Anatomy, AbductionMovesLimbsOutwardAndTheTrunkToTheRight) {
  for (const Joint joint : {Joint::kLeftShoulder, Joint::kLeftHip}) {
    EXPECT_GT(displacement(joint, kAbduction, joint).y(), 0.05) << joint_name(joint);
    EXPECT_LT(displacement(mirrored(joint), kAbduction, mirrored(joint)).y(), -0.05);
  }
  EXPECT_LT(displacement(Joint::kSpineLower, kAbduction, Joint::kHead).y(), -0.05);
  EXPECT_GT(displacement(Joint::kLeftClavicle, kAbduction, Joint::kLeftClavicle).z(), 0.02);
  EXPECT_GT(displacement(Joint::kRightClavicle, kAbduction, Joint::kRightClavicle).z(), 0.02);
}

TEST(Anatomy, InternalRotationTurnsTheFrontInwardAndTheTrunkToTheLeft) {
  // Seen through what the limb carries: a bent forearm, the foot.
  EXPECT_LT(displacement(Joint::kLeftHip, kRotation, Joint::kLeftToes).y(), -0.02);
  EXPECT_GT(displacement(Joint::kRightHip, kRotation, Joint::kRightToes).y(), 0.02);
  for (const Joint joint : {Joint::kLeftShoulder, Joint::kRightShoulder, Joint::kLeftElbow,
                            Joint::kRightElbow, Joint::kSpineLower, Joint::kPelvis}) {
    const Eigen::Vector3d front = joint_rotation(joint, {0, 0, kPi / 6}) * Eigen::Vector3d::UnitX();
    const bool left = joint_name(joint).starts_with("left");
    EXPECT_GT((left ? -1.0 : 1.0) * front.y(), 0.4) << joint_name(joint);
  }
  // Protraction brings the shoulder forward.
  EXPECT_GT(displacement(Joint::kLeftClavicle, kRotation, Joint::kLeftClavicle).x(), 0.02);
  EXPECT_GT(displacement(Joint::kRightClavicle, kRotation, Joint::kRightClavicle).x(), 0.02);
}

TEST(Anatomy, WristFlexionGoesToThePalmsSideAndAbductionToTheThumbs) {
  EXPECT_LT(displacement(Joint::kLeftWrist, kFlexion, Joint::kLeftWrist).y(), -0.02);
  EXPECT_GT(displacement(Joint::kRightWrist, kFlexion, Joint::kRightWrist).y(), 0.02);
  EXPECT_GT(displacement(Joint::kLeftWrist, kAbduction, Joint::kLeftWrist).x(), 0.02);
  EXPECT_GT(displacement(Joint::kRightWrist, kAbduction, Joint::kRightWrist).x(), 0.02);
}

TEST(JointAngles, AreZeroAtRestAndReadBackASingleMovement) {
  for (std::size_t i = 0; i < kJointCount; ++i) {
    const auto joint = static_cast<Joint>(i);
    for (const double a : joint_angles(joint, Eigen::Quaterniond::Identity())) EXPECT_EQ(a, 0.0);
    for (std::size_t m = 0; m < 3; ++m) {
      JointAngles angles{};
      angles[m] = 0.7;
      const JointAngles read = joint_angles(joint, joint_rotation(joint, angles));
      for (std::size_t k = 0; k < 3; ++k) {
        EXPECT_NEAR(read[k], angles[k], 1e-12) << joint_name(joint) << m;
      }
    }
  }
}

TEST(JointAngles, GiveBackTheRotationForAnyRotation) {
  std::mt19937 generator(12);
  for (int n = 0; n < 1000; ++n) {
    const Eigen::Quaterniond q = random_rotation(generator);
    for (std::size_t i = 0; i < kJointCount; ++i) {
      const auto joint = static_cast<Joint>(i);
      EXPECT_LT(geodesic_distance(joint_rotation(joint, joint_angles(joint, q)), q), 1e-7)
          << joint_name(joint);
    }
  }
}

TEST(JointAngles, GiveBackTheAnglesInsideTheRange) {
  std::mt19937 generator(13);
  std::uniform_real_distribution<double> unit(0.02, 0.98);
  for (int n = 0; n < 1000; ++n) {
    for (std::size_t i = 0; i < kJointCount; ++i) {
      const JointAnatomy& anatomy = canonical_anatomy()[i];
      const auto joint = static_cast<Joint>(i);
      JointAngles angles{};
      for (std::size_t m = 0; m < 3; ++m) {
        angles[m] =
            anatomy.range[m].min + unit(generator) * (anatomy.range[m].max - anatomy.range[m].min);
      }
      // The swing of a shoulder or wrist is one turn of less than 180 degrees.
      if (anatomy.convention == AngleConvention::kSwingTwist &&
          std::hypot(angles[0], angles[1]) > 0.98 * kPi) {
        continue;
      }
      const JointAngles read = joint_angles(joint, joint_rotation(joint, angles));
      for (std::size_t m = 0; m < 3; ++m) EXPECT_NEAR(read[m], angles[m], 1e-8) << anatomy.name;
    }
  }
}

TEST(JointAngles, KeepTheRotationAtGimbalLock) {
  for (const Joint joint : {Joint::kLeftHip, Joint::kRightHip, Joint::kPelvis}) {
    for (const double locked : {kPi / 2, -kPi / 2}) {
      const Eigen::Quaterniond q = joint_rotation(joint, {0.4, locked, -0.9});
      EXPECT_LT(geodesic_distance(joint_rotation(joint, joint_angles(joint, q)), q), 1e-6);
    }
  }
}

TEST(JointAngles, OfAnArmRaisedSidewaysBeyondHorizontalStayPureAbduction) {
  for (const double a : {10.0, 90.0, 150.0, 175.0}) {
    const double angle = a * kPi / 180.0;
    const JointAngles read =
        joint_angles(Joint::kRightShoulder,
                     Eigen::Quaterniond(Eigen::AngleAxisd(angle, -Eigen::Vector3d::UnitX())));
    EXPECT_NEAR(degrees(read[kAbduction]), a, 1e-9);
    EXPECT_NEAR(read[kFlexion], 0.0, 1e-9);
    EXPECT_NEAR(read[kRotation], 0.0, 1e-9);
  }
}

// Baker 2001: a pelvis tilted forward reads the same tilt whichever way it faces.
TEST(JointAngles, PelvicTiltDoesNotDependOnTheHeading) {
  for (const double heading : {-3.0, -1.0, 0.5, 2.0}) {
    const Eigen::Quaterniond q = quaternion_from({0, 0, heading}) * quaternion_from({0, 0.3, 0});
    const JointAngles read = joint_angles(Joint::kPelvis, q);
    EXPECT_NEAR(read[kFlexion], 0.3, 1e-12);
    EXPECT_NEAR(read[kAbduction], 0.0, 1e-12);
    EXPECT_NEAR(read[kRotation], heading, 1e-12);
  }
}

TEST(CanonicalSkeleton, HasTheAskedStatureAndWholeMass) {
  for (const double stature : {0.5, 1.2, 1.75, 2.5}) {
    const Skeleton body = canonical_skeleton(stature);
    ASSERT_TRUE(is_canonical(body));
    double mass = 0.0;
    for (const Segment& s : body.segments()) mass += s.mass_fraction;
    EXPECT_NEAR(mass, 1.0, 1e-12);
    std::vector<Eigen::Isometry3d> X_WB(kJointCount);
    forward_kinematics(body, Eigen::Vector3d::Zero(), Pose(kJointCount).q_PB, X_WB);
    const double vertex = (X_WB[index(Joint::kHead)] * body[index(Joint::kHead)].p_BE).z();
    const double ankle = X_WB[index(Joint::kLeftAnkle)].translation().z();
    // The ankle stands 0.039 of stature over the floor.
    EXPECT_NEAR(vertex - ankle, (1.0 - 0.039) * stature, 1e-9);
  }
}

// de Leva 1996, table 4: thighs are the heaviest limb segments, the arm chain 4.7 % of the body.
TEST(CanonicalSkeleton, HasDeLevasLimbMasses) {
  const Skeleton body = canonical_skeleton();
  EXPECT_NEAR(body[index(Joint::kLeftHip)].mass_fraction, 0.1447, 5e-4);
  const double arm = body[index(Joint::kLeftShoulder)].mass_fraction +
                     body[index(Joint::kLeftElbow)].mass_fraction +
                     body[index(Joint::kLeftWrist)].mass_fraction;
  EXPECT_NEAR(arm, 0.0472, 5e-4);
}

TEST(CanonicalSkeleton, RefusesAStatureThatIsNone) {
  for (const double stature : {0.49, 2.51, -1.0, std::nan("")}) {
    EXPECT_THROW(canonical_skeleton(stature), std::invalid_argument);
  }
}

TEST(IsCanonical, AsksForTheNamesTheOrderAndTheParents) {
  const Skeleton body = canonical_skeleton();
  std::vector<Segment> segments = body.segments();
  segments[3].name = "chest";
  EXPECT_FALSE(is_canonical(Skeleton(segments)));
  segments = body.segments();
  segments[index(Joint::kLeftClavicle)].parent = index(Joint::kNeck);
  EXPECT_FALSE(is_canonical(Skeleton(segments)));
  segments = body.segments();
  segments.pop_back();
  EXPECT_FALSE(is_canonical(Skeleton(segments)));
}

TEST(Mirrored, JointsAreTheOtherSidesAndMidlineTheirOwn) {
  for (std::size_t i = 0; i < kJointCount; ++i) {
    const auto joint = static_cast<Joint>(i);
    std::string name(joint_name(joint));
    if (name.starts_with("left_")) {
      name = "right_" + name.substr(5);
    } else if (name.starts_with("right_")) {
      name = "left_" + name.substr(6);
    }
    EXPECT_EQ(joint_name(mirrored(joint)), name);
  }
}

TEST(Mirrored, PoseReflectsEveryPositionAndKeepsAnatomicalAngles) {
  const Skeleton body = canonical_skeleton();
  std::mt19937 generator(14);
  std::vector<Eigen::Isometry3d> X(kJointCount), Y(kJointCount);
  for (int n = 0; n < 1000; ++n) {
    Pose pose = random_pose(generator, kJointCount);
    pose.confidence[index(Joint::kLeftKnee)] = 0.5F;
    const Pose other = mirrored(pose);
    forward_kinematics(body, pose.p_WR, pose.q_PB, X);
    forward_kinematics(body, other.p_WR, other.q_PB, Y);
    for (std::size_t i = 0; i < kJointCount; ++i) {
      const auto joint = static_cast<Joint>(i);
      const std::size_t k = index(mirrored(joint));
      const Eigen::Vector3d p = X[i].translation();
      EXPECT_LT((Y[k].translation() - Eigen::Vector3d(p.x(), -p.y(), p.z())).norm(), 1e-12);
      if (i != k) {
        const JointAngles a = joint_angles(joint, pose.q_PB[i]);
        const JointAngles b = joint_angles(mirrored(joint), other.q_PB[k]);
        for (std::size_t m = 0; m < 3; ++m) EXPECT_NEAR(a[m], b[m], 1e-6) << joint_name(joint);
      }
    }
    EXPECT_EQ(other.confidence[index(Joint::kRightKnee)], 0.5F);
  }
}

}  // namespace
}  // namespace secondskin
