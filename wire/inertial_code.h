#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

/// The digital stream of a sensor board: six inertial values a sample as 93 chips (Practical Motion
/// Capture, 3.3 and 4.2: 13 kbit/s at 140 Hz). The layout that encoder and decoder share.
///
/// A sample's message has 48 bits: six 6-bit values (gyroscope x, y, z, accelerometer x, y, z), a
/// 4-bit counter, a CRC-8 of both. It is cut into three 16-bit words, each a BCH(31,16) word that
/// survives three wrong bits. Chip k of a sample is bit k / 3 of word k % 3 (so a burst of nine
/// chips costs a word three bits), XORed with chip k of a pseudo-random sequence. The sequence
/// begins anew with each sample: it is the pattern to lock onto, and keeps the baseline level.
/// Chip k begins k / 93 of a period after the sample, 1000 / 93 A/D samples apart at 140 kHz.
namespace secondskin::wire {

inline constexpr std::size_t kInertialChannels = 6;  ///< gyroscope x, y, z, accelerometer x, y, z
inline constexpr int kValueBits = 6;
inline constexpr int kValueCodes = 1 << kValueBits;
inline constexpr int kCounterBits = 4;
inline constexpr int kCounterCodes = 1 << kCounterBits;
inline constexpr std::size_t kWords = 3;
inline constexpr std::size_t kWordBits = 31;               ///< of a BCH word
inline constexpr std::size_t kMessageBits = 16;            ///< of them that say something
inline constexpr int kCorrectable = 3;                     ///< wrong bits a word
inline constexpr std::size_t kChips = kWords * kWordBits;  ///< 93 a sample
inline constexpr int kReadings = 4;  ///< 10-bit readings that make a 12-bit value

/// What one sample says.
struct InertialCode {
  std::array<std::uint8_t, kInertialChannels> values{};  ///< 0 to 63; 32 is the middle of the range
  std::uint8_t counter = 0;                              ///< of samples, modulo 16

  friend bool operator==(const InertialCode&, const InertialCode&) = default;
};

using Chips = std::array<std::uint8_t, kChips>;  ///< 0 or 1, in the order of sending

/// BCH(31,16), minimum distance 7: the message's bits x^15, then the remainder of its division by
/// x^15 + x^11 + x^10 + x^9 + x^8 + x^7 + x^5 + x^3 + x^2 + x + 1 (107657 octal). Bit 30 first.
std::uint32_t bch_encode(std::uint16_t message) noexcept;
/// Remainder of a received word; 0 for a code word.
std::uint16_t bch_syndrome(std::uint32_t word) noexcept;

/// CRC-8 (x^8 + x^2 + x + 1, all ones before) of values and counter.
std::uint8_t inertial_crc(const InertialCode& code) noexcept;

/// The three 16-bit words of a sample, and back. @returns false when the CRC does not fit
std::array<std::uint16_t, kWords> pack(const InertialCode& code) noexcept;
[[nodiscard]] bool unpack(const std::array<std::uint16_t, kWords>& words,
                          InertialCode& code) noexcept;

/// Chip k of the pseudo-random sequence: 93 bits of the maximal sequence of x^7 + x^6 + 1.
const Chips& scrambling() noexcept;

/// All of it: pack, protect, interleave, scramble.
Chips encode_chips(const InertialCode& code) noexcept;

/// 12-bit values to 6-bit codes, the rounding error carried into the next value (4.2): the sum of
/// all codes is that of all values to half a step. A value beyond the range is held at the end of
/// the range, and no more than half a step of it is carried (else it would wind up).
class DeltaModulator {
 public:
  /// @param value  0 to 4095, the sum of four 10-bit readings
  std::uint8_t operator()(int value) noexcept;

 private:
  int carry_ = 0;  ///< [12-bit counts], at most half a step
};

/// What the 6-bit code adds to a value x_k. The code gives x_k + e_k - e_(k-1), where e_k is even
/// within half a step: its spectrum rises from nothing at 0 Hz, 4 (step^2/12) sin^2(pi f T).
struct InertialCodeNoise {
  double step = 0.0;    ///< of a 6-bit value [the range's unit]
  double sample = 0.0;  ///< standard deviation of one value: step sqrt(2/12)
  double integral =
      0.0;              ///< of the sum of all values up to now times T: T step / sqrt(12), bounded
  double period = 0.0;  ///< T [s]

  /// Standard deviation of white noise that has the same power below a frequency:
  /// sqrt(2 step^2/12 (1 - sin(2 pi f T) / (2 pi f T))). With f half the sampling rate it is
  /// `sample`; a filter that follows motion up to some 10 Hz sees far less.
  double white(double up_to_hz) const noexcept;
};

/// @param range  the largest value of either sign that the sensor can tell; rate_hz of the samples
InertialCodeNoise inertial_code_noise(double range, double rate_hz = 140.0) noexcept;

}  // namespace secondskin::wire
