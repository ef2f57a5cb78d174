#pragma once

#include <Eigen/Core>
#include <span>

#include "motion/body_shape.h"

/// How a body stands in the way of sound: capsules between a source and a microphone, by the
/// knife-edge diffraction of ITU-R P.526 (section 4.1).
namespace secondskin::sim {

/// A capsule in the world.
struct Limb {
  Eigen::Vector3d p_WA, p_WE;  ///< ends of the axis [m]
  double radius;               ///< [m]
};

/// What is left of the direct sound.
struct Shadow {
  double amplitude = 1.0;  ///< of what it would be in the open, 0 to 1
  double detour = 0.0;     ///< how much longer the way around is [m]
};

/// A limb that an end of the way lies inside of is as thin as to have that end on its skin, so
/// neither a board's own segment nor its neighbour at the joint hides it where it looks outwards.
/// @param p_WU, p_WS  ends of the way: source and microphone [m]
/// @param wavelength  of the sound [m]
Shadow acoustic_shadow(const Eigen::Vector3d& p_WU, const Eigen::Vector3d& p_WS,
                       std::span<const Limb> limbs, double wavelength) noexcept;

}  // namespace secondskin::sim
