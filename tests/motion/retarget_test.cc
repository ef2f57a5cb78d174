#include "motion/retarget.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <fstream>
#include <numeric>
#include <sstream>
#include <vector>

#include "motion/bvh.h"
#include "motion/kinematics.h"
#include "motion/rotation.h"
#include "random_pose.h"

namespace secondskin {
namespace {

using testing::AllOf;
using testing::HasSubstr;

const std::filesystem::path kData = SECONDSKIN_SOURCE_DIR "/tests/data/bvh";
const std::filesystem::path kMaps = SECONDSKIN_SOURCE_DIR "/joint_maps";
constexpr std::size_t kFlexion = 0, kAbduction = 1;

double degrees(double radians) { return radians * 180.0 / std::numbers::pi; }

// One movement of one joint in every pose [deg].
std::vector<double> series(const Motion& motion, Joint joint, std::size_t movement) {
  std::vector<double> result;
  for (const Pose& pose : motion.poses) {
    result.push_back(degrees(joint_angles(joint, pose.q_PB[index(joint)])[movement]));
  }
  return result;
}
double lowest(const std::vector<double>& v) { return *std::min_element(v.begin(), v.end()); }
double highest(const std::vector<double>& v) { return *std::max_element(v.begin(), v.end()); }
double mean(const std::vector<double>& v) {
  return std::accumulate(v.begin(), v.end(), 0.0) / static_cast<double>(v.size());
}

Motion read(const std::string& file) { return read_canonical(kData / file, kMaps); }

struct Recording {
  std::string file, map;
  UpAxis up;
  double metres_per_unit;
};

class RecordedBody : public testing::TestWithParam<Recording> {};

TEST_P(RecordedBody, IsRecognised) {
  const BvhFile file = read_bvh(kData / GetParam().file);
  const JointMap map = JointMap::choose(kMaps, file.motion.skeleton);
  EXPECT_EQ(map.name(), GetParam().map);
  const Retargeted result = to_canonical(file.motion, map);
  EXPECT_EQ(result.up, GetParam().up);
  EXPECT_NEAR(result.metres_per_unit, GetParam().metres_per_unit, 1e-9);
  EXPECT_TRUE(is_canonical(result.motion.skeleton));
  EXPECT_EQ(result.motion.poses.size(), file.motion.poses.size());
  EXPECT_EQ(result.motion.rate_hz, file.motion.rate_hz);
  for (const Pose& pose : result.motion.poses) EXPECT_TRUE(pose.is_valid());
}

// Limbs and trunk lie where the file has them; the head, behind a neck of two joints that is one
// here, within a centimetre.
TEST_P(RecordedBody, HasItsJointsWhereTheFileHasThem) {
  const BvhFile file = read_bvh(kData / GetParam().file);
  const JointMap map = JointMap::choose(kMaps, file.motion.skeleton);
  const Retargeted result = to_canonical(file.motion, map);
  Eigen::Matrix3d R_WF = Eigen::Matrix3d::Identity();
  if (GetParam().up == UpAxis::kY) R_WF << 0, 0, 1, 1, 0, 0, 0, 1, 0;
  std::vector<Eigen::Isometry3d> X(file.motion.skeleton.size()), Y(kJointCount);
  for (std::size_t n = 0; n < file.motion.poses.size(); ++n) {
    const Pose &from = file.motion.poses[n], &to = result.motion.poses[n];
    forward_kinematics(file.motion.skeleton, from.p_WR, from.q_PB, X);
    forward_kinematics(result.motion.skeleton, to.p_WR, to.q_PB, Y);
    for (std::size_t i = 0; i < kJointCount; ++i) {
      const auto joint = static_cast<Joint>(i);
      const auto theirs = map.find(joint, file.motion.skeleton);
      EXPECT_EQ(to.confidence[i], theirs ? 1.0F : 0.0F);
      if (!theirs) {
        EXPECT_LT(geodesic_distance(to.q_PB[i], Eigen::Quaterniond::Identity()), 1e-9);
        continue;
      }
      const Eigen::Vector3d p = GetParam().metres_per_unit * (R_WF * X[*theirs].translation());
      const double bound = joint == Joint::kHead ? 0.01 : 0.001;
      ASSERT_LT((Y[i].translation() - p).norm(), bound) << joint_name(joint) << " in frame " << n;
    }
  }
}

TEST_P(RecordedBody, BendsElbowsAndKneesTheWayTheyBend) {
  const Motion motion = read(GetParam().file);
  for (const Joint joint :
       {Joint::kLeftKnee, Joint::kRightKnee, Joint::kLeftElbow, Joint::kRightElbow}) {
    EXPECT_GT(lowest(series(motion, joint, kFlexion)), -10.0) << joint_name(joint);
    EXPECT_LT(highest(series(motion, joint, kFlexion)), 165.0) << joint_name(joint);
    // They are hinges: all of the bending is flexion.
    EXPECT_LT(highest(series(motion, joint, kAbduction)), 1.0) << joint_name(joint);
    EXPECT_GT(lowest(series(motion, joint, kAbduction)), -1.0) << joint_name(joint);
  }
}

TEST_P(RecordedBody, HasAPersonsLimbs) {
  const Motion motion = read(GetParam().file);
  const Skeleton& body = motion.skeleton;
  for (const Joint knee : {Joint::kLeftKnee, Joint::kRightKnee}) {
    const double thigh = body[index(knee)].p_PB.norm(), shank = body[index(knee) + 1].p_PB.norm();
    EXPECT_GT(thigh, 0.25);
    EXPECT_LT(thigh, 0.55);
    EXPECT_NEAR(thigh / shank, 1.0, 0.35);
    // A limb hangs along its own -z.
    EXPECT_LT(body[index(knee)].p_PB.head<2>().norm(), 1e-9);
  }
  EXPECT_GT(body[index(Joint::kLeftHip)].p_PB.y(), 0.02);
  EXPECT_LT(body[index(Joint::kRightHip)].p_PB.y(), -0.02);
}

TEST_P(RecordedBody, ComesBackTheSameThroughOurOwnBvh) {
  const Motion motion = read(GetParam().file);
  std::stringstream stream;
  write_bvh(motion, stream);
  const BvhFile file = read_bvh(stream, "again");
  const JointMap map = JointMap::choose(kMaps, file.motion.skeleton);
  EXPECT_EQ(map.name(), "canonical");
  const Retargeted again = to_canonical(file.motion, map);
  EXPECT_EQ(again.up, UpAxis::kZ);
  EXPECT_EQ(again.metres_per_unit, 1.0);
  for (std::size_t n = 0; n < motion.poses.size(); ++n) {
    EXPECT_LT((motion.poses[n].p_WR - again.motion.poses[n].p_WR).norm(), 1e-4);
    for (std::size_t i = 0; i < kJointCount; ++i) {
      ASSERT_LT(geodesic_distance(motion.poses[n].q_PB[i], again.motion.poses[n].q_PB[i]), 1e-5)
          << joint_name(static_cast<Joint>(i)) << " in frame " << n;
    }
  }
}

INSTANTIATE_TEST_SUITE_P(
    ThreeHierarchies, RecordedBody,
    testing::Values(
        Recording{"cmu/131_01_first_240.bvh", "cmu_joints", UpAxis::kY, 0.0254 / 0.45},
        Recording{"cmu/13_26_first_120.bvh", "cmu_motionbuilder", UpAxis::kY, 0.0254 / 0.45},
        Recording{"cmu/14_14_squat_300.bvh", "cmu_joints", UpAxis::kY, 0.0254 / 0.45},
        Recording{"cmu/135_05_last_480.bvh", "cmu_bones", UpAxis::kZ, 0.0254},
        Recording{"animated_drawings/dab.bvh", "animated_drawings", UpAxis::kZ, 0.0254}));

// 135_05 stands upright from frame 2040 (17 s) on; the shipped part begins at 1920.
TEST(Retarget, ReadsUprightStandingNearZero) {
  const Motion standing = slice(read("cmu/135_05_last_480.bvh"), 120, 240);
  for (const Joint side : {Joint::kLeftHip, Joint::kRightHip}) {
    EXPECT_NEAR(mean(series(standing, side, kFlexion)), 0.0, 15.0);
    EXPECT_NEAR(mean(series(standing, side, kAbduction)), 5.0, 10.0);  // feet apart
    const auto knee = static_cast<Joint>(index(side) + 1);
    EXPECT_NEAR(mean(series(standing, knee, kFlexion)), 5.0, 10.0);
    const auto ankle = static_cast<Joint>(index(side) + 2);
    EXPECT_NEAR(mean(series(standing, ankle, kFlexion)), 5.0, 10.0);
    const auto toes = static_cast<Joint>(index(side) + 3);
    EXPECT_NEAR(mean(series(standing, toes, kFlexion)), 0.0, 10.0);
  }
  EXPECT_NEAR(mean(series(standing, Joint::kPelvis, kFlexion)), 0.0, 10.0);
  EXPECT_NEAR(mean(series(standing, Joint::kSpineLower, kFlexion)), 0.0, 12.0);
}

TEST(Retarget, ReadsASquatAsBentHipsAndKnees) {
  const Motion squat = read("cmu/14_14_squat_300.bvh");
  for (const Joint hip : {Joint::kLeftHip, Joint::kRightHip}) {
    const auto knee = static_cast<Joint>(index(hip) + 1);
    EXPECT_GT(highest(series(squat, hip, kFlexion)), 50.0);
    EXPECT_GT(highest(series(squat, knee, kFlexion)), 60.0);
    EXPECT_LT(lowest(series(squat, knee, kFlexion)), 45.0);
    // The heels stay down: the ankle bends forward.
    const auto ankle = static_cast<Joint>(index(hip) + 2);
    EXPECT_GT(highest(series(squat, ankle, kFlexion)), 10.0);
  }
  // The pelvis goes down by more than a foot and stays above the floor.
  std::vector<double> height;
  for (const Pose& pose : squat.poses) height.push_back(pose.p_WR.z());
  EXPECT_GT(highest(height) - lowest(height), 0.3);
  EXPECT_GT(lowest(height), 0.2);
}

TEST(Retarget, ReadsCirclingArmsAsArmsAndStillLegsAsStill) {
  const Motion circles = read("cmu/14_14_standing_120.bvh");
  const std::vector<double> raise = series(circles, Joint::kLeftShoulder, kAbduction);
  const std::vector<double> swing = series(circles, Joint::kLeftShoulder, kFlexion);
  EXPECT_GT(highest(raise) - lowest(raise), 20.0);
  EXPECT_GT(highest(swing) - lowest(swing), 60.0);
  const std::vector<double> knee = series(circles, Joint::kLeftKnee, kFlexion);
  EXPECT_LT(highest(knee) - lowest(knee), 5.0);
}

// The legs of CMU's rest pose are spread by 20 degrees and its arms of 13_26 held out in a T. The
// file's first frame turns the legs down, so the body stands in a T: that is how it must be read.
TEST(Retarget, ReadsATPoseAsPureAbduction) {
  const Pose pose = read("cmu/13_26_first_120.bvh").poses.front();
  for (const Joint shoulder : {Joint::kLeftShoulder, Joint::kRightShoulder}) {
    const JointAngles angles = joint_angles(shoulder, pose.q_PB[index(shoulder)]);
    EXPECT_NEAR(degrees(angles[kAbduction]), 90.0, 12.0);
    EXPECT_NEAR(degrees(angles[kFlexion]), 0.0, 5.0);
  }
  for (const Joint knee : {Joint::kLeftKnee, Joint::kRightKnee}) {
    EXPECT_NEAR(degrees(joint_angles(knee, pose.q_PB[index(knee)])[kFlexion]), 0.0, 1.0);
    const auto hip = static_cast<Joint>(index(knee) - 1);
    EXPECT_NEAR(degrees(joint_angles(hip, pose.q_PB[index(hip)])[kAbduction]), 0.0, 3.0);
  }
}

TEST(Retarget, LeavesTheTurnOfTheHandToTheForearm) {
  const Motion motion = read("animated_drawings/dab.bvh");
  double most = 0.0;
  for (const Pose& pose : motion.poses) {
    for (const Joint wrist : {Joint::kLeftWrist, Joint::kRightWrist}) {
      EXPECT_NEAR(twist_angle(pose.q_PB[index(wrist)], Eigen::Vector3d::UnitZ()), 0.0, 1e-9);
      const auto elbow = static_cast<Joint>(index(wrist) - 1);
      most = std::max(most, std::abs(degrees(joint_angles(elbow, pose.q_PB[index(elbow)])[2])));
    }
  }
  EXPECT_GT(most, 20.0);
}

// ---------------------------------------------------------------------------------------------
// A made-up body, so that the right answer is known: the canonical one, renamed, turned and scaled.

struct Disguise {
  double unit = 1.0;
  UpAxis up = UpAxis::kZ;
  double heading = 0.0;  // of the rest pose [rad]
};

// The same motion as a file of other unit, axis and rest heading would have it.
Motion disguised(const Motion& canonical, const Disguise& as) {
  Eigen::Matrix3d R_WF = Eigen::Matrix3d::Identity();
  if (as.up == UpAxis::kY) R_WF << 0, 0, 1, 1, 0, 0, 0, 1, 0;
  const Eigen::Quaterniond q_FW(Eigen::Matrix3d(R_WF.transpose()));
  const Eigen::Quaterniond q_rest = q_FW * quaternion_from({0, 0, as.heading});
  std::vector<Segment> segments = canonical.skeleton.segments();
  for (Segment& s : segments) {
    s.p_PB = q_rest * s.p_PB / as.unit;
    s.p_BE = q_rest * s.p_BE / as.unit;
  }
  Motion result{Skeleton(segments), canonical.rate_hz, canonical.poses};
  for (Pose& pose : result.poses) {
    pose.p_WR = q_FW * pose.p_WR / as.unit;
    for (std::size_t i = 0; i < kJointCount; ++i) {
      // The root's frame turns from the file's to the body's; the others' are parallel at rest.
      pose.q_PB[i] = (i == 0 ? q_FW : q_rest) * pose.q_PB[i] * q_rest.conjugate();
    }
  }
  return result;
}

Motion random_motion(unsigned seed) {
  Motion motion{canonical_skeleton(1.68), 100.0, {}};
  std::mt19937 generator(seed);
  for (int n = 0; n < 40; ++n) {
    Pose pose(kJointCount);
    pose.p_WR = random_vector(generator, 0.3) + Eigen::Vector3d(0, 0, 0.9);
    for (std::size_t i = 0; i < kJointCount; ++i) {
      JointAngles angles{};
      const JointAnatomy& anatomy = canonical_anatomy()[i];
      std::uniform_real_distribution<double> unit(0.2, 0.8);
      for (std::size_t m = 0; m < 3; ++m) {
        const AngleRange range = anatomy.range[m];
        angles[m] = i == 0 ? 0.2 * (unit(generator) - 0.5)
                           : 0.5 * (range.min + unit(generator) * (range.max - range.min));
      }
      pose.q_PB[i] = joint_rotation(static_cast<Joint>(i), angles);
    }
    motion.poses.push_back(pose);
  }
  return motion;
}

TEST(Retarget, UndoesAnyUnitAxisAndHeading) {
  const JointMap map = JointMap::load(kMaps / "canonical.toml");
  unsigned seed = 20;
  for (const double unit : {1.0, 0.01, 0.001, 0.0254, 0.3048, 0.0254 / 0.45}) {
    for (const UpAxis up : {UpAxis::kY, UpAxis::kZ}) {
      for (const double heading :
           {0.0, std::numbers::pi / 2, std::numbers::pi, -std::numbers::pi / 2}) {
        const Motion motion = random_motion(++seed);
        const Retargeted result = to_canonical(disguised(motion, {unit, up, heading}), map);
        EXPECT_EQ(result.up, up);
        EXPECT_NEAR(result.metres_per_unit, unit, 1e-12);
        for (std::size_t n = 0; n < motion.poses.size(); ++n) {
          EXPECT_LT((result.motion.poses[n].p_WR - motion.poses[n].p_WR).norm(), 1e-9);
          for (std::size_t i = 0; i < kJointCount; ++i) {
            ASSERT_LT(geodesic_distance(result.motion.poses[n].q_PB[i], motion.poses[n].q_PB[i]),
                      1e-6)
                << joint_name(static_cast<Joint>(i)) << " unit " << unit << " heading " << heading;
          }
        }
        for (std::size_t i = 1; i < kJointCount; ++i) {
          EXPECT_LT((result.motion.skeleton[i].p_PB - motion.skeleton[i].p_PB).norm(), 1e-9);
        }
      }
    }
  }
}

TEST(Retarget, TakesTheRestPosesWordForBodiesOnTheFloor) {
  Motion lying = random_motion(90);
  for (Pose& pose : lying.poses) {
    pose.q_PB[0] = quaternion_from({0, std::numbers::pi / 2, 0}) * pose.q_PB[0];
    pose.p_WR.z() = 0.2;
  }
  const Retargeted result = to_canonical(lying, JointMap::load(kMaps / "canonical.toml"));
  EXPECT_EQ(result.up, UpAxis::kZ);
}

TEST(Retarget, ObeysTheOptions) {
  const JointMap map = JointMap::load(kMaps / "canonical.toml");
  const Motion motion = random_motion(91);
  RetargetOptions options;
  options.metres_per_unit = 0.8;
  options.up = UpAxis::kZ;
  const Retargeted result = to_canonical(motion, map, options);
  EXPECT_EQ(result.metres_per_unit, 0.8);
  EXPECT_NEAR(result.motion.poses[0].p_WR.z(), 0.8 * motion.poses[0].p_WR.z(), 1e-12);
  for (const double wrong : {0.0, -1.0, 100.0, std::nan("")}) {
    options.metres_per_unit = wrong;
    EXPECT_THROW(to_canonical(motion, map, options), std::runtime_error) << wrong;
  }
}

// A rest pose drawn with turned upper arms (as CMU's are) must not make elbows bend sideways.
TEST(Retarget, FindsTheFrontOfAnArmFromWhereItsElbowBends) {
  Motion motion = random_motion(92);
  const Eigen::Quaterniond turn = quaternion_from({0, 0, 0.5});
  for (Pose& pose : motion.poses) {
    const std::size_t shoulder = index(Joint::kLeftShoulder);
    pose.q_PB[shoulder] = pose.q_PB[shoulder] * turn;
    pose.q_PB[shoulder + 1] = turn.conjugate() * pose.q_PB[shoulder + 1];
  }
  const Retargeted result = to_canonical(motion, JointMap::load(kMaps / "canonical.toml"));
  const Motion straight = random_motion(92);
  for (std::size_t n = 0; n < motion.poses.size(); ++n) {
    for (const Joint joint : {Joint::kLeftShoulder, Joint::kLeftElbow, Joint::kLeftWrist}) {
      EXPECT_LT(geodesic_distance(result.motion.poses[n].q_PB[index(joint)],
                                  straight.poses[n].q_PB[index(joint)]),
                1e-6);
    }
  }
}

std::string complaint(const Motion& motion, const JointMap& map,
                      const RetargetOptions& options = {}) {
  try {
    to_canonical(motion, map, options);
  } catch (const std::runtime_error& error) {
    return error.what();
  }
  return "accepted";
}

TEST(Retarget, SaysWhichOptionSettlesABodyThatItCannotUnderstand) {
  const JointMap map = JointMap::load(kMaps / "canonical.toml");
  const Motion motion = random_motion(93);
  EXPECT_THAT(complaint(disguised(motion, {.unit = 1e-5}), map), HasSubstr("metres_per_unit"));
  Motion flat = motion;
  std::vector<Segment> segments = flat.skeleton.segments();
  for (std::size_t i = index(Joint::kLeftHip); i < kJointCount; ++i) segments[i].p_PB.setZero();
  flat.skeleton = Skeleton(segments);
  EXPECT_THAT(complaint(flat, map), HasSubstr("legs"));
  // A body whose file has x up.
  Motion sideways = motion;
  const Eigen::Quaterniond q = quaternion_from({0, std::numbers::pi / 2, 0});
  segments = motion.skeleton.segments();
  for (Segment& s : segments) s.p_PB = q * s.p_PB;
  sideways.skeleton = Skeleton(segments);
  for (Pose& pose : sideways.poses) pose = Pose(kJointCount);
  EXPECT_THAT(complaint(sideways, map), HasSubstr("--up"));
  const Motion other{Skeleton({Segment{.name = "cube", .parent = {}}}), 30.0, {Pose(1)}};
  EXPECT_THAT(complaint(other, map), HasSubstr("joint map"));
}

TEST(FitTo, KeepsTheRotationsAndTheFeetOnTheFloor) {
  const Motion motion = read("cmu/14_14_squat_300.bvh");
  const Skeleton child = canonical_skeleton(1.2);
  const Motion fitted = fit_to(motion, child);
  EXPECT_EQ(fitted.skeleton[5].p_PB, child[5].p_PB);
  std::vector<Eigen::Isometry3d> X(kJointCount), Y(kJointCount);
  for (std::size_t n = 0; n < motion.poses.size(); ++n) {
    for (std::size_t i = 0; i < kJointCount; ++i) {
      EXPECT_EQ(fitted.poses[n].q_PB[i].coeffs(), motion.poses[n].q_PB[i].coeffs());
    }
  }
  // Standing before the squat: ankles as high over the floor as the shorter legs make them.
  forward_kinematics(motion.skeleton, motion.poses[0].p_WR, motion.poses[0].q_PB, X);
  forward_kinematics(child, fitted.poses[0].p_WR, fitted.poses[0].q_PB, Y);
  EXPECT_NEAR(Y[index(Joint::kLeftAnkle)].translation().z(),
              X[index(Joint::kLeftAnkle)].translation().z(), 0.06);
  EXPECT_LT(fitted.poses[0].p_WR.z(), 0.8 * motion.poses[0].p_WR.z());
}

TEST(FitTo, ToTheSameBodyChangesNothingAndRefusesOtherSkeletons) {
  const Motion motion = random_motion(94);
  const Motion same = fit_to(motion, motion.skeleton);
  EXPECT_LT((same.poses[3].p_WR - motion.poses[3].p_WR).norm(), 1e-12);
  EXPECT_THROW(fit_to(motion, Skeleton({Segment{.name = "cube", .parent = {}}})),
               std::invalid_argument);
}

// ---------------------------------------------------------------------------------------------

class MapFile : public testing::Test {
 protected:
  MapFile() { std::filesystem::create_directories(folder_); }
  ~MapFile() override { std::filesystem::remove_all(folder_); }

  std::string complaint(const std::string& text) {
    const auto file = folder_ / "map.toml";
    std::ofstream(file) << text;
    try {
      JointMap::load(file);
    } catch (const std::runtime_error& error) {
      return error.what();
    }
    return "accepted";
  }

  // A folder of its own for each test, for ctest runs them side by side.
  const std::filesystem::path folder_ =
      std::filesystem::path(testing::TempDir()) /
      (std::string("secondskin_joint_maps_") +
       testing::UnitTest::GetInstance()->current_test_info()->name());
};

TEST_F(MapFile, NamesFileLineAndTheUnknownOrDoubledJoint) {
  EXPECT_THAT(complaint("[joints]\npelvis = \"Hips\"\nleft_tail = \"Tail\"\n"),
              AllOf(HasSubstr("map.toml:3:"), HasSubstr("left_tail")));
  EXPECT_THAT(complaint("[joints]\npelvis = \"Hips\"\nneck = [\"Neck\",\n \"hips\"]\n"),
              AllOf(HasSubstr("map.toml:4:"), HasSubstr("Hips"), HasSubstr("twice")));
  EXPECT_THAT(complaint("[joints]\npelvis = 7\n"),
              AllOf(HasSubstr("map.toml:2:"), HasSubstr("pelvis")));
  EXPECT_THAT(complaint("[joints\n"), HasSubstr("map.toml:1:"));
  EXPECT_THAT(complaint("pelvis = \"Hips\"\n"), HasSubstr("[joints]"));
  EXPECT_EQ(complaint("[joints]\npelvis = [\"Hips\", \"Root\"]\n"), "accepted");
}

TEST_F(MapFile, FindsNamesInAnyCaseWithOrWithoutTheRigsName) {
  std::ofstream(folder_ / "m.toml") << "[joints]\npelvis = [\"Root\", \"Hips\"]\n";
  const JointMap map = JointMap::load(folder_ / "m.toml");
  for (const std::string name : {"Hips", "hips", "mixamorig:Hips", "HIPS", "a:b:hips"}) {
    const Skeleton skeleton(
        {Segment{.name = "world", .parent = {}}, Segment{.name = name, .parent = 0}});
    EXPECT_EQ(map.find(Joint::kPelvis, skeleton), 1U) << name;
    EXPECT_EQ(map.find(Joint::kHead, skeleton), std::nullopt);
  }
}

// Every shipped map reads a body with its own names as itself, and is the one chosen for it.
TEST(JointMaps, EachReadsABodyWithItsNames) {
  std::size_t maps = 0;
  for (const auto& entry : std::filesystem::directory_iterator(kMaps)) {
    if (entry.path().extension() != ".toml") continue;
    ++maps;
    const JointMap map = JointMap::load(entry.path());
    Motion motion = random_motion(95);
    std::vector<Segment> segments = motion.skeleton.segments();
    // The names stand in the file after each joint: take the first of each.
    std::ifstream in(entry.path());
    std::size_t named = 0;
    for (std::string line; std::getline(in, line);) {
      const auto joint = find_joint(line.substr(0, line.find(' ')));
      if (!joint) continue;
      const std::size_t open = line.find('"');
      segments[index(*joint)].name = line.substr(open + 1, line.find('"', open + 1) - open - 1);
      ++named;
    }
    EXPECT_GE(named, 19U) << entry.path();
    motion.skeleton = Skeleton(segments);
    EXPECT_EQ(JointMap::choose(kMaps, motion.skeleton).name(), map.name());
    const Retargeted result = to_canonical(motion, map);
    EXPECT_TRUE(is_canonical(result.motion.skeleton));
  }
  EXPECT_GE(maps, 8U);
}

TEST(JointMaps, ListTheJointsWhenNoneFits) {
  const Skeleton quadruped(
      {Segment{.name = "withers", .parent = {}}, Segment{.name = "tail", .parent = 0}});
  try {
    JointMap::choose(kMaps, quadruped);
    FAIL() << "chose a map";
  } catch (const std::runtime_error& error) {
    EXPECT_THAT(error.what(), HasSubstr("withers, tail"));
  }
  EXPECT_THROW(JointMap::choose("/nowhere", quadruped), std::runtime_error);
}

TEST(ReadCanonical, NamesTheFileInEveryError) {
  for (const std::string name : {"/nowhere/none.bvh", "/nowhere/none.xyz"}) {
    try {
      read_canonical(name, kMaps);
      FAIL() << "read " << name;
    } catch (const std::runtime_error& error) {
      EXPECT_THAT(error.what(), HasSubstr(name));
    }
  }
}

}  // namespace
}  // namespace secondskin
