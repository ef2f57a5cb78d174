#pragma once

#include <cmath>
#include <filesystem>
#include <memory>
#include <numbers>
#include <random>
#include <string>
#include <vector>

#include "coach/align/aligner.h"
#include "motion/rotation.h"

/// Learners whose place in the reference is known: the reference itself under a time warp.
namespace secondskin::coach {

inline constexpr double kDegree = std::numbers::pi / 180.0;
inline constexpr double kLearnerRate = 62.5;  // [Hz], Second Skin's

inline const std::filesystem::path kReferences =
    std::filesystem::path(SECONDSKIN_SOURCE_DIR) / "reference_motions";
inline const std::filesystem::path kJointMaps =
    std::filesystem::path(SECONDSKIN_SOURCE_DIR) / "joint_maps";

inline std::shared_ptr<const Reference> shipped(const std::string& name) {
  return std::make_shared<const Reference>(load_reference(kReferences / name, kJointMaps));
}

inline Motion shipped_learner(const std::string& name) {
  return read_canonical(kReferences / name / "learner.bvh", kJointMaps);
}

inline std::shared_ptr<const Reference> reference_of(const Motion& motion) {
  return std::make_shared<const Reference>(make_reference("test", motion));
}

inline std::int64_t stamp(double seconds) {
  return 1'700'000'000'000'000'000 + static_cast<std::int64_t>(std::llround(seconds * 1e9));
}

/// RMS over the joints but the pelvis [rad].
inline double rms_distance(const Pose& a, const Pose& b) {
  double sum = 0.0;
  for (std::size_t j = 1; j < kJointCount; ++j) {
    const double d = geodesic_distance(a.q_PB[j], b.q_PB[j]);
    sum += d * d;
  }
  return std::sqrt(sum / static_cast<double>(kJointCount - 1));
}

/// One frame of a learner, and the truth about it.
struct Frame {
  double time = 0.0;  ///< [s]
  Pose pose;
  double truth = 0.0;   ///< reference time [s]
  bool moving = false;  ///< more than 15 degrees a second, RMS over the joints
};

struct Warp {
  double noise = 0.0;            ///< of each axis of each joint [rad]
  double noise_corner_hz = 0.0;  ///< 0: white
  double dropped = 0.0;          ///< share of the frames
  double jitter = 0.0;           ///< of the stamps [s]
  double pause = 0.0;            ///< every three seconds of the reference [s]
  double skip = 0.0;             ///< likewise
  std::vector<Joint> missing = {};
  unsigned seed = 0;
};

/// The motion at a tempo that varies smoothly between 1/2 and 2.
/// @param events  out: the times at which a pause or a skip ended [s]
inline std::vector<Frame> warped(const Motion& motion, const Warp& warp,
                                 std::vector<double>* events = nullptr) {
  std::mt19937 random(warp.seed);
  std::normal_distribution<double> normal;
  std::uniform_real_distribution<double> uniform;
  const double slow = 2.0 + 2.0 * uniform(random), fast = 1.2 + 0.8 * uniform(random);
  const double phase = 6.28 * uniform(random), other = 6.28 * uniform(random);
  const double dt = 1.0 / kLearnerRate;
  std::vector<Eigen::Vector3d> noise(kJointCount, Eigen::Vector3d::Zero());
  std::vector<Frame> frames;
  Pose ahead(kJointCount);
  double x = 0.0, pause_left = 0.0, next_event = 1.5 + uniform(random);
  for (int i = 0; x < motion.duration(); ++i) {
    const double t = i * dt;
    double tempo =
        std::exp(std::clamp(0.5 * std::sin(2.0 * std::numbers::pi * t / slow + phase) +
                                0.35 * std::sin(2.0 * std::numbers::pi * t / fast + other),
                            -std::numbers::ln2, std::numbers::ln2));
    if ((warp.pause > 0.0 || warp.skip > 0.0) && x > next_event && x + 3.0 < motion.duration()) {
      x += warp.skip;
      next_event = x + 3.0 + uniform(random);
      pause_left = warp.pause;
      if (warp.skip > 0.0 && events != nullptr) events->push_back(t);
    }
    if (pause_left > 0.0) {
      tempo = 0.0;
      pause_left -= dt;
      if (pause_left <= 0.0 && events != nullptr) events->push_back(t);
    }
    Frame frame;
    sample(motion, x, frame.pose);
    sample(motion, x + 0.02, ahead);
    frame.moving = rms_distance(frame.pose, ahead) / 0.02 * tempo > 15.0 * kDegree;
    frame.truth = x;
    for (std::size_t j = 0; warp.noise > 0.0 && j < kJointCount; ++j) {
      const Eigen::Vector3d fresh =
          warp.noise * Eigen::Vector3d(normal(random), normal(random), normal(random));
      const double keep = warp.noise_corner_hz > 0.0 && i > 0
                              ? std::exp(-2.0 * std::numbers::pi * warp.noise_corner_hz * dt)
                              : 0.0;
      noise[j] = keep * noise[j] + std::sqrt(1.0 - keep * keep) * fresh;
      frame.pose.q_PB[j] = (frame.pose.q_PB[j] * quaternion_from(noise[j])).normalized();
    }
    for (const Joint j : warp.missing) frame.pose.confidence[index(j)] = 0.0F;
    frame.time = t + warp.jitter * (2.0 * uniform(random) - 1.0);
    if (!(uniform(random) < warp.dropped)) frames.push_back(std::move(frame));
    x += tempo * dt;
  }
  return frames;
}

}  // namespace secondskin::coach
