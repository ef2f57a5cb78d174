#pragma once

#include <array>
#include <cstddef>
#include <vector>

#include "motion/kinematics.h"
#include "motion/motion.h"
#include "motion/suit.h"
#include "sim/optical/virtual_rig.h"

namespace secondskin::sim {

/// What a scene shows when its motion has ended.
enum class AtEnd {
  kHold,          ///< the last pose
  kLoop,          ///< the motion again, with a jump where its ends differ
  kThereAndBack,  ///< the motion backwards and forwards, without a jump
};

/// A suit on a body that moves by a real motion. The motion is the truth that a tracker is measured
/// against.
///
/// Frames: W as the motion's, which is the rig's. A detector sits on its segment's capsule
/// (body_shape.h) and looks along its normal; the capsules of all other segments hide it.
class SuitScene final : public OpticalScene {
 public:
  /// @throws std::invalid_argument unless the motion is canonical and has poses.
  SuitScene(Motion canonical, const Suit& suit, AtEnd at_end = AtEnd::kHold);

  std::size_t detectors() const override { return places_.size(); }
  void at(double time, std::span<DetectorState> states) override;
  bool hidden(std::size_t detector, const Eigen::Vector3d& p_W) const override;

  const Skeleton& skeleton() const noexcept { return motion_.skeleton; }
  /// The body's true pose at a time [s]. No allocation when `out` has the size.
  void pose_at(double time, Pose& out) const;
  /// Where the segments were at the last at(). Frames: X_WB.
  std::span<const Eigen::Isometry3d> segments() const noexcept { return X_WB_; }
  /// Where a detector sits on the body. Frame: its segment's.
  const SkinPlace& place(std::size_t detector) const noexcept { return places_[detector]; }
  Joint segment(std::size_t detector) const noexcept { return segments_[detector]; }

 private:
  struct Limb {
    Eigen::Vector3d p_WA, p_WE;
    double radius;
  };

  Motion motion_;
  AtEnd at_end_;
  std::vector<SkinPlace> places_;
  std::vector<Joint> segments_;
  std::array<Capsule, kJointCount> capsules_;
  Pose pose_;
  std::vector<Eigen::Isometry3d> X_WB_;
  std::vector<Eigen::Vector3d> p_WS_;
  std::array<Limb, kJointCount> limbs_;
};

/// The same motion kept over the world's origin: the root's horizontal path without its part that
/// is slower than a time, so that a body that walks away stays in the tracking volume as on a
/// treadmill. Gaussian, without delay. The rest of the pose stays.
/// @param sigma  of the Gaussian [s]; infinity takes the mean away only
Motion recentred(Motion motion, double sigma = 0.5);

}  // namespace secondskin::sim
