#pragma once

#include <array>

#include "sim/wearable/garment_scene.h"

/// The ways that a pulse takes from a source to a microphone: straight or around what is in
/// between, by the floor and the walls, by the limbs.
namespace secondskin::sim {

struct SoundPath {
  double delay = 0.0;      ///< from the emission of the pulse's beginning to its arrival [s]
  double amplitude = 0.0;  ///< of that at 1 m in the open on the source's normal
  double pace = 1.0;       ///< how fast the pulse goes by (Doppler)
};

inline constexpr std::size_t kMostPaths = 16;
using SoundPaths = std::array<SoundPath, kMostPaths>;

/// @param instant  when the pulse is sent; the microphone moves on until it arrives
/// @param c        speed of sound [m/s]
/// @param out      the direct way first
/// @returns how many ways
std::size_t sound_paths(const GarmentInstant& instant, std::span<const Reflector> reflectors,
                        std::size_t source, std::size_t board, double c, double carrier_hz,
                        SoundPaths& out) noexcept;

}  // namespace secondskin::sim
