#pragma once

#include "motion/motion.h"
#include "server/pose_source.h"

namespace secondskin::server {

/// Replays a canonical motion in memory, pose after pose, at the motion's own rate.
class MotionSource final : public PoseSource {
 public:
  /// @throws std::invalid_argument unless the motion is canonical and has poses.
  explicit MotionSource(Motion motion);

  const Skeleton& skeleton() const override { return motion_.skeleton; }
  double rate_hz() const override { return motion_.rate_hz; }
  Next next(StampedPose& pose) override;
  bool rewind() override;

 private:
  Motion motion_;
  std::size_t next_ = 0;
};

}  // namespace secondskin::server
