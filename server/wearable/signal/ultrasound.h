#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

/// From the sampled signal of one sensor board to the distances of its microphone (Practical Motion
/// Capture, 4.1): 40 kHz band-pass, power, envelope, inflection point, distance, confidence.
///
/// Positions are A/D samples since the beginning of the slot, which is when the pulse was sent.
/// docs/wearable-signals.md has the equations.
namespace secondskin::server {

/// Speed of sound in air, 331.3 sqrt(1 + T / 273.15) [m/s].
double speed_of_sound(double temperature_c) noexcept;

/// Where the sound of a pulse begins in a slot.
struct Arrival {
  double inflection = 0.0;  ///< steepest rise of the power before its first peak [A/D samples]
  double peak = 0.0;        ///< power there: the squared amplitude of the carrier [A/D counts^2]
  double noise = 0.0;       ///< mean power of the ambient noise, as estimated [A/D counts^2]
};

/// Finds arrivals in one board's signal. One thread.
class ArrivalFinder {
 public:
  /// The band-pass is 5 kHz wide at half power (4.1), and Gaussian: of all filters of that width it
  /// has the steepest edge that does not ring, so that nothing comes before the first arrival.
  static constexpr double kWidthHz = 5000.0;
  /// A peak must be so many times stronger than the ambient noise, whose power is exponentially
  /// distributed: noise alone exceeds it once in 10^7 slots.
  static constexpr double kWellAbove = 20.0;
  /// And not weaker than this share of the slot's loudest, both times their squared way: weaker
  /// ones before it are late echoes of the pulses before.
  static constexpr double kShareOfLoudest = 0.02;
  /// A peak ends where the power has fallen to this share of it; what rises again sooner is ripple.
  static constexpr double kFallen = 0.7;
  /// Ambient noise no lower than this is believed, so that a dead line is not a quiet room
  /// [A/D counts^2].
  static constexpr double kLeastNoise = 0.05;

  /// @throws std::invalid_argument unless the carrier fits the rate, and a slot the filter
  ArrivalFinder(double sample_rate_hz, double carrier_hz, std::size_t slot_samples);

  /// Takes the next slot. @param earliest  arrivals before it are passed over [A/D samples]
  /// @return the first arrival; empty when nothing is well above the noise. No allocation.
  /// @pre slot.size() is the slot's
  std::optional<Arrival> find(std::span<const std::int16_t> slot, double earliest = 0.0) noexcept;

  /// The signal has a gap before the next slot: nothing of it continues. The noise is kept.
  void forget() noexcept;

  double noise() const noexcept { return noise_; }  ///< as Arrival::noise; 0 before the first slot
  /// Power of the last slot's envelope, one value every kStep A/D samples, for who draws it.
  std::span<const float> envelope() const noexcept { return power_; }
  static constexpr std::size_t kStep = 4;  ///< A/D samples between two values of the envelope

 private:
  void estimate_noise() noexcept;
  std::optional<Arrival> rise_to(std::size_t peak) const noexcept;

  std::size_t half_;                  ///< of the filter: its delay [A/D samples]
  std::vector<float> cosine_, sine_;  ///< the band-pass in quadrature, padded to whole packets
  std::vector<float> signal_;         ///< the end of the last slot, then this one
  std::vector<float> power_, sorted_;
  double noise_ = 0.0;
};

/// What is known of a source.
struct SourceCalibration {
  double offset = 40.0;     ///< inflection less the time of flight, "about 40" [A/D samples] (4.1)
  double strength = 1.5e7;  ///< peak power times squared distance, facing it [A/D counts^2 m^2]
};

/// Turns arrivals of one source at one board into distances, and says how far to trust them.
class DistanceTracker {
 public:
  /// The signal is strong from this share of the source's calibrated strength on: w_s = 1. Below,
  /// w_s falls with the squared inverse of what is missing, to a half where kWeakness of the
  /// threshold is missing (4.1 gives no numbers; these are ours).
  static constexpr double kStrong = 0.1;
  static constexpr double kWeakness = 0.3;
  /// The peak of the source's pulse before may be so far away, by how fast a hand moves: w_t = 1.
  /// It falls to 0 at kJumpSpeed. [m/s]
  static constexpr double kSteadySpeed = 3.0;
  static constexpr double kJumpSpeed = 9.0;
  /// Without a neighbour in this time w_t cannot be told, and is kUnknownContinuity. [s]
  static constexpr double kNeighbour = 0.25;
  static constexpr double kUnknownContinuity = 0.5;

  struct Result {
    double distance = 0.0;  ///< [m]
    double w_s = 0.0;       ///< signal strength
    double w_t = 0.0;       ///< temporal continuity
  };

  /// @param time  of the pulse [s]
  Result add(const Arrival& arrival, double time, const SourceCalibration& source,
             double metres_per_sample) noexcept;

 private:
  double last_distance_ = 0.0, last_time_ = 0.0;
  bool has_last_ = false;
};

/// w_s of 4.1 for a peak power times squared distance, as a share of the source's strength.
double signal_confidence(double share) noexcept;
/// w_t of 4.1 for how fast the distance would have changed [m/s].
double continuity_confidence(double speed) noexcept;

}  // namespace secondskin::server
