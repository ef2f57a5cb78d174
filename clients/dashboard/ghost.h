#pragma once

#include <memory>
#include <vector>

#include "coach/reference.h"

/// The expert's motion on the learner's body, to be drawn over the learner. Pure.
///
/// As the coach compares them: body size, place and heading do not matter. So the ghost has the
/// learner's segments, stands where the learner stands, and turns about the vertical with them; its
/// height over the floor is the expert's, in proportion to the legs.
namespace secondskin::dashboard {

class Ghost {
 public:
  /// @param reference  at the block's tempo
  /// @param learner    canonical
  Ghost(std::shared_ptr<const coach::Reference> reference, const Skeleton& learner);

  /// @param reference_time  held at both ends [s]
  /// @param learner         the newest pose; call it with each, it tells where the floor is
  /// @param ghost           out
  void place(double reference_time, const Pose& learner, Pose& ghost);

 private:
  double lowest(const Skeleton& skeleton, const Pose& pose);

  std::shared_ptr<const coach::Reference> reference_;
  Skeleton learner_;
  double scale_ = 1.0;             ///< the learner's legs by the expert's
  std::vector<double> clearance_;  ///< of the expert's lowest point over the floor, by frame [m]
  std::vector<Eigen::Isometry3d> X_WB_;
  double floor_;  ///< under the learner [m]
};

}  // namespace secondskin::dashboard
