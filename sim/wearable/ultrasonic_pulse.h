#pragma once

#include <complex>
#include <span>
#include <vector>

/// What a microphone's wire shows of one transducer's pulse at close range.
///
/// The drive is ten cycles of the carrier. The transducer is two coupled resonances (mechanical and
/// of the drive circuit), the board's amplifier another one: three poles in complex baseband,
/// y' = -(pi B - 2 pi i detuning) y + pi B x. So the pulse swells for the time of its drive and
/// rings down for longer; its power rises fastest some 36 A/D samples after its beginning, 40 after
/// its slot's (section 4.1: "about 40 samples after the start of the pulse").
namespace secondskin::sim {

struct Transducer {
  double bandwidth = 2200.0;   ///< of its mechanical resonance [Hz]
  double circuit = 3000.0;     ///< bandwidth of its drive circuit [Hz]
  double detuning = 0.0;       ///< of the resonance from the carrier [Hz]
  double start_samples = 0.0;  ///< how late its drive begins after the slot does [A/D samples]
};

class UltrasonicPulse {
 public:
  static constexpr double kCycles = 10.0;
  static constexpr double kAmplifier = 4500.0;  ///< bandwidth of the board's amplifier [Hz]

  UltrasonicPulse(const Transducer& transducer, double carrier_hz, double sample_rate_hz);

  /// Adds the pulse to a signal. Its greatest amplitude is `amplitude`.
  /// @param start  where the pulse begins in the signal [samples]; what lies outside is left out
  /// @param pace   how fast it goes by, 1 without Doppler
  void add(double start, double amplitude, double pace, std::span<float> signal) const noexcept;

  /// Amplitude of the envelope after its beginning. @param samples >= 0
  double envelope(double samples) const noexcept;
  double length() const noexcept;  ///< until it has rung down to a thousandth [samples]

 private:
  static constexpr double kFine = 4.0;  ///< table entries a sample
  double turn_;                         ///< of the carrier a sample [rad]
  std::vector<std::complex<float>> table_;
};

}  // namespace secondskin::sim
