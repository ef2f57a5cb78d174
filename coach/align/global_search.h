#pragma once

#include <vector>

#include "coach/align/pose_features.h"

/// Finds a learner who is outside the filter's window: a leaky dynamic time warping of the last
/// half second against the whole reference, a bounded piece of it at each frame. docs/alignment.md,
/// section 3.
namespace secondskin::coach {

class GlobalSearch {
 public:
  struct Found {
    double position = 0.0;  ///< frame of the reference, moved on to now at the tempo of the expert
    double cost = 0.0;      ///< mean squared distance along the path there [rad^2]
    double here = 0.0;      ///< the same for the best path to the position asked about [rad^2]
    double speed = 0.0;     ///< RMS joint speed of the learner [rad/s]
  };

  explicit GlobalSearch(const Reference& reference);

  void reset() noexcept;

  /// Does the next piece of work.
  /// @param time  of the pose [s]
  /// @param here  the position that the aligner believes in [frames of the reference]
  /// @returns true when a pass over the whole reference has ended; then `found` is written.
  bool update(const LearnerFeatures& learner, double time, double here, Found& found) noexcept;

 private:
  void extend(std::size_t begin, std::size_t end) noexcept;

  ReferenceFeatures features_;
  double rate_hz_;
  LearnerFeatures learner_;  // held during a pass
  double pass_time_ = 0.0;   // of learner_
  double last_pass_time_ = 0.0;
  std::size_t next_ = 0;  // first frame not yet compared in this pass
  double passes_ = 0.0;
  std::size_t reach_ = 0;  // frames that a path may advance in this pass
  float keep_ = 0.0F;      // share of the past in the accumulated cost
  std::vector<float> pose_, cross_, speed_;
  std::vector<float> accumulated_, previous_;
};

}  // namespace secondskin::coach
