#pragma once

#include <array>
#include <cmath>
#include <numbers>
#include <random>
#include <vector>

#include "motion/kinematics.h"
#include "motion/motion.h"
#include "server/markers/marker_body.h"

/// A body that moves by formula, and markers on it: the truth for tests.
namespace secondskin::server {

constexpr double kDegree = std::numbers::pi / 180.0;

/// Knee bends with raised and bending arms, beginning and ending in upright standing.
inline Motion moving_body(std::size_t frames = 200, double rate_hz = 100.0) {
  Motion motion{canonical_skeleton(1.75), rate_hz, {}};
  for (std::size_t f = 0; f < frames; ++f) {
    const double phase = static_cast<double>(f) / static_cast<double>(frames - 1);
    const double bend = std::pow(std::sin(std::numbers::pi * phase), 2.0);
    const double wave = std::sin(6.0 * std::numbers::pi * phase) * bend;
    Pose pose(kJointCount);
    const auto set = [&](Joint joint, double flexion, double abduction, double rotation) {
      pose.q_PB[index(joint)] =
          joint_rotation(joint, {flexion * kDegree, abduction * kDegree, rotation * kDegree});
    };
    set(Joint::kPelvis, 20.0 * bend, 0.0, 30.0 + 10.0 * wave);
    set(Joint::kSpineLower, 25.0 * bend, 5.0 * wave, 10.0 * wave);
    set(Joint::kNeck, -10.0 * bend, 0.0, 15.0 * wave);
    for (const Joint left : {Joint::kLeftHip, Joint::kLeftKnee, Joint::kLeftAnkle,
                             Joint::kLeftShoulder, Joint::kLeftElbow, Joint::kLeftWrist}) {
      for (const Joint joint : {left, mirrored(left)}) {
        const double side = joint == left ? 1.0 : 0.8;
        switch (left) {
          case Joint::kLeftHip:
            set(joint, 80.0 * bend * side, 10.0 * bend, 0.0);
            break;
          case Joint::kLeftKnee:
            set(joint, 90.0 * bend * side, 0.0, 0.0);
            break;
          case Joint::kLeftAnkle:
            set(joint, 15.0 * bend, 0.0, 0.0);
            break;
          case Joint::kLeftShoulder:
            set(joint, 60.0 * bend * side, 30.0 * bend, 20.0 * wave);
            break;
          case Joint::kLeftElbow:
            set(joint, 10.0 + 70.0 * bend * side, 0.0, 20.0 * wave);
            break;
          default:
            set(joint, 15.0 * wave, 0.0, 0.0);
            break;
        }
      }
    }
    pose.p_WR = {0.3 * phase, 0.1 * wave, 0.9275 - 0.35 * bend};
    motion.poses.push_back(std::move(pose));
  }
  return motion;
}

/// The set's markers, each at its nominal place, on a body of the nominal proportions.
inline MarkerMotion markers_on(const Motion& motion, const MarkerSet& set, double noise = 0.0) {
  std::mt19937 random(7);
  std::normal_distribution<double> normal(0.0, 1.0);
  MarkerMotion result{{}, motion.rate_hz, {}};
  for (const MarkerPlace& place : set.places()) result.names.push_back(place.names[0]);
  std::array<Eigen::Isometry3d, kJointCount> X_WB;
  for (const Pose& pose : motion.poses) {
    forward_kinematics(motion.skeleton, pose.p_WR, pose.q_PB, X_WB);
    MarkerFrame frame(set.places().size());
    for (std::size_t m = 0; m < set.places().size(); ++m) {
      const MarkerPlace& place = set.places()[m];
      frame.p_WM[m] = X_WB[index(place.segment)] * place.p_BM;
      for (Eigen::Index k = 0; k < 3; ++k) frame.p_WM[m][k] += noise * normal(random);
      frame.visible[m] = 1;
    }
    result.frames.push_back(std::move(frame));
  }
  return result;
}

inline MarkerSet plug_in_gait() {
  return MarkerSet::load(SECONDSKIN_SOURCE_DIR "/marker_sets/plug_in_gait.toml");
}

/// The body that the markers of markers_on sit on, as if calibrated without an error.
inline MarkerBody exact_body(const Motion& motion, const MarkerSet& set) {
  MarkerBody body{motion.skeleton, {}};
  for (std::size_t m = 0; m < set.places().size(); ++m) {
    const MarkerPlace& place = set.places()[m];
    body.attachments.push_back({m, place.names[0], place.segment, place.p_BM, place.sway});
  }
  return body;
}

}  // namespace secondskin::server
