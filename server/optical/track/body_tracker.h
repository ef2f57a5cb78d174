#pragma once

#include <optional>
#include <span>
#include <vector>

#include "server/optical/track/detector_tracker.h"
#include "server/optical/track/segment_filter.h"

/// From projector values to points without delay, for detectors that sit on the segments of a body:
/// the values of a segment's detectors go into one filter, straight from the slots. So a detector
/// that sees one projector is still known, and six detectors tell what one cannot.
///
/// A detector is tracked by itself (DetectorTracker) until it is confirmed, then placed on its
/// segment; three of them begin a segment. One whose values do not fit its place any more is
/// tracked by itself again. docs/optical-tracking.md has the equations and the figures.
namespace secondskin::server {

struct BodyTrackerOptions {
  TrackerOptions
      detector;  ///< its noise, visible_sigma, lost_sigma, slot_times hold for segments too
  SegmentMotion calm{{10.0, 0.15}, {50.0, 0.15}};
  SegmentMotion brisk{{200.0, 0.15}, {2000.0, 0.15}};
  double stay = 0.95;  ///< probability that a calm or brisk segment is so a cycle later
  SegmentPrior prior{};
};

/// One thread.
class BodyTracker {
 public:
  /// @param segment_of  which segment each detector sits on, by any numbers: those with the same
  /// one
  ///                    move together (Suit::detectors[i].segment). Its size is the number of
  ///                    detectors.
  /// @throws std::invalid_argument as DetectorTracker
  BodyTracker(const ProjectorRig& rig, std::span<const std::size_t> segment_of,
              const BodyTrackerOptions& = {});

  /// As DetectorTracker::update().
  void update(const ProjectorFrame& frame, MarkerFrame& out) noexcept;

  /// Whether a detector is on its segment now. One that seldom is may sit on another, or its input
  /// be swapped with another's.
  bool placed(std::size_t detector) const noexcept { return placed_[detector] != 0; }

  std::span<const ValueCounts> detector_counts() const noexcept {
    return singles_.detector_counts();
  }
  std::span<const ProjectorCounts> projector_fits() const noexcept {
    return singles_.projector_fits();
  }

 private:
  struct Member {
    std::size_t detector;
    int used = 0, gated = 0;  ///< values of the last cycle
    Strain strain;
    // While it is not placed: where on the limb it was first seen, and for how many cycles.
    Eigen::Vector3d p_BD = Eigen::Vector3d::Zero();
    double sigma = 0.0;  ///< of that [m]
    int kept = 0;
    int proof = 0;  ///< how many cycles it has to
  };
  struct Segment {
    SegmentFilter calm, brisk;  ///< at the middle of the last cycle
    double calm_share = 0.5;
    std::vector<Member> members;
    Strain strain;
    int age = 0;  ///< cycles since it began
  };

  void mix_and_predict(Segment& segment) const noexcept;
  bool filter(Segment& segment, const ProjectorFrame& frame) noexcept;
  void give(Segment& segment, MarkerFrame& out) const noexcept;
  static void reset(Segment& segment) noexcept;
  static bool on_trial(const Segment& segment) noexcept;
  void begin(Segment& segment) const noexcept;
  void place(Segment& segment) const noexcept;
  std::optional<MovingPoint> well_known(std::size_t detector) const noexcept;

  ProjectorRig rig_;
  BodyTrackerOptions options_;
  double cycle_time_;          ///< [s]
  std::vector<double> leads_;  ///< of each projector's value, from the middle of the cycle [s]
  DetectorTracker singles_;    ///< has the gate of all values
  std::vector<Segment> segments_;
  std::vector<std::uint8_t> placed_;  ///< one a detector
  std::optional<std::uint64_t> cycle_;
};

}  // namespace secondskin::server
