#pragma once

#include <memory>
#include <numbers>
#include <random>

#include "coach/correct/correction.h"
#include "motion/rotation.h"

/// References and learners made up for the tests, from fixed-seed generators.
namespace secondskin::coach {

inline constexpr double kDegree = std::numbers::pi / 180.0;

/// A reference that stays in one pose for ten seconds: all weights 1, dead bands of 10 degrees.
inline Reference still_reference(const Pose& pose) {
  Reference reference{.name = "still",
                      .description = {},
                      .origin = {},
                      .licence = {},
                      .motion = Motion{canonical_skeleton(1.75), kReferenceRate, {}}};
  reference.weight.fill(1.0);
  reference.tolerance.fill(kDefaultTolerance_deg * kDegree);
  reference.motion.poses.assign(600, pose);
  return reference;
}

/// A reference in which every joint swings through the middle of its range.
inline Reference moving_reference() {
  Reference reference = still_reference(Pose(kJointCount));
  for (std::size_t f = 0; f < reference.motion.poses.size(); ++f) {
    const double t = static_cast<double>(f) / kReferenceRate;
    for (std::size_t j = 1; j < kJointCount; ++j) {
      JointAngles angles{};
      for (std::size_t m = 0; m < 3; ++m) {
        const AngleRange range = canonical_anatomy()[j].range[m];
        const double middle = 0.5 * (range.min + range.max);
        angles[m] =
            middle + 0.2 * (range.max - range.min) * std::sin(2.0 * t + static_cast<double>(j + m));
      }
      reference.motion.poses[f].q_PB[j] = joint_rotation(static_cast<Joint>(j), angles);
    }
  }
  return reference;
}

inline std::shared_ptr<const Reference> shared(Reference reference) {
  return std::make_shared<const Reference>(std::move(reference));
}

/// A learner within the joints' limits, else at random, at a random time of the reference.
inline CorrectionProblem random_problem(std::mt19937& generator) {
  std::uniform_real_distribution<double> share(0.02, 0.98);
  std::normal_distribution<double> speed(0.0, 1.0);
  CorrectionProblem problem;
  problem.learner = Pose(kJointCount);
  for (std::size_t j = 0; j < kJointCount; ++j) {
    JointAngles angles{};
    for (std::size_t m = 0; m < 3; ++m) {
      AngleRange range = canonical_anatomy()[j].range[m];
      if (j == 0) range = {-0.6, 0.6};
      angles[m] = range.min + share(generator) * (range.max - range.min);
    }
    problem.learner.q_PB[j] = joint_rotation(static_cast<Joint>(j), angles);
    for (double& w : problem.velocity[j]) w = speed(generator);
  }
  problem.reference_time = 9.0 * share(generator);
  problem.tempo = 2.0 * share(generator);
  return problem;
}

/// The learner does what the reference does, but for errors that swing slowly; smooth in `t`, as
/// the problems of a live session are.
inline CorrectionProblem swinging_problem(const Reference& reference, double t, double error) {
  CorrectionProblem problem;
  problem.learner = Pose(kJointCount);
  problem.reference_time = t;
  Pose now(kJointCount), next(kJointCount);
  sample(reference.motion, t, now);
  sample(reference.motion, t + 1e-2, next);
  for (std::size_t j = 0; j < kJointCount; ++j) {
    const double phase = 2.4 * static_cast<double>(j);
    const Eigen::Vector3d e(std::sin(3.0 * t + phase), std::sin(2.3 * t + 2.0 * phase),
                            std::cos(2.7 * t + phase));
    problem.learner.q_PB[j] = now.q_PB[j] * quaternion_from(error * e);
    problem.velocity[j] = rotation_vector(now.q_PB[j].conjugate() * next.q_PB[j]) / 1e-2;
  }
  return problem;
}

inline std::size_t asked_count(const CorrectionResult& result) {
  std::size_t count = 0;
  for (const Eigen::Vector3d& v : result.target) count += v.isZero() ? 0 : 1;
  return count;
}

}  // namespace secondskin::coach
