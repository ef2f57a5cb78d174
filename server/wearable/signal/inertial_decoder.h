#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "wire/inertial_code.h"

/// From the sampled signal of one sensor board to its inertial values (Practical Motion Capture,
/// 4.2): low-pass, lock by the scrambling sequence, threshold, descramble, correct errors.
///
/// Positions are A/D samples since the first one fed. One board, one thread.
namespace secondskin::server {

/// One sample that was received whole.
struct InertialSample {
  double start = 0.0;       ///< when it was measured: where its first chip begins [A/D samples]
  wire::InertialCode code;  ///< its values
  int corrected = 0;        ///< wrong chips that were put right, 0 to 9
};

/// What a decoder met, from the beginning.
struct InertialCounts {
  std::uint64_t samples = 0;    ///< given out
  std::uint64_t lost = 0;       ///< not given out: too many wrong chips, or no lock
  std::uint64_t corrected = 0;  ///< chips, of the samples that were given out
  std::uint64_t locks = 0;      ///< times that the lock was found; one less is the relocks
};

/// Corrects and checks the 93 chips of one sample. @param corrected out: chips that were wrong
/// @return empty when a word has more than three wrong bits, or the CRC does not fit.
std::optional<wire::InertialCode> decode_chips(const wire::Chips& chips, int& corrected) noexcept;

class InertialDecoder {
 public:
  /// So many samples in a row that cannot be read end the lock (0.11 s).
  static constexpr int kLoseAfter = 16;
  /// A board's clock may be so far off [share].
  static constexpr double kClockError = 1e-3;

  /// @param period   of the inertial samples [A/D samples]
  /// @param at_once  the most that is fed at once [A/D samples]
  /// @throws std::invalid_argument for a period of fewer than four A/D samples a chip
  InertialDecoder(double period, std::size_t at_once);

  /// Takes the next A/D samples. @return the inertial samples that they complete, in order; valid
  /// until the next call. No allocation. @pre signal.size() <= at_once
  std::span<const InertialSample> feed(std::span<const std::int16_t> signal) noexcept;

  /// Forgets the signal and the lock; positions count from 0 again. The counts go on.
  void restart() noexcept;

  bool locked() const noexcept { return state_ == State::kLocked; }
  double level() const noexcept { return level_; }  ///< of the chips, 0 before a lock [A/D counts]
  /// How far chips are from their level, RMS [A/D counts]: after the low-pass, as thresholding
  /// sees them.
  double noise() const noexcept { return noise_; }
  const InertialCounts& counts() const noexcept { return counts_; }

 private:
  enum class State { kSearching, kConfirming, kLocked };

  float filtered(std::int64_t position) const noexcept;
  void read_chips(double start, std::size_t count, float* soft) const noexcept;
  bool search() noexcept;
  void track(const wire::Chips& sent, double start) noexcept;
  void give(const InertialSample& sample) noexcept;
  void read_sample() noexcept;

  double nominal_;
  std::vector<float> buffer_;  ///< the last A/D samples
  std::size_t filled_ = 0;     ///< of it
  std::int64_t begin_ = 0;     ///< position of buffer_[0]
  State state_ = State::kSearching;
  double period_;       ///< as tracked
  double start_ = 0.0;  ///< of the sample to be read next
  int counter_ = 0;     ///< that it should have
  int failures_ = 0;    ///< in a row
  double baseline_ = 0.0, level_ = 0.0, noise_ = 0.0;
  InertialCounts counts_;
  InertialSample found_;  ///< the search's, given out once the next one confirms it
  std::vector<InertialSample> out_;
  std::array<float, 2 * wire::kChips> soft_{};  ///< the sample's chips, before thresholding
};

}  // namespace secondskin::server
