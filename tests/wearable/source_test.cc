#include "server/wearable/wearable_source.h"

#include <gtest/gtest.h>

#include <filesystem>
#include <numbers>

#include "motion/kinematics.h"
#include "motion/retarget.h"
#include "motion/rotation.h"
#include "server/wearable/csv/csv_stream.h"
#include "sim/wearable/simulated_measurements.h"
#include "sim/wearable/worn_garment.h"

namespace secondskin::server {
namespace {

constexpr double kDegree = std::numbers::pi / 180.0;
const std::filesystem::path kSource(SECONDSKIN_SOURCE_DIR);

Motion motion_of(const char* reference) {
  return read_canonical(kSource / "reference_motions" / reference / "motion.bvh",
                        kSource / "joint_maps");
}
Garment practical() { return Garment::load(kSource / "garments/practical.toml"); }

WearableSource source_of(const sim::WornGarment& worn, const WearableOptions& wanted = {},
                         const sim::MeasurementOptions& measurements = {}) {
  WearableOptions options = wanted;
  options.start.body = worn.assumed_skeleton();
  return {std::make_unique<sim::SimulatedMeasurements>(worn, 5, measurements), worn.garment(),
          options};
}

struct Fit {
  double orientation = 0.0;  ///< mean over joints and poses, under the root [rad]
  double ground = 0.0;       ///< of the root at the end, against the start [m]
  std::size_t poses = 0;
};

Fit fit_of(WearableSource& source, const sim::WornGarment& worn) {
  Fit fit;
  StampedPose pose;
  Pose truth(kJointCount);
  std::optional<Eigen::Vector3d> offset;
  while (source.next(pose) == Next::kPose) {
    EXPECT_TRUE(pose.pose.is_valid());
    worn.pose_at(1e-9 * static_cast<double>(pose.stamp_ns), truth);
    for (const Joint joint :
         {Joint::kHead, Joint::kRightShoulder, Joint::kLeftHip, Joint::kRightKnee}) {
      Eigen::Quaterniond a = Eigen::Quaterniond::Identity(), b = a;
      for (std::size_t i = index(joint); i != 0; i = *source.skeleton()[i].parent) {
        a = pose.pose.q_PB[i] * a;
        b = truth.q_PB[i] * b;
      }
      fit.orientation += geodesic_distance(a, b) / 4.0;
    }
    if (!offset) offset = pose.pose.p_WR - truth.p_WR;
    fit.ground = (pose.pose.p_WR - truth.p_WR - *offset).head<2>().norm();
    ++fit.poses;
  }
  fit.orientation /= static_cast<double>(std::max<std::size_t>(1, fit.poses));
  return fit;
}

TEST(WearableSource, FollowsASquatFromMeasurementsToPoses) {
  const sim::WornGarment worn(motion_of("squat"), practical(), sim::WornErrors{}, 1);
  auto source = source_of(worn);
  EXPECT_NEAR(source.rate_hz(), 70.0, 1e-9);
  const Fit fit = fit_of(source, worn);
  EXPECT_GT(static_cast<double>(fit.poses), 0.9 * 70.0 * (worn.duration() - 3.5));
  EXPECT_LT(fit.orientation, 12.0 * kDegree);
  ASSERT_TRUE(source.rewind());
  StampedPose pose;
  ASSERT_EQ(source.next(pose), Next::kPose);
  EXPECT_EQ(pose.frame, 1u);
}

TEST(WearableSource, TakesSwappedBoardsAsEachOther) {
  const sim::WornGarment worn(motion_of("squat"), practical(), sim::WornErrors{}, 1);
  sim::MeasurementOptions measurements;
  measurements.faults.swapped = {{4, 11}};  // the shoulders
  auto source = source_of(worn, {}, measurements);
  ASSERT_EQ(source.start().swapped.size(), 1u);
  EXPECT_LT(fit_of(source, worn).orientation, 12.0 * kDegree);
}

// To and fro, long enough for accelerations to lose the place.
Motion repeated(const Motion& motion, int times) {
  Motion result{motion.skeleton, motion.rate_hz, {}};
  for (int i = 0; i < times; ++i) {
    result.poses.insert(result.poses.end(), motion.poses.begin(), motion.poses.end());
    result.poses.insert(result.poses.end(), motion.poses.rbegin(), motion.poses.rend());
  }
  return result;
}

TEST(WearableSource, StandsOnItsFeet) {
  const sim::WornGarment worn(repeated(motion_of("squat"), 3), practical(), sim::WornErrors{}, 2);
  WearableOptions without;
  without.use_contacts = false;
  auto loose = source_of(worn, without), held = source_of(worn);
  const double far = fit_of(loose, worn).ground, near = fit_of(held, worn).ground;
  EXPECT_GE(held.contacts().counts().contacts, 2u);
  EXPECT_LT(near, 0.3);
  EXPECT_LT(near, 0.5 * far);
}

TEST(WearableSource, SaysSoWhenARecordingHasNoRest) {
  Garment garment = practical();
  struct Nothing final : MeasurementStream {
    Next next(Measurement&) override { return Next::kEnd; }
  };
  EXPECT_THROW(WearableSource(std::make_unique<Nothing>(), garment, {}), std::runtime_error);
}

TEST(WearableSource, GivesSilenceWhileALiveGarmentWaits) {
  struct Turning final : MeasurementStream {
    Next next(Measurement& m) override {
      m.kind = MeasurementKind::kInertial;
      m.stamp_ns = ++count * 7'142'857LL;
      m.boards.assign(18, {});
      for (auto& b : m.boards) {
        b.gyro = {0, 0, 1.0};
        b.accel = {0, 0, 9.8};
        b.gyro_valid = b.accel_valid = true;
      }
      return Next::kPose;
    }
    bool live() const override { return true; }
    std::int64_t count = 0;
  };
  WearableSource source(std::make_unique<Turning>(), practical(), {});
  StampedPose pose;
  EXPECT_EQ(source.next(pose), Next::kSilence);
  EXPECT_FALSE(source.started());
  EXPECT_FALSE(source.rewind());
}

TEST(Smoother, IsNearerToTheTruthThanTheFilter) {
  const sim::WornGarment worn(motion_of("stepping_punch"), practical(), sim::WornErrors{}, 3);
  WearableOptions smooth;
  smooth.smooth = true;
  auto filtered = source_of(worn), smoothed = source_of(worn, smooth);
  const Fit before = fit_of(filtered, worn), after = fit_of(smoothed, worn);
  EXPECT_EQ(before.poses, after.poses);
  EXPECT_LT(after.orientation, before.orientation);
}

// Upper back and right arm of a real person, next to the recording suit's own filter. Which way the
// wearer faces and how the suit's axes lie on the segments are conventions: turns are compared.
TEST(WearableSource, FollowsARealArmFromAPlainTable) {
  const auto file = kSource / "tests/data/imu/qmt/right_arm_first14s.csv.gz";
  const auto mapping = CsvMapping::load(kSource / "garments/csv/qmt_right_arm.toml");
  WearableOptions options;
  for (const CsvBoard& board : mapping.boards) options.start.mountings.push_back(board.q_BS);
  auto stream = std::make_unique<CsvStream>(file, mapping);
  const Garment garment = stream->garment();
  WearableSource source(std::move(stream), garment, options);
  CsvStream suit(file, mapping);
  Measurement m;
  StampedPose pose;
  std::vector<Eigen::Isometry3d> X_WB(kJointCount);
  std::optional<Eigen::Quaterniond> ours, theirs;
  double squares = 0.0, n = 0.0;
  while (source.next(pose) == Next::kPose) {
    while (m.stamp_ns < pose.stamp_ns && suit.next(m) == Next::kPose) {
    }
    ASSERT_EQ(m.stamp_ns, pose.stamp_ns);
    ASSERT_TRUE(pose.pose.is_valid());
    if (pose.frame % 10 != 0) continue;
    forward_kinematics(source.skeleton(), pose.pose.p_WR, pose.pose.q_PB, X_WB);
    const Eigen::Quaterniond a(X_WB[index(Joint::kRightElbow)].linear());
    const Eigen::Quaterniond b = *suit.orientations()[2];
    if (ours) {
      const double turned = geodesic_distance(a, *ours), truth = geodesic_distance(b, *theirs);
      squares += (turned - truth) * (turned - truth);
      n += 1.0;
    }
    ours = a;
    theirs = b;
  }
  EXPECT_GT(n, 30.0);
  EXPECT_LT(std::sqrt(squares / n), 8.0 * kDegree) << "the forearm's turn over 0.2 s";
}

}  // namespace
}  // namespace secondskin::server
