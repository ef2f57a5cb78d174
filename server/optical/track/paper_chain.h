#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "motion/markers.h"
#include "server/optical/projector_frame.h"
#include "server/optical/track/plane_solver.h"
#include "server/optical/track/point_smoother.h"
#include "server/optical/track/value_filter.h"

/// From projector values to points as Second Skin does it, 2.2.3 to 2.2.6. Any stage can be
/// switched off.
namespace secondskin::server {

struct PaperChainOptions {
  std::optional<ValueFilterOptions> value_filter = ValueFilterOptions{};  ///< 2.2.4
  bool row_removal = true;                                                ///< 2.2.5
  double variance_limit = kPaperVarianceLimit;  ///< sum of squares [counts^2]
  std::optional<PointSmootherOptions> smoother = PointSmootherOptions{};  ///< 2.2.6
};

/// One thread.
class PaperChain {
 public:
  /// @throws std::invalid_argument naming the option that is out of range
  PaperChain(const ProjectorRig& rig, std::size_t detectors, const PaperChainOptions& = {});

  /// Takes a cycle and gives the points of delay_frames() cycles before it. Cycles that were lost
  /// in between (frame.cycle) count as cycles without values; a frame of another size does, too; a
  /// cycle number that does not go forward begins anew.
  /// @param out  one marker a detector, resized where it is not; residual is PlanePoint::sigma. No
  ///             place in time within the cycle is better than another: the paper takes a cycle's
  ///             values as simultaneous. On average they are of its middle.
  void update(const ProjectorFrame& frame, MarkerFrame& out) noexcept;

  /// Cycles of future data that a point waits for: 4 with all stages, the paper's 64 ms at 62.5 Hz.
  std::size_t delay_frames() const noexcept;

 private:
  void step(std::span<const std::uint8_t> values, std::int64_t stamp_ns, MarkerFrame& out) noexcept;

  ProjectorRig rig_;
  std::size_t detectors_;
  PaperChainOptions options_;
  std::optional<ValueFilter> filter_;
  std::vector<PointSmoother> smoothers_;  ///< one a detector, or none
  std::vector<float> sigmas_;  ///< a ring of what waits for the smoothers; detector-major
  std::size_t newest_ = 0;
  std::size_t memory_;                  ///< cycles after which nothing is left of a value
  std::optional<std::uint64_t> cycle_;  ///< the last one
  std::vector<std::uint8_t> no_values_, filtered_, used_;
  std::vector<Plane> planes_;
};

}  // namespace secondskin::server
