#pragma once

#include <functional>
#include <memory>
#include <optional>
#include <vector>

#include "server/pose_source.h"
#include "server/wearable/estimate/body_filter.h"
#include "server/wearable/estimate/smoother.h"
#include "server/wearable/measurement.h"
#include "server/wearable/root/foot_contacts.h"
#include "server/wearable/start/initialise.h"

/// Wearable capture as a source of poses: measurements, start, filter, contacts (Practical Motion
/// Capture, sections 4 to 6). The same for a recording and a garment that is worn now. One thread.
namespace secondskin::server {

struct WearableOptions {
  /// While the root is not given, what accelerometers feel is shared out between it and the limbs:
  /// with less noise assumed, soft tissue turns limbs. How boards are mounted the start has told.
  WearableOptions() {
    filter.gyro_noise = 0.3;
    filter.accel_noise = 20.0;
    filter.distance_noise = 0.1;
    filter.rate_error = 0.3;
    filter.mount_sigma = 0.05;
  }

  StartSettings start;
  FilterSettings filter;
  ContactSettings contacts;
  bool use_contacts = true;
  /// Poses a second at most; every n-th inertial sample gives one. The filter uses all of them.
  double most_poses = 75.0;
  /// Recordings: filter all of it first, then give the smoothed poses (smoother.h).
  bool smooth = false;
  double magnetic = 0.25;  ///< of a magnetometer's direction among walls; 0: not used [rad]
};

class WearableSource final : public PoseSource {
 public:
  using Observer = std::function<void(const WearableSource&, Next)>;

  /// A recording is read until the start is found, and the wearer's bones are refined by it; of a
  /// live garment the bones are as measured, since the skeleton is told before anybody stands
  /// still.
  /// @throws std::runtime_error when a recording holds no start
  WearableSource(std::unique_ptr<MeasurementStream> stream, Garment garment,
                 WearableOptions options);

  void observe(Observer observer) { observer_ = std::move(observer); }

  const Skeleton& skeleton() const override { return skeleton_; }
  double rate_hz() const override;
  /// Begins with the first pose after the start. Stamped with the inertial sample's time.
  Next next(StampedPose& pose) override;
  bool rewind() override;
  bool live() const override { return stream_->live(); }

  // What the observer may want to see.
  const Garment& garment() const noexcept { return garment_; }
  const MeasurementStream& stream() const noexcept { return *stream_; }
  std::uint64_t frame() const noexcept { return frame_; }  ///< of the newest pose
  bool started() const noexcept { return filter_.has_value(); }
  const StartResult& start() const noexcept { return *start_; }         ///< @pre started()
  const BodyFilter& filter() const noexcept { return *filter_; }        ///< @pre started()
  const FootContacts& contacts() const noexcept { return *contacts_; }  ///< @pre started()

 private:
  [[nodiscard]] bool look_for_start(Next& next);
  void begin();
  void process(const Measurement& measurement);
  void use_magnetometers(const Measurement& measurement);
  void hold_root(std::int64_t stamp_ns);
  void smooth_all();
  [[nodiscard]] bool next_measurement(Next& next);
  [[nodiscard]] bool gives_pose(const Measurement& measurement, StampedPose& pose);

  std::unique_ptr<MeasurementStream> stream_;
  Garment garment_;
  WearableOptions options_;
  Skeleton skeleton_;
  Starter starter_;
  std::vector<Measurement> waiting_;  // felt since the rest, until the filter starts
  std::size_t waited_ = 0;
  std::optional<StartResult> start_;
  std::optional<BodyFilter> filter_;
  std::optional<FootContacts> contacts_;
  std::vector<StampedPose> smoothed_;
  std::size_t given_ = 0;
  bool is_smoothed_ = false;
  std::vector<std::optional<Eigen::Vector3d>> field_W_;  // a board's, at rest
  Measurement measurement_, reordered_;
  const Measurement* newest_ = nullptr;
  std::optional<std::int64_t> first_ns_;
  std::optional<std::size_t> root_board_;  // segment of the first board, where the pelvis has none
  std::int64_t magnetic_ns_ = 0, held_ns_ = 0;
  std::uint64_t every_ = 1, frame_ = 0;
  Observer observer_;
};

}  // namespace secondskin::server
