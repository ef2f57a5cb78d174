#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "motion/markers.h"
#include "server/optical/projector_frame.h"
#include "server/optical/track/moving_point.h"
#include "server/optical/track/plane_solver.h"
#include "server/optical/track/value_gate.h"

/// From projector values to points without delay: a Kalman filter a detector that takes each value
/// at the time of its slot (what Second Skin 5.1 asks for). It knows nothing of the body; where the
/// detectors' segments are known, BodyTracker is better. docs/optical-tracking.md has the equations
/// and the figures.
namespace secondskin::server {

struct TrackerOptions {
  ValueNoise noise{};
  Manoeuvre calm{10.0, 0.15};
  Manoeuvre brisk{200.0, 0.15};
  double stay = 0.98;                ///< probability that what is calm or brisk is so a cycle later
  double velocity_sigma = 1.0;       ///< of a detector that is first seen [m/s]
  double acceleration_sigma = 10.0;  ///< [m/s^2]
  double visible_sigma = 0.010;      ///< a point known worse is not given out [m]
  double lost_sigma = 0.04;          ///< a point known worse is searched for anew: a wild value
                                     ///< would pass so wide a gate [m]
  bool slot_times = true;  ///< off: all values as of the cycle's middle, to measure what that costs
};

/// One thread.
class DetectorTracker {
 public:
  /// @throws std::invalid_argument naming the option that is out of range or the projector that is
  ///         not finite
  DetectorTracker(const ProjectorRig& rig, std::size_t detectors, const TrackerOptions& = {});

  /// Takes a cycle and gives all points at its end, frame.stamp_ns + wire::cycle_ns(projectors).
  /// Cycles that were lost in between (frame.cycle) are predicted over; a frame of another size
  /// counts as lost; a cycle number that does not go forward begins anew.
  /// @param out  one marker a detector, resized where it is not. Visible: a value of this cycle was
  ///             used, most of them and of the recent ones agree with the track, and it is
  ///             confirmed and known to visible_sigma. residual: root of the trace of the point's
  ///             covariance [m].
  void update(const ProjectorFrame& frame, MarkerFrame& out) noexcept { update(frame, {}, out); }

  /// A detector that the last cycle agreed with and that is confirmed, at the cycle's end.
  std::optional<MovingPoint> confirmed(std::size_t detector) const noexcept;

  std::span<const ValueCounts> detector_counts() const noexcept { return gate_.detector_counts(); }
  std::span<const ProjectorCounts> projector_fits() const noexcept {
    return gate_.projector_fits();
  }

 private:
  friend class BodyTracker;

  struct Track {
    bool active = false;
    bool fresh = false;  ///< the last cycle agreed with it
    int agreed = 0;      ///< cycles since it began that agreed
    Strain strain;
    double calm_share = 0.5;
    MovingPoint calm, brisk;
  };
  struct CycleResult {
    int used = 0, gated = 0;
  };

  // For the detectors that have 0 in `skip`; the others' tracks are forgotten and their markers
  // left alone.
  void update(const ProjectorFrame& frame, std::span<const std::uint8_t> skip,
              MarkerFrame& out) noexcept;
  void update(Track& track, std::size_t detector, const ProjectorFrame& frame) noexcept;
  void mix(Track& track) const noexcept;
  void coast(Track& track, double dt) const noexcept;
  CycleResult filter(Track& track, std::size_t detector, const ProjectorFrame& frame,
                     std::span<const std::uint8_t> take) noexcept;
  bool begin(Track& track, std::size_t detector, const ProjectorFrame& frame) noexcept;
  bool before_projectors(const Eigen::Vector3d& p_W,
                         std::span<const std::uint8_t> take) const noexcept;
  void give(const Track& track, std::size_t detector, MarkerFrame& out) const noexcept;

  ProjectorRig rig_;
  TrackerOptions options_;
  double cycle_time_;          ///< [s]
  std::vector<double> times_;  ///< of each projector's value, from the beginning of the cycle [s]
  ValueGate gate_;
  std::vector<Track> tracks_;
  std::optional<std::uint64_t> cycle_;  ///< the last one
  // Working space of a detector, one a projector.
  std::vector<Plane> planes_;
  std::vector<std::size_t> slots_;
  std::vector<std::uint8_t> used_planes_, take_;
};

}  // namespace secondskin::server
