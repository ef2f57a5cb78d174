#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>

#include "motion/c3d.h"

/// What reader and writer of C3D share. Not installed.
namespace secondskin::c3d {

inline constexpr std::size_t kBlock = 512;  // sections begin at blocks, counted from 1
inline constexpr std::uint8_t kKey = 0x50;  // second byte of header and parameter section
inline constexpr std::size_t kLargestWord = 65535;
// Larger numbers are no lengths or angles in any unit, and would overflow further on.
inline constexpr double kLargestValue = 1e9;

/// Where POINT lists the points of a kind, and names and defaults for their unit.
struct KindParameters {
  C3dKind kind;
  std::string_view list;
  std::string_view units;
  std::string_view default_unit;
};
inline constexpr std::array<KindParameters, 6> kKinds{{
    {C3dKind::kAngle, "ANGLES", "ANGLE_UNITS", "deg"},
    {C3dKind::kForce, "FORCES", "FORCE_UNITS", "N"},
    {C3dKind::kMoment, "MOMENTS", "MOMENT_UNITS", "Nmm"},
    {C3dKind::kPower, "POWERS", "POWER_UNITS", "W"},
    {C3dKind::kScalar, "SCALARS", "SCALAR_UNITS", "mm"},
    {C3dKind::kReaction, "REACTIONS", "REACTION_UNITS", ""},
}};

/// Metres a unit of POINT:UNITS; 0 for an unknown one. None at all means millimetres.
double metres_per_unit(std::string_view unit) noexcept;

bool equals_ignoring_case(std::string_view a, std::string_view b) noexcept;

/// "NAME", then "NAME2", "NAME3", …: a list of more than 255 goes on in further parameters.
std::string continued(std::string_view name, std::size_t part);

}  // namespace secondskin::c3d
