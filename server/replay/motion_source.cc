#include "server/replay/motion_source.h"

#include <cmath>
#include <stdexcept>

#include "motion/anatomy.h"

namespace secondskin::server {

MotionSource::MotionSource(Motion motion) : motion_(std::move(motion)) {
  if (motion_.poses.empty()) throw std::invalid_argument("a motion to replay needs poses");
  if (!is_canonical(motion_.skeleton)) {
    throw std::invalid_argument("a motion to replay must have the canonical joints");
  }
}

Next MotionSource::next(StampedPose& pose) {
  if (next_ >= motion_.poses.size()) return Next::kEnd;
  pose.frame = next_;
  pose.stamp_ns = std::llround(1e9 * static_cast<double>(next_) / motion_.rate_hz);
  pose.pose = motion_.poses[next_];
  ++next_;
  return Next::kPose;
}

bool MotionSource::rewind() {
  next_ = 0;
  return true;
}

}  // namespace secondskin::server
