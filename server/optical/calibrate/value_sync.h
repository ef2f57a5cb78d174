#pragma once

#include <cmath>
#include <cstdint>
#include <deque>
#include <limits>
#include <optional>
#include <vector>

#include "server/optical/projector_frame.h"

/// Brings the values of a cycle to one instant.
///
/// Each projector has its own slot (2.1.2), so a moving detector gives the sixteen values of a
/// cycle at sixteen places. For each detector and projector a parabola through seven neighbouring
/// cycles, in the values' own times, is read at the middle of the middle cycle. That takes the
/// slots out, throws wild values away, and leaves 0.6 of the noise of rounding.
namespace secondskin::server {

/// The values of all detectors at one instant.
struct SyncedFrame {
  std::uint64_t cycle = 0;
  std::int64_t stamp_ns = 0;  ///< the instant: the middle of the cycle
  std::size_t detectors = 0;
  std::size_t projectors = 0;
  std::vector<float> values;  ///< detector-major [counts]; NaN where there is none

  std::optional<double> value(std::size_t detector, std::size_t projector) const noexcept {
    const float v = values[detector * projectors + projector];
    return std::isnan(v) ? std::nullopt : std::optional<double>(v);
  }
};

/// Not for several threads at once.
class ValueSync {
 public:
  static constexpr std::size_t kReach = 3;  ///< cycles before and after the middle one

  ValueSync(std::size_t detectors, std::size_t projectors)
      : detectors_(detectors), projectors_(projectors) {}

  /// Takes the next frame. @return the frame kReach before it, once there are enough; nothing
  /// around a gap of more than two cycles. Frames that do not go forward in time are ignored.
  /// @throws std::invalid_argument when the frame has other detectors or projectors.
  std::optional<SyncedFrame> add(const ProjectorFrame& frame);

 private:
  std::size_t detectors_;
  std::size_t projectors_;
  std::deque<ProjectorFrame> frames_;
};

}  // namespace secondskin::server
