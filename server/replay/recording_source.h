#pragma once

#include <filesystem>
#include <vector>

#include "server/pose_source.h"

namespace secondskin::server {

/// Replays the poses of a recording (.mcap) with their own frames and stamps, finished or not.
class RecordingSource final : public PoseSource {
 public:
  /// @throws std::runtime_error naming the file and what it lacks (no skeleton, no poses).
  explicit RecordingSource(const std::filesystem::path& file);

  const Skeleton& skeleton() const override { return skeleton_; }
  double rate_hz() const override { return rate_hz_; }
  Next next(StampedPose& pose) override;
  bool rewind() override;

 private:
  double rate_hz_ = 0.0;
  std::vector<StampedPose> poses_;  // a pose is about 1 kB: ten minutes at 62.5 Hz are 40 MB
  std::size_t next_ = 0;
  Skeleton skeleton_;  // last: reading it fills the others
};

}  // namespace secondskin::server
