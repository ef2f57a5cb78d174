#pragma once

#include <array>
#include <cstdint>
#include <random>

#include "wire/inertial_code.h"

/// The micro-controller of a virtual sensor board: inertial values to the levels of its digital
/// stream (Practical Motion Capture, 3.3). One board, one thread.
///
///   for (each A/D sample n) {
///     if (encoder.due()) encoder.take(values at the time of n);
///     signal[n] += amplitude * encoder.next();
///   }
namespace secondskin::sim {

class InertialEncoder {
 public:
  /// Gyroscope x, y, z, accelerometer x, y, z as shares of their ranges: 0 the middle, +-1 the
  /// ends.
  using Values = std::array<double, wire::kInertialChannels>;

  /// Noise of the board's 10-bit converter [its counts]; without any, four readings would say no
  /// more than one.
  static constexpr double kConverterNoise = 0.5;

  /// @param period  of the inertial samples [A/D samples]: 1000, or a little off for a board whose
  ///                clock is
  /// @param start   first sample's first chip, counted from the first call of next() [A/D samples];
  ///                until then the level is 0
  InertialEncoder(double period, double start, std::uint64_t seed);

  /// Whether the next A/D sample is the first of a new inertial sample, so that take() is due.
  bool due() const noexcept { return static_cast<double>(n_) >= next_start_; }

  /// Reads the sensors and begins to send: four 10-bit readings a channel, added to 12 bits, turned
  /// into 6 bits with the rounding error carried on. Values beyond the range are held at its ends.
  void take(const Values& values) noexcept;

  /// The stream's level at the next A/D sample: -1, +1, or 0 before the first take().
  float next() noexcept {
    const double at = static_cast<double>(n_++) - start_;
    const auto chip = static_cast<std::size_t>(at * chips_per_sample_);
    return sending_ && chip < wire::kChips ? (chips_[chip] != 0 ? 1.0F : -1.0F) : 0.0F;
  }

  /// Goes on with other A/D samples' numbering lost: as next() so many times, for a silent board.
  void skip(std::int64_t samples) noexcept { n_ += samples; }

  /// What was sent last, for tests.
  const wire::InertialCode& sent() const noexcept { return code_; }

 private:
  double period_;
  double chips_per_sample_;
  double start_ = 0.0;  ///< of the sample that is being sent
  double next_start_;   ///< of the one after it
  std::int64_t n_ = 0;  ///< the next A/D sample
  bool sending_ = false;
  wire::InertialCode code_;
  wire::Chips chips_{};
  std::array<wire::DeltaModulator, wire::kInertialChannels> modulators_;
  std::uint8_t counter_ = 0;
  std::minstd_rand random_;
};

}  // namespace secondskin::sim
