#pragma once

#include <cmath>
#include <cstdint>
#include <limits>
#include <optional>

/// VAX F_floating, as DEC machines stored single precision: sign, eight bits of exponent (excess
/// 128), 23 bits of a fraction whose leading 1 is hidden and stands behind the point:
/// (−1)^s · 0.1fff… · 2^(e − 128). e = 0 is zero, or with the sign set the reserved operand, which
/// no machine computes with. In memory it is two little-endian 16-bit words, the one with sign and
/// exponent first; here it is one number with that word on top.
namespace secondskin {

inline constexpr std::uint32_t kVaxReserved = 0x80000000U;

/// The value of a VAX F_floating; the reserved operand is NaN. Below 2^-126 a float holds fewer
/// bits than a VAX did, and rounds.
inline float float_from_vax(std::uint32_t vax) noexcept {
  const int exponent = static_cast<int>((vax >> 23) & 0xFFU);
  const bool negative = (vax >> 31) != 0;
  if (exponent == 0) return negative ? std::numeric_limits<float>::quiet_NaN() : 0.0F;
  const auto fraction = static_cast<float>(0x800000U | (vax & 0x7FFFFFU));
  const float magnitude = std::ldexp(fraction, exponent - 128 - 24);
  return negative ? -magnitude : magnitude;
}

/// The VAX F_floating of a value: exact, but 0 below 2^-128 in magnitude; NaN becomes the reserved
/// operand. Empty where a VAX has no such number: from 2^127 in magnitude.
inline std::optional<std::uint32_t> vax_from_float(float value) noexcept {
  if (std::isnan(value)) return kVaxReserved;
  if (value == 0.0F) return 0U;
  if (std::isinf(value)) return std::nullopt;
  int exponent = 0;
  const float fraction = std::frexp(std::abs(value), &exponent);
  if (exponent > 127) return std::nullopt;
  if (exponent < -127) return 0U;
  const auto bits = static_cast<std::uint32_t>(std::ldexp(fraction, 24)) & 0x7FFFFFU;
  return (std::signbit(value) ? kVaxReserved : 0U) |
         (static_cast<std::uint32_t>(exponent + 128) << 23) | bits;
}

}  // namespace secondskin
