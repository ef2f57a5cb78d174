#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

/// Finds projectors whose values jump about (Second Skin, 2.2.4). One thread.
///
/// Each detector has a history of each projector's values. Where more than `jumps` of the steps in
/// it are larger than `jump`, the projector is not used for that detector; else the median around
/// the value is. Histories hold the values as they came.
///
/// The paper does not say what a missing value does: here it stays in the history but is no step.
/// The value after a gap is compared with the one before it, so a short occlusion costs a jump at
/// most, and where there is no value none is made up by the median.
namespace secondskin::server {

struct ValueFilterOptions {
  std::size_t history = 15;  ///< m, 1 to 255
  int jump = 6;              ///< n: a larger step is a jump [counts]
  int jumps = 3;             ///< p: a history with more of them is not used
  std::size_t median = 3;    ///< values, odd; 1 for none; not longer than the history
};

class ValueFilter {
 public:
  /// @throws std::invalid_argument naming the option that is out of range
  ValueFilter(std::size_t detectors, std::size_t projectors, const ValueFilterOptions& = {});

  /// Takes a cycle's values and gives those of delay_frames() cycles ago.
  /// @param values    detector-major, wire::kNoValue where there is none; detectors * projectors
  /// @param filtered  out: the same, wire::kNoValue where the projector is not to be used
  void update(std::span<const std::uint8_t> values, std::span<std::uint8_t> filtered) noexcept;

  /// Half the median's length: it looks as far ahead as back.
  std::size_t delay_frames() const noexcept { return options_.median / 2; }

 private:
  ValueFilterOptions options_;
  std::size_t pairs_;
  std::size_t newest_ = 0;               ///< where in every ring the newest value is
  std::vector<std::uint8_t> histories_;  ///< a ring of `history` values a pair
};

}  // namespace secondskin::server
