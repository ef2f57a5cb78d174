#pragma once

#include <array>
#include <cstddef>

#include "coach/align/pose_features.h"
#include "coach/align/posture_offset.h"

/// Turns a learner's poses into features: remembers the last ones, so that velocities are taken
/// over kVelocityLag whatever the rate. No allocation.
namespace secondskin::coach {

class LearnerStream {
 public:
  void clear() noexcept { size_ = last_ = 0; }

  /// @param time  of the pose, later than the last one's [s]
  /// @param weight  of the joints; a joint's counts as far as the learner's confidence goes
  /// @returns false when no joint can be compared.
  bool take(double time, const Pose& learner, const std::array<float, kJointCount>& weight,
            const PostureOffset& posture, LearnerFeatures& out) noexcept;

 private:
  struct Past {
    double time;
    std::array<JointFeature, kJointCount> measured;
    std::array<bool, kJointCount> known;
  };
  static constexpr std::size_t kHistory = 32;
  static constexpr double kHistoryStep = 0.004;  // [s]; all of it reaches beyond the lag

  std::array<Past, kHistory> history_;
  std::size_t size_ = 0, last_ = 0;
};

}  // namespace secondskin::coach
