#include "server/markers/marker_source.h"

#include <fmt/format.h>

#include <cmath>
#include <stdexcept>

namespace secondskin::server {
namespace {

BodyCalibration calibrated(const MarkerMotion& markers, const MarkerSet& set,
                           const MarkerMotion* standing) {
  if (!(std::isfinite(markers.rate_hz) && markers.rate_hz > 0.0)) {
    throw std::invalid_argument(
        fmt::format("markers at {} frames a second; expected more than 0", markers.rate_hz));
  }
  return calibrate_body(set, markers, standing);
}

}  // namespace

MarkerSource::MarkerSource(MarkerMotion markers, const MarkerSet& set, const MarkerMotion* standing)
    : markers_(std::move(markers)),
      calibration_(calibrated(markers_, set, standing)),
      fit_(calibration_.body) {}

Next MarkerSource::next(StampedPose& pose) {
  if (next_ >= markers_.frames.size()) return Next::kEnd;
  pose.frame = next_;
  pose.stamp_ns = std::llround(1e9 * static_cast<double>(next_) / markers_.rate_hz);
  (void)fit_.update(markers_.frames[next_], 1.0 / markers_.rate_hz, pose.pose);
  ++next_;
  return Next::kPose;
}

bool MarkerSource::rewind() {
  next_ = 0;
  fit_.reset();
  return true;
}

}  // namespace secondskin::server
