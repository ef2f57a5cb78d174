#include "server/markers/body_fit.h"

#include <gtest/gtest.h>

#include <limits>

#include "motion/rotation.h"
#include "moving_body.h"

namespace secondskin::server {
namespace {

constexpr std::array kLimbs{Joint::kLeftHip,      Joint::kRightHip,      Joint::kLeftKnee,
                            Joint::kRightKnee,    Joint::kLeftAnkle,     Joint::kSpineLower,
                            Joint::kLeftShoulder, Joint::kRightShoulder, Joint::kLeftElbow};

// A joint's rotation; of trunk and neck as a whole, which share a bend between their joints.
Eigen::Quaterniond bend(const Pose& pose, Joint joint) {
  const auto q = [&pose](Joint j) { return pose.q_PB[index(j)]; };
  if (joint == Joint::kSpineLower) {
    return q(Joint::kSpineLower) * q(Joint::kSpineMiddle) * q(Joint::kSpineUpper);
  }
  if (joint == Joint::kNeck) return q(Joint::kNeck) * q(Joint::kHead);
  return q(joint);
}

double worst_error(const Pose& truth, const Pose& pose) {
  double worst = 0.0;
  for (const Joint joint : kLimbs) {
    worst = std::max(worst, geodesic_distance(bend(truth, joint), bend(pose, joint)));
  }
  return worst / kDegree;
}

struct Scene {
  MarkerSet set = plug_in_gait();
  Motion truth = moving_body();
  MarkerMotion markers = markers_on(truth, set, 0.002);
  MarkerBody body = exact_body(truth, set);
  double dt = 1.0 / truth.rate_hz;

  std::size_t marker(std::string_view name) const { return *markers.find(name); }
};

TEST(BodyFit, FollowsAMovingBody) {
  const Scene scene;
  BodyFit fit(scene.body);
  Pose pose;
  for (std::size_t f = 0; f < scene.markers.frames.size(); ++f) {
    const auto result = fit.update(scene.markers.frames[f], scene.dt, pose);
    EXPECT_TRUE(result.tracked);
    EXPECT_EQ(result.restarted, f == 0);
    EXPECT_TRUE(pose.is_valid());
    EXPECT_LT(worst_error(scene.truth.poses[f], pose), 6.0) << "frame " << f;
    EXPECT_LT((pose.p_WR - scene.truth.poses[f].p_WR).norm(), 0.01);
  }
}

TEST(BodyFit, IsNotSpoiltByOneMarkerOfNonsense) {
  const Scene scene;
  const std::size_t knee = scene.marker("LKNE");
  const double nan = std::numeric_limits<double>::quiet_NaN();
  for (const Eigen::Vector3d& nonsense :
       {Eigen::Vector3d(nan, nan, nan), Eigen::Vector3d(5.0, -3.0, 40.0),
        Eigen::Vector3d(1e300, 0.0, 0.0), Eigen::Vector3d(0.0, 0.0, 0.0)}) {
    BodyFit fit(scene.body);
    Pose pose;
    for (std::size_t f = 0; f < scene.markers.frames.size(); ++f) {
      MarkerFrame frame = scene.markers.frames[f];
      frame.p_WM[knee] = nonsense;
      const auto result = fit.update(frame, scene.dt, pose);
      EXPECT_TRUE(result.tracked);
      ASSERT_LT(worst_error(scene.truth.poses[f], pose), 6.0) << "frame " << f;
    }
  }
}

TEST(BodyFit, FillsAHiddenLimbWithFallingConfidence) {
  const Scene scene;
  BodyFit fit(scene.body);
  Pose pose;
  float before = 0.0F, last = 1.0F;
  for (std::size_t f = 0; f < scene.markers.frames.size(); ++f) {
    MarkerFrame frame = scene.markers.frames[f];
    const bool hidden = f >= 50 && f < 80;
    for (const Attachment& a : scene.body.attachments) {
      if (hidden && (a.segment == Joint::kLeftElbow || a.segment == Joint::kLeftWrist)) {
        frame.visible[a.marker] = 0;
      }
    }
    EXPECT_TRUE(fit.update(frame, scene.dt, pose).tracked);
    const float confidence = pose.confidence[index(Joint::kLeftElbow)];
    if (f == 49) before = confidence;
    if (hidden) {
      EXPECT_LE(confidence, last) << "frame " << f;
      last = confidence;
    } else {
      EXPECT_LT(worst_error(scene.truth.poses[f], pose), 6.0) << "frame " << f;
    }
    if (f < 55) {
      EXPECT_LT(worst_error(scene.truth.poses[f], pose), 8.0) << "frame " << f;
    }
  }
  EXPECT_GT(before, 0.5F);
  EXPECT_LT(last, 0.2F);
  EXPECT_GT(pose.confidence[index(Joint::kLeftElbow)], 0.5F);
}

TEST(BodyFit, ComesBackAfterTheWholeBodyWasGone) {
  const Scene scene;
  BodyFit fit(scene.body);
  Pose pose;
  const Eigen::Vector3d away(2.0, -1.0, 0.0);
  for (std::size_t f = 0; f < scene.markers.frames.size(); ++f) {
    MarkerFrame frame = scene.markers.frames[f];
    if (f >= 40 && f < 140) frame.visible.assign(frame.visible.size(), 0);
    for (Eigen::Vector3d& p : frame.p_WM) {
      if (f >= 140) p += away;
    }
    const auto result = fit.update(frame, scene.dt, pose);
    EXPECT_TRUE(pose.is_valid());
    if (f >= 40 && f < 140) {
      EXPECT_FALSE(result.tracked);
      EXPECT_EQ(result.visible, 0u);
    }
    if (f >= 142) {
      EXPECT_LT(worst_error(scene.truth.poses[f], pose), 6.0) << "frame " << f;
      EXPECT_LT((pose.p_WR - away - scene.truth.poses[f].p_WR).norm(), 0.01);
    }
  }
}

TEST(BodyFit, GivesJointsWithoutMarkersNoConfidence) {
  Scene scene;
  std::erase_if(scene.body.attachments, [](const Attachment& a) {
    return a.segment == Joint::kRightElbow || a.segment == Joint::kRightWrist;
  });
  BodyFit fit(scene.body);
  Pose pose;
  EXPECT_TRUE(fit.update(scene.markers.frames[0], scene.dt, pose).tracked);
  EXPECT_EQ(pose.confidence[index(Joint::kRightElbow)], 0.0F);
  EXPECT_EQ(pose.confidence[index(Joint::kLeftToes)], 0.0F);
  EXPECT_GT(pose.confidence[index(Joint::kLeftElbow)], 0.1F);
}

TEST(BodyFit, GivesTheSameHoweverOftenItIsAsked) {
  const Scene scene;
  BodyFit once(scene.body), again(scene.body);
  Pose a, b;
  (void)again.update(scene.markers.frames[90], scene.dt, b);
  again.reset();
  for (const MarkerFrame& frame : scene.markers.frames) {
    (void)once.update(frame, scene.dt, a);
    (void)again.update(frame, scene.dt, b);
    for (std::size_t j = 0; j < kJointCount; ++j) {
      ASSERT_EQ(a.q_PB[j].coeffs(), b.q_PB[j].coeffs());
      ASSERT_EQ(a.confidence[j], b.confidence[j]);
    }
  }
}

TEST(BodyFit, WaitsUntilThereIsABody) {
  const Scene scene;
  BodyFit fit(scene.body);
  Pose pose;
  EXPECT_FALSE(fit.update(MarkerFrame(scene.markers.names.size()), scene.dt, pose).tracked);
  EXPECT_FALSE(fit.update(MarkerFrame(), scene.dt, pose).tracked);
  EXPECT_EQ(pose.confidence[index(Joint::kLeftKnee)], 0.0F);
  EXPECT_TRUE(fit.update(scene.markers.frames[0], scene.dt, pose).tracked);
}

}  // namespace
}  // namespace secondskin::server
