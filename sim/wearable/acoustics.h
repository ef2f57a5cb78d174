#pragma once

#include <cmath>

/// How 40 kHz sound travels in air from a small piezoelectric transducer.
namespace secondskin::sim {

/// [m/s] at a temperature [deg C]: c = 331.3 sqrt(1 + T / 273.15).
inline double speed_of_sound(double celsius) noexcept {
  return 331.3 * std::sqrt(1.0 + celsius / 273.15);
}

/// Amplitude at an angle to the transducer's normal, 1 on it. A fit to the published patterns of
/// 10 mm and 16 mm 40 kHz transducers (Murata MA40S4S and alike): -6 dB at about 40 degrees, some
/// -22 dB sideways, a rest behind. @param cosine  of the angle
inline double directivity(double cosine) noexcept {
  constexpr double kRest = 0.06;
  const double x = 0.5 * (1.0 + cosine);
  return kRest + (1.0 - kRest) * x * x * x * x * x * x;
}

/// Absorption of 40 kHz at 20 deg C and 50 % humidity, ISO 9613-1 [dB/m].
inline constexpr double kAbsorption = 1.3;

/// Amplitude after a way, of what it is at 1 m without absorption. @param way [m]
inline double spread(double way) noexcept {
  return std::pow(10.0, -kAbsorption * way / 20.0) / way;
}

}  // namespace secondskin::sim
