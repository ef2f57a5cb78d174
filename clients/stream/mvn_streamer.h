#pragma once

#include <optional>
#include <string>

#include "clients/stream/pose_encoder.h"
#include "motion/xsens_body.h"
#include "wire/mvn.h"

namespace secondskin::stream {

/// Poses as Xsens MVN's network streamer sends them: type 02 (positions in metres, z up), and once
/// a second who it is (type 12) and the body in the T-pose (type 13).
class MvnStreamer final : public PoseEncoder {
 public:
  /// @param name  of the avatar
  explicit MvnStreamer(std::string name) : name_(std::move(name)) {}

  void set_body(const Skeleton& body) override;
  /// The sample counter is the pose's frame, so what was left out shows.
  std::vector<wire::Datagram> encode(const StampedPose& pose) override;

 private:
  std::string name_;
  std::optional<Skeleton> body_;
  std::optional<std::int64_t> start_ns_;
  std::int64_t described_ns_ = 0;
};

}  // namespace secondskin::stream
