#include "server/markers/marker_body.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "motion/marker_file.h"
#include "motion/rotation.h"
#include "motion/ui_prmd.h"
#include "moving_body.h"
#include "server/markers/body_fit.h"
#include "server/markers/marker_source.h"

namespace secondskin::server {
namespace {

using testing::HasSubstr;

const std::filesystem::path kData =
    std::filesystem::path(SECONDSKIN_SOURCE_DIR) / "tests" / "data" / "ui_prmd";

MarkerMotion squat() { return read_markers(kData / "m01_s01_e02_positions.txt.gz"); }

std::string error_of(const MarkerMotion& trial) {
  try {
    (void)calibrate_body(plug_in_gait(), trial);
  } catch (const std::runtime_error& error) {
    return error.what();
  }
  return "";
}

TEST(CalibrateBody, FindsTheLengthsOfABodyItHasNotSeen) {
  const MarkerSet set = plug_in_gait();
  // The nominal markers on a body 12 % smaller, whose shanks are 3 cm shorter still.
  Motion truth = moving_body();
  std::vector<Segment> segments = truth.skeleton.segments();
  for (Segment& s : segments) s.p_PB *= 0.88;
  for (const Joint ankle : {Joint::kLeftAnkle, Joint::kRightAnkle}) {
    segments[index(ankle)].p_PB.z() += 0.03;
  }
  truth.skeleton = Skeleton(segments);
  std::vector<MarkerPlace> places = set.places();
  for (MarkerPlace& place : places) {
    place.p_BM *= 0.88;
    const bool shank = place.segment == Joint::kLeftKnee || place.segment == Joint::kRightKnee;
    if (shank) place.p_BM.z() *= (0.4305 * 0.88 - 0.03) / (0.4305 * 0.88);
  }
  for (Pose& pose : truth.poses) pose.p_WR.z() *= 0.88;
  const MarkerMotion markers = markers_on(truth, MarkerSet("small", set.nominal(), places), 0.001);
  const BodyCalibration calibration = calibrate_body(set, markers);
  EXPECT_LT(calibration.residual, 0.006);
  EXPECT_TRUE(calibration.stood_upright);
  for (const Joint joint : {Joint::kLeftKnee, Joint::kRightAnkle, Joint::kLeftElbow}) {
    EXPECT_NEAR(calibration.body.skeleton[index(joint)].p_PB.norm(),
                truth.skeleton[index(joint)].p_PB.norm(), 0.015)
        << joint_name(joint);
  }
  BodyFit fit(calibration.body);
  Pose pose;
  double squares = 0.0, count = 0.0;
  for (std::size_t f = 0; f < markers.frames.size(); ++f) {
    (void)fit.update(markers.frames[f], 0.01, pose);
    for (const Joint joint :
         {Joint::kLeftHip, Joint::kRightKnee, Joint::kLeftElbow, Joint::kRightHip}) {
      const double flexion = joint_angles(joint, pose.q_PB[index(joint)])[0];
      const double expected = joint_angles(joint, truth.poses[f].q_PB[index(joint)])[0];
      squares += std::pow((flexion - expected) / kDegree, 2.0);
      count += 1.0;
    }
  }
  EXPECT_LT(std::sqrt(squares / count), 3.0);
}

TEST(CalibrateBody, HasVisibleAnglesOfZeroInUprightStanding) {
  const MarkerMotion trial = squat();
  const BodyCalibration calibration = calibrate_body(plug_in_gait(), trial);
  EXPECT_TRUE(calibration.stood_upright);
  EXPECT_LT(calibration.residual, 0.01);
  BodyFit fit(calibration.body);
  Pose pose;
  (void)fit.update(trial.frames[0], 0.01, pose);  // it begins upright, arms raised
  for (const Joint joint : {Joint::kPelvis, Joint::kSpineLower, Joint::kLeftHip, Joint::kRightHip,
                            Joint::kLeftKnee, Joint::kRightKnee}) {
    EXPECT_NEAR(joint_angles(joint, pose.q_PB[index(joint)])[0] / kDegree, 0.0, 10.0)
        << joint_name(joint);
  }
}

// The floor of the bench: knee and hip flexion within 5 degrees of Vicon's own, a constant aside.
TEST(CalibrateBody, BendsKneesAndHipsAsViconDoes) {
  const MarkerMotion trial = squat();
  const auto vicon = read_ui_prmd_angles(kData / "m01_s01_e02_angles.txt.gz");
  const BodyCalibration calibration = calibrate_body(plug_in_gait(), trial);
  BodyFit fit(calibration.body);
  Pose pose;
  struct Pair {
    Joint joint;
    std::size_t column;
    std::vector<double> difference{};
  };
  std::vector<Pair> pairs{{Joint::kLeftHip, kUiPrmdLeftHip},
                          {Joint::kRightHip, kUiPrmdRightHip},
                          {Joint::kLeftKnee, kUiPrmdLeftKnee},
                          {Joint::kRightKnee, kUiPrmdRightKnee}};
  for (std::size_t f = 0; f < std::min(trial.frames.size(), vicon.size()); ++f) {
    ASSERT_TRUE(fit.update(trial.frames[f], 0.01, pose).tracked);
    for (Pair& pair : pairs) {
      const double flexion = joint_angles(pair.joint, pose.q_PB[index(pair.joint)])[0] / kDegree;
      pair.difference.push_back(flexion - vicon[f][pair.column].x());
    }
  }
  for (const Pair& pair : pairs) {
    double mean = 0.0, squares = 0.0;
    for (const double d : pair.difference) mean += d / static_cast<double>(pair.difference.size());
    for (const double d : pair.difference) squares += (d - mean) * (d - mean);
    EXPECT_LT(std::sqrt(squares / static_cast<double>(pair.difference.size())), 5.0)
        << joint_name(pair.joint);
  }
}

TEST(CalibrateBody, NamesExchangedMarkers) {
  MarkerMotion trial = squat();
  const std::size_t left = *trial.find("LKNE"), right = *trial.find("RKNE");
  std::swap(trial.names[left], trial.names[right]);
  const BodyCalibration calibration = calibrate_body(plug_in_gait(), trial);
  EXPECT_LT(calibration.residual, 0.01);
  for (const MarkerReport& report : calibration.markers) {
    if (report.name == "LKNE") {
      EXPECT_THAT(report.suspicion, HasSubstr("RKNE"));
    } else if (report.name == "RKNE") {
      EXPECT_THAT(report.suspicion, HasSubstr("LKNE"));
    } else {
      EXPECT_EQ(report.suspicion, "") << report.name;
    }
  }
}

TEST(CalibrateBody, FindsNothingOddInAGoodTrialWithGaps) {
  const MarkerMotion trial = read_markers(kData / "m07_s04_e01_positions_inc.txt.gz");
  const BodyCalibration calibration = calibrate_body(plug_in_gait(), trial);
  EXPECT_LT(calibration.residual, 0.015);
  for (const MarkerReport& report : calibration.markers) {
    EXPECT_THAT(report.suspicion, testing::Not(HasSubstr("exchanged"))) << report.name;
  }
}

TEST(CalibrateBody, SaysWhatIsMissingOrWrong) {
  MarkerMotion few = squat();
  for (std::size_t i = 4; i < few.names.size(); ++i)
    few.names[i] = std::string("x").append(std::to_string(i));
  EXPECT_THAT(error_of(few), testing::AllOf(HasSubstr("Plug-in Gait"), HasSubstr("x5")));

  MarkerMotion upside_down = squat();
  for (MarkerFrame& frame : upside_down.frames) {
    for (Eigen::Vector3d& p : frame.p_WM) p = {p.x(), -p.y(), -p.z()};
  }
  EXPECT_THAT(error_of(upside_down), HasSubstr("--up"));

  MarkerMotion large = squat();
  for (MarkerFrame& frame : large.frames) {
    for (Eigen::Vector3d& p : frame.p_WM) p *= 1000.0;
  }
  EXPECT_THAT(error_of(large), HasSubstr("unit"));

  MarkerMotion dark = squat();
  for (MarkerFrame& frame : dark.frames) frame.visible.assign(frame.visible.size(), 0);
  EXPECT_NE(error_of(dark), "");
  EXPECT_NE(error_of({dark.names, 100.0, {}}), "");
}

TEST(MarkerSource, GivesAPoseAFrameAndTheSameAgain) {
  const MarkerMotion trial = squat();
  MarkerSource source(trial, plug_in_gait());
  std::vector<StampedPose> first;
  StampedPose pose;
  while (source.next(pose) == Next::kPose) first.push_back(pose);
  ASSERT_EQ(first.size(), trial.frames.size());
  EXPECT_EQ(first[100].frame, 100u);
  EXPECT_EQ(first[100].stamp_ns, 1'000'000'000);
  ASSERT_TRUE(source.rewind());
  for (const StampedPose& expected : first) {
    ASSERT_EQ(source.next(pose), Next::kPose);
    ASSERT_TRUE(pose.pose.is_valid());
    ASSERT_EQ(pose.pose.q_PB[index(Joint::kLeftKnee)].coeffs(),
              expected.pose.q_PB[index(Joint::kLeftKnee)].coeffs());
  }
}

}  // namespace
}  // namespace secondskin::server
