#pragma once

#include <span>
#include <vector>

#include "motion/skeleton.h"

/// A motion is a skeleton and its poses at equal steps of time.
namespace secondskin {

struct Motion {
  Skeleton skeleton;
  double rate_hz;           ///< poses a second, > 0
  std::vector<Pose> poses;  ///< at least one

  /// Time of the last pose; the first is at 0 [s].
  double duration() const noexcept { return static_cast<double>(poses.size() - 1) / rate_hz; }
};

/// Blends two poses of one skeleton: linear for the root's position, slerp for the joints; a
/// confidence is the smaller of the two.
/// @param u    0 gives a, 1 gives b
/// @param out  any pose with the same number of segments; not resized, so nothing is allocated
void interpolate(const Pose& a, const Pose& b, double u, Pose& out) noexcept;

/// The motion's pose at a time [s], held at both ends. No allocation when `out` has the size.
void sample(const Motion& motion, double time, Pose& out);

/// The same motion at another rate: slerp between neighbours. @throws std::invalid_argument unless
/// rate_hz is finite and > 0.
Motion resample(const Motion& motion, double rate_hz);

/// Poses with uneven stamps at equal steps of time, from the first to the last: slerp between
/// neighbours. A pose that is not valid or not later than the one before is left out.
/// @throws std::invalid_argument when no pose is left, or as resample().
Motion evenly(const Skeleton& skeleton, double rate_hz, std::span<const StampedPose> poses);

/// Poses [begin, end) as a motion of their own. @throws std::out_of_range on an empty or wrong
/// range.
Motion slice(const Motion& motion, std::size_t begin, std::size_t end);

}  // namespace secondskin
