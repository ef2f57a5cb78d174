#pragma once

#include "motion/anatomy.h"

/// How thick the limbs are: each canonical segment as a capsule around its long axis. For placing
/// what is worn on the skin, and for what hides it.
namespace secondskin {

/// A segment's long axis and its radius. Frame: B the segment's.
struct Capsule {
  Eigen::Vector3d p_BA;  ///< where the axis begins [m]
  Eigen::Vector3d p_BE;  ///< where it ends [m]
  double radius;         ///< at the middle of the axis [m]
};

/// The stature that an average body with these legs and this trunk has [m].
double average_stature(const Skeleton& canonical) noexcept;

/// The capsule of one segment of a canonical body, in proportion to its lengths.
Capsule segment_capsule(const Skeleton& canonical, Joint segment) noexcept;

/// Height of a foot's ball, the toes' joint, over the sole: as on an average body with this ankle.
/// @param toes  kLeftToes or kRightToes; [m]
double ball_height(const Skeleton& canonical, Joint toes) noexcept;

/// A place on the skin. Frame: B the segment's.
struct SkinPlace {
  Eigen::Vector3d p_BS;  ///< [m]
  Eigen::Vector3d n_B;   ///< unit, pointing away from the body
};

/// @param along  0 at the beginning of the segment's axis, 1 at its end
/// @param angle  around the segment in the rest pose: 0 front (x), pi/2 left (y) [rad]
SkinPlace skin_place(const Skeleton& canonical, Joint segment, double along, double angle) noexcept;

}  // namespace secondskin
