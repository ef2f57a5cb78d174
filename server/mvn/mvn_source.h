#pragma once

#include <vector>

#include "server/mvn/mvn_stream.h"
#include "server/pose_source.h"
#include "wire/udp.h"

namespace secondskin::server {

/// Xsens MVN's network streamer as a live source of poses. One thread.
class MvnSource final : public PoseSource {
 public:
  /// @throws std::system_error naming the place when it cannot be listened at
  MvnSource(const wire::UdpPlace& at, const RetargetOptions& options);

  /// An average body before the first pose, the avatar's with it and from then on.
  const Skeleton& skeleton() const override { return stream_.skeleton(); }
  bool knows_body() const override { return stream_.counts().poses > 0; }
  double rate_hz() const override { return stream_.rate_hz(); }
  Next next(StampedPose& pose) override;
  bool rewind() override { return false; }
  bool live() const override { return true; }
  std::string trouble() const override { return stream_.trouble(); }

  const wire::UdpPlace& place() const noexcept { return receiver_.place(); }
  const MvnStream& stream() const noexcept { return stream_; }

 private:
  wire::UdpReceiver receiver_;
  MvnStream stream_;
  std::vector<std::uint8_t> buffer_;
  bool said_others_ = false;
};

}  // namespace secondskin::server
