#pragma once

#include <functional>
#include <memory>

#include "motion/suit.h"
#include "server/markers/body_fit.h"
#include "server/optical/optical_receiver.h"
#include "server/optical/track/body_tracker.h"
#include "server/pose_source.h"

/// The optical system as a source of poses: bytes of tags, values of projectors, points of
/// detectors, a body (Second Skin, chapters 2 and 3). One thread.
namespace secondskin::server {

class OpticalSource final : public PoseSource {
 public:
  /// Called with the source after each frame and each silence, on the thread of next().
  using Observer = std::function<void(const OpticalSource&, Next)>;

  /// @param rig   the projectors' calibration
  /// @param suit  what the tags' detectors are
  /// @param body  the wearer's: its markers are the suit's detectors in order
  /// @throws std::runtime_error when calibration, body and stream do not belong together
  OpticalSource(std::unique_ptr<OpticalReceiver> receiver, const ProjectorRig& rig,
                const Suit& suit, const MarkerBody& body);

  void observe(Observer observer) { observer_ = std::move(observer); }

  const Skeleton& skeleton() const override { return skeleton_; }
  double rate_hz() const override;
  /// Stamped with the end of its cycle. Begins with the first frame that shows the body; from then
  /// on every frame gives a pose, whose confidences tell how well it is known.
  Next next(StampedPose& pose) override;
  bool rewind() override { return false; }
  bool live() const override { return receiver_->live(); }

  // What the observer may want to see.
  const std::vector<std::string>& names() const noexcept { return names_; }
  const OpticalReceiver& receiver() const noexcept { return *receiver_; }
  const BodyTracker& tracker() const noexcept { return tracker_; }
  const ProjectorFrame& values() const noexcept { return values_; }
  const MarkerFrame& points() const noexcept { return points_; }
  std::int64_t stamp_ns() const noexcept { return stamp_ns_; }  ///< of points and pose

 private:
  std::unique_ptr<OpticalReceiver> receiver_;
  std::vector<std::string> names_;
  Skeleton skeleton_;
  BodyTracker tracker_;
  BodyFit fit_;
  Observer observer_;
  ProjectorFrame values_;
  MarkerFrame points_;
  std::int64_t stamp_ns_ = 0;
  std::optional<std::uint64_t> last_cycle_;
  bool started_ = false;
};

/// Which detectors move together: those of one segment.
std::vector<std::size_t> segments_of(const Suit& suit);

}  // namespace secondskin::server
