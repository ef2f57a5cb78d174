#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace secondskin::server {

/// What all detectors read in one cycle of the projectors, of all tags together.
struct ProjectorFrame {
  std::uint64_t cycle = 0;    ///< counts the projectors' cycles, without a gap where sets were lost
  std::int64_t stamp_ns = 0;  ///< when the cycle began; value p was measured wire::value_time_ns(p)
                              ///< later
  std::size_t detectors = 0;
  std::size_t projectors = 0;
  std::vector<std::uint8_t>
      values;  ///< detector-major, 1 to 254; wire::kNoValue where there is none

  ProjectorFrame() = default;
  ProjectorFrame(std::size_t detectors_, std::size_t projectors_)
      : detectors(detectors_), projectors(projectors_), values(detectors_ * projectors_, 0) {}

  std::uint8_t value(std::size_t detector, std::size_t projector) const noexcept {
    return values[detector * projectors + projector];
  }
};

}  // namespace secondskin::server
