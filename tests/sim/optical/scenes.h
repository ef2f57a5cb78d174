#pragma once

#include <filesystem>
#include <functional>
#include <vector>

#include "motion/retarget.h"
#include "sim/optical/suit_scene.h"
#include "sim/optical/virtual_rig.h"

namespace secondskin::sim {

inline const std::filesystem::path kSource = SECONDSKIN_SOURCE_DIR;

/// Detectors that are where a function says, and hidden where another says.
class FakeScene final : public OpticalScene {
 public:
  using Function = std::function<DetectorState(std::size_t detector, double time)>;
  FakeScene(std::size_t detectors, Function function)
      : detectors_(detectors), function_(std::move(function)) {}

  std::size_t detectors() const override { return detectors_; }
  void at(double time, std::span<DetectorState> states) override {
    for (std::size_t i = 0; i < states.size(); ++i) states[i] = function_(i, time);
  }
  bool hidden(std::size_t, const Eigen::Vector3d&) const override { return false; }

 private:
  std::size_t detectors_;
  Function function_;
};

/// A projector on the world's x axis that looks along it; its own x is -y of the world.
inline constexpr double kProjectorX = -2.0;
inline VirtualProjector projector_on_x() {
  VirtualProjector projector;
  projector.X_WJ.linear() << 0, 0, 1, -1, 0, 0, 0, -1, 0;
  projector.X_WJ.translation().x() = kProjectorX;
  return projector;
}

inline OpticalNoise no_noise() {
  OpticalNoise noise;
  noise.count_sigma = 0.0;
  return noise;
}

/// A body of 1.75 m that stands still in the middle of the rig, facing +x.
inline Motion standing(std::size_t poses = 2) {
  Motion motion{canonical_skeleton(1.75), 60.0, {}};
  Pose pose(kJointCount);
  pose.p_WR = {0.0, 0.0, 0.530 * 1.75};
  motion.poses.assign(poses, pose);
  return motion;
}

inline Motion reference(const std::string& name) {
  return read_canonical(kSource / "reference_motions" / name / "motion.bvh",
                        kSource / "joint_maps");
}

inline Suit shipped_suit(const std::string& name) {
  return Suit::load(kSource / "suits" / (name + ".toml"));
}

}  // namespace secondskin::sim
