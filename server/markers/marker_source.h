#pragma once

#include "server/markers/body_fit.h"
#include "server/pose_source.h"

/// Poses from a recording of labelled markers.
namespace secondskin::server {

class MarkerSource final : public PoseSource {
 public:
  /// Calibrates the wearer's body on the whole recording.
  /// @param standing  as calibrate_body
  /// @throws std::runtime_error as calibrate_body; std::invalid_argument for a rate that is not >
  /// 0.
  MarkerSource(MarkerMotion markers, const MarkerSet& set, const MarkerMotion* standing = nullptr);

  const Skeleton& skeleton() const override { return calibration_.body.skeleton; }
  double rate_hz() const override { return markers_.rate_hz; }
  Next next(StampedPose& pose) override;
  bool rewind() override;

  /// The recording itself.
  const MarkerMotion& markers() const noexcept { return markers_; }
  /// How the calibration went, marker by marker.
  const BodyCalibration& calibration() const noexcept { return calibration_; }

 private:
  MarkerMotion markers_;
  BodyCalibration calibration_;
  BodyFit fit_;
  std::size_t next_ = 0;
};

}  // namespace secondskin::server
