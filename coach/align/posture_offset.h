#pragma once

#include <array>

#include "coach/align/pose_features.h"

/// How this learner's joints are held otherwise than the expert's, all the time: q_learner =
/// q_expert
/// * offset. Learned at rest before the start and slowly on the way; taken off before poses are
/// compared, so that the aligner compares how people move rather than how they are built and stand.
/// docs/alignment.md, section 1.
namespace secondskin::coach {

class PostureOffset {
 public:
  void clear() noexcept;

  /// Goes a part of the way from what is believed to what is seen.
  /// @param learner  as measured
  /// @param expert  his features at the same moment; zero for a joint that is not compared
  /// @param share  of the way, 0 to 1
  void learn(const LearnerFeatures& learner, const std::array<JointFeature, kJointCount>& expert,
             float share) noexcept;

  /// Takes a share off what is believed.
  void forget(float share) noexcept;

  /// The feature without the offset.
  JointFeature without(std::size_t joint, const JointFeature& feature) const noexcept {
    return turned(joint, applied_[joint], feature);
  }

 private:
  using Rotation = std::array<float, 3>;  // rotation vector [rad]
  static JointFeature turned(std::size_t joint, const JointFeature& by,
                             const JointFeature& feature) noexcept;
  void apply(std::size_t joint) noexcept;

  std::array<Rotation, kJointCount> offset_{};
  std::array<JointFeature, kJointCount> applied_{};  // inverse, as quaternions (w, x, y, z)
};

}  // namespace secondskin::coach
