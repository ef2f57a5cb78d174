#pragma once

#include <span>
#include <vector>

#include "coach/plan/feedback_schedule.h"
#include "coach/tactile/tactile_mapper.h"

/// What was cued in a session, frame by frame, as cues that a yoked session can get.
namespace secondskin::coach {

class CueLog {
 public:
  /// Takes a frame.
  /// @param repetition  finished before it in the session
  /// @param share       of the reference's duration that is reached, 0 to 1
  /// @param cues        given at this frame; alarms are left out
  /// @param error, tolerance  of the joints at this frame [rad]
  void take(std::uint32_t repetition, double share, std::span<const Cue> cues,
            const CorrectionResult& correction, const JointVectors& error,
            const std::array<double, kJointCount>& tolerance);

  /// The cues by their beginning, each with the mean of what it asked for.
  std::vector<GivenCue> cues() const;

 private:
  struct Open {
    bool on = false;
    std::size_t at = 0;  ///< in given_
  };
  struct Sums {
    Eigen::Vector3d direction = Eigen::Vector3d::Zero();
    double excess = 0.0;
    std::size_t frames = 0;
  };
  std::vector<GivenCue> given_;
  std::vector<Sums> sums_;  ///< one for each of given_
  std::array<Open, kJointCount> open_{};
};

}  // namespace secondskin::coach
