#pragma once

#include <algorithm>
#include <cmath>
#include <numbers>
#include <random>

#include "motion/anatomy.h"
#include "motion/motion.h"
#include "motion/rotation.h"

/// The movements that docs/wearable.md asks for before a capture with boards that sit as they may,
/// as a person does them: not quite about the axis that is meant.
namespace secondskin {

/// Marching in place with swinging, bending arms, and two bows: 16 s at 100 Hz.
inline Motion functional_movements(std::uint64_t seed) {
  std::mt19937_64 random(seed);
  std::normal_distribution<double> normal;
  Motion motion{canonical_skeleton(), 100.0, {}};
  // Each joint's axis is off by some 5 degrees, and it turns and sways a little beside.
  std::array<Eigen::Vector3d, kJointCount> axis;
  for (auto& a : axis) {
    a = (Eigen::Vector3d::UnitY() + 0.06 * Eigen::Vector3d(normal(random), 0, normal(random)))
            .normalized();
  }
  std::array<double, kJointCount> phase;
  for (auto& p : phase) p = 3.0 * normal(random);
  for (int i = 0; i < 1600; ++i) {
    const double t = 0.01 * i;
    Pose pose(kJointCount);
    const auto turn = [&](Joint joint, double angle) {
      const std::size_t j = index(joint);
      const Eigen::Vector3d sway(0.1 * std::abs(angle) * std::sin(1.3 * t + phase[j]), 0.0,
                                 0.1 * std::abs(angle) * std::cos(1.7 * t + phase[j]));
      pose.q_PB[j] = quaternion_from(angle * axis[j] + sway);
    };
    const auto swing = [&](double begin, double end, double hz, double shift) {
      if (t < begin || t > end) return 0.0;
      const double fade = std::min({1.0, t - begin, end - t});
      return fade * std::sin(2.0 * std::numbers::pi * hz * (t - begin) + shift);
    };
    for (const bool left : {true, false}) {
      const auto side = [&](Joint joint) { return left ? joint : mirrored(joint); };
      const double step = swing(0.0, 9.0, 0.8, left ? 0.0 : std::numbers::pi);
      const double lift = std::max(0.0, step);
      turn(side(Joint::kLeftHip), -1.2 * lift);
      turn(side(Joint::kLeftKnee), 1.5 * lift);
      turn(side(Joint::kLeftAnkle), 0.4 * lift);
      const double bow = std::abs(swing(9.5, 15.5, 0.17, 0.0));
      turn(side(Joint::kLeftShoulder), 0.9 * std::min(0.3, step) - 1.1 * bow);  // arms hang
      turn(side(Joint::kLeftElbow), -0.5 * std::max(0.0, -step));
      turn(side(Joint::kLeftWrist), -0.15 * std::max(0.0, -step));
    }
    const double bow = std::abs(swing(9.5, 15.5, 0.17, 0.0));
    turn(Joint::kPelvis, 0.5 * bow + 0.04 * swing(0.0, 9.0, 0.8, 1.0));
    turn(Joint::kSpineMiddle, 0.3 * bow);
    turn(Joint::kSpineUpper, 0.3 * bow);
    turn(Joint::kHead, 0.5 * bow);
    pose.p_WR.z() = 0.93 + 0.02 * std::abs(swing(0.0, 9.0, 0.8, 0.0));
    motion.poses.push_back(std::move(pose));
  }
  return motion;
}

}  // namespace secondskin
