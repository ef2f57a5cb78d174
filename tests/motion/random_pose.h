#pragma once

#include <random>

#include "motion/rotation.h"
#include "motion/skeleton.h"

/// Random rotations and poses from a generator with a fixed seed.
namespace secondskin {

inline Eigen::Vector3d random_vector(std::mt19937& generator, double sigma) {
  std::normal_distribution<double> normal(0.0, sigma);
  const double x = normal(generator), y = normal(generator), z = normal(generator);
  return {x, y, z};
}

/// Uniform on SO(3).
inline Eigen::Quaterniond random_rotation(std::mt19937& generator) {
  std::normal_distribution<double> normal;
  const double w = normal(generator), x = normal(generator), y = normal(generator),
               z = normal(generator);
  return Eigen::Quaterniond(w, x, y, z).normalized();
}

inline Pose random_pose(std::mt19937& generator, std::size_t segments) {
  Pose pose(segments);
  pose.p_WR = random_vector(generator, 1.0);
  for (Eigen::Quaterniond& q : pose.q_PB) q = random_rotation(generator);
  return pose;
}

}  // namespace secondskin
