#include "motion/body_shape.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

namespace secondskin {
namespace {

constexpr double kPi = std::numbers::pi;

Joint joint(std::size_t i) { return static_cast<Joint>(i); }

// Where segments are in the rest pose: all frames are parallel to the world's.
Eigen::Vector3d at_rest(const Skeleton& s, Joint segment) {
  Eigen::Vector3d p = s[index(segment)].p_PB;
  for (auto parent = s[index(segment)].parent; parent; parent = s[*parent].parent) {
    p += s[*parent].p_PB;
  }
  return p;
}

double distance_from_axis(const Capsule& capsule, const Eigen::Vector3d& p) {
  const Eigen::Vector3d axis = capsule.p_BE - capsule.p_BA;
  const double u = std::clamp((p - capsule.p_BA).dot(axis) / axis.squaredNorm(), 0.0, 1.0);
  return (p - capsule.p_BA - u * axis).norm();
}

TEST(SegmentCapsule, HasTheGirthsOfTheSurvey) {
  // ANSUR II (Gordon et al. 2014), mean of the sexes' means at a mean stature of 1.692 m [m].
  const Skeleton body = canonical_skeleton(1.6923);
  const auto girth = [&](Joint j) { return 2.0 * kPi * segment_capsule(body, j).radius; };
  EXPECT_NEAR(girth(Joint::kHead), 0.5677, 1e-3);
  EXPECT_NEAR(girth(Joint::kNeck), 0.3637, 1e-3);
  EXPECT_NEAR(girth(Joint::kLeftShoulder), 0.3319, 1e-3);
  EXPECT_NEAR(girth(Joint::kRightElbow), 0.5 * (0.2871 + 0.1654), 1e-3);
  EXPECT_NEAR(girth(Joint::kLeftHip), 0.5 * (0.6206 + 0.4050), 1e-3);
  EXPECT_NEAR(girth(Joint::kRightKnee), 0.5 * (0.3828 + 0.2225), 1e-3);
  EXPECT_NEAR(4.0 * segment_capsule(body, Joint::kPelvis).radius, 0.3498 + 0.2394, 1e-3);
  EXPECT_NEAR(4.0 * segment_capsule(body, Joint::kSpineUpper).radius, 0.2794 + 0.2506, 1e-3);
}

TEST(SegmentCapsule, GrowsWithTheBodyInAllMeasures) {
  const Skeleton small = canonical_skeleton(1.2), tall = canonical_skeleton(1.8);
  for (std::size_t i = 0; i < kJointCount; ++i) {
    const Capsule a = segment_capsule(small, joint(i)), b = segment_capsule(tall, joint(i));
    EXPECT_NEAR(b.radius / a.radius, 1.5, 1e-9);
    EXPECT_TRUE(b.p_BA.isApprox(1.5 * a.p_BA, 1e-9) || a.p_BA.isZero());
    EXPECT_TRUE(b.p_BE.isApprox(1.5 * a.p_BE, 1e-9));
    EXPECT_GT(a.radius, 0.005);
  }
}

TEST(SegmentCapsule, StaysInsideTheBody) {
  const Skeleton body = canonical_skeleton(1.75);
  const auto height = [&](Joint j, double z) { return 0.530 * 1.75 + at_rest(body, j).z() + z; };
  const Capsule head = segment_capsule(body, Joint::kHead);
  EXPECT_NEAR(height(Joint::kHead, head.p_BE.z() + head.radius), 1.75, 1e-6);
  const Capsule pelvis = segment_capsule(body, Joint::kPelvis);
  EXPECT_NEAR(height(Joint::kPelvis, pelvis.p_BA.z() - pelvis.radius), 0.481 * 1.75, 1e-6);
  const Capsule chest = segment_capsule(body, Joint::kSpineUpper);
  EXPECT_NEAR(height(Joint::kSpineUpper, chest.p_BE.z() + chest.radius), 0.860 * 1.75, 1e-6);
}

TEST(SegmentCapsule, HangingArmsTouchNoTrunk) {
  const Skeleton body = canonical_skeleton();
  for (const Joint arm : {Joint::kLeftShoulder, Joint::kLeftElbow, Joint::kLeftWrist}) {
    const double inner = at_rest(body, arm).y() - segment_capsule(body, arm).radius;
    for (const Joint trunk : {Joint::kPelvis, Joint::kSpineLower, Joint::kSpineUpper}) {
      EXPECT_GT(inner, segment_capsule(body, trunk).radius);
    }
  }
}

TEST(SkinPlace, LiesOnTheSkinAndLooksAway) {
  const Skeleton body = canonical_skeleton();
  std::mt19937_64 random(1);
  std::uniform_real_distribution<double> along(0.0, 1.0), angle(-2.0 * kPi, 2.0 * kPi);
  for (int i = 0; i < 1000; ++i) {
    const Joint segment = joint(static_cast<std::size_t>(i) % kJointCount);
    const Capsule capsule = segment_capsule(body, segment);
    const SkinPlace place = skin_place(body, segment, along(random), angle(random));
    EXPECT_NEAR(place.n_B.norm(), 1.0, 1e-12);
    EXPECT_NEAR(place.n_B.dot(capsule.p_BE - capsule.p_BA), 0.0, 1e-12);
    EXPECT_NEAR(distance_from_axis(capsule, place.p_BS), capsule.radius, 1e-12);
    EXPECT_NEAR(distance_from_axis(capsule, place.p_BS + 0.01 * place.n_B), capsule.radius + 0.01,
                1e-12);
  }
}

TEST(SkinPlace, IsFrontAndLeftInTheRestPose) {
  const Skeleton body = canonical_skeleton();
  for (const Joint segment : {Joint::kPelvis, Joint::kHead, Joint::kLeftElbow, Joint::kRightHip}) {
    EXPECT_TRUE(skin_place(body, segment, 0.5, 0.0).n_B.isApprox(Eigen::Vector3d::UnitX(), 1e-9));
    EXPECT_TRUE(
        skin_place(body, segment, 0.5, kPi / 2).n_B.isApprox(Eigen::Vector3d::UnitY(), 1e-9));
  }
  // The front of a foot and of its toes is their top, its left is left.
  for (const Joint segment : {Joint::kLeftAnkle, Joint::kRightToes}) {
    EXPECT_GT(skin_place(body, segment, 0.5, 0.0).n_B.z(), 0.9);
    EXPECT_GT(skin_place(body, segment, 0.5, kPi / 2).n_B.y(), 0.99);
  }
}

TEST(SkinPlace, MirrorsWithItsSegment) {
  const Skeleton body = canonical_skeleton();
  const Eigen::Vector3d mirror(1.0, -1.0, 1.0);
  for (std::size_t i = 0; i < kJointCount; ++i) {
    for (const double angle : {0.0, 0.7, 2.0, -1.1}) {
      const SkinPlace a = skin_place(body, joint(i), 0.3, angle);
      const SkinPlace b = skin_place(body, mirrored(joint(i)), 0.3, -angle);
      EXPECT_TRUE(a.p_BS.isApprox(mirror.cwiseProduct(b.p_BS), 1e-9)) << joint_name(joint(i));
      EXPECT_TRUE(a.n_B.isApprox(mirror.cwiseProduct(b.n_B), 1e-9)) << joint_name(joint(i));
    }
  }
}

TEST(SkinPlace, IsFiniteOnAStumpWithoutLength) {
  std::vector<Segment> segments = canonical_skeleton().segments();
  for (const Joint end : {Joint::kPelvis, Joint::kHead, Joint::kLeftWrist, Joint::kLeftToes}) {
    segments[index(end)].p_BE.setZero();
  }
  const Skeleton body(segments);
  for (const Joint end : {Joint::kPelvis, Joint::kHead, Joint::kLeftWrist, Joint::kLeftToes}) {
    const SkinPlace place = skin_place(body, end, 0.5, 1.0);
    EXPECT_TRUE(place.p_BS.allFinite());
    EXPECT_NEAR(place.n_B.norm(), 1.0, 1e-12);
  }
}

}  // namespace
}  // namespace secondskin
