#include "server/replay/recording_source.h"

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <optional>
#include <stdexcept>

#include "bus/pose_messages.h"
#include "bus/topics.h"
#include "motion/anatomy.h"
#include "recording/mcap_reader.h"

namespace secondskin::server {
namespace {

namespace msg = bus::msg;

Skeleton first_skeleton(recording::McapReader& reader, const std::filesystem::path& file,
                        std::uint16_t channel, double& rate_hz) {
  std::optional<Skeleton> skeleton;
  reader.for_each([&](const recording::McapMessage& message) {
    msg::SkeletonDefinition definition;
    if (message.channel != channel || !bus::decode(message.data, definition)) return true;
    skeleton = bus::to_skeleton(definition);
    rate_hz = definition.rate_hz();
    return false;
  });
  if (!skeleton) {
    throw std::runtime_error(fmt::format("{}: holds no readable skeleton", file.string()));
  }
  if (!is_canonical(*skeleton)) {
    throw std::runtime_error(
        fmt::format("{}: its skeleton does not have the canonical joints", file.string()));
  }
  return *skeleton;
}

Skeleton read(const std::filesystem::path& file, double& rate_hz, std::vector<StampedPose>& poses) {
  recording::McapReader reader(file);
  const auto skeleton_channel = reader.find("/skeleton");
  const auto pose_channel = reader.find("/pose");
  if (!skeleton_channel || !pose_channel) {
    throw std::runtime_error(
        fmt::format("{}: has no topic '{}'; expected a recording with both "
                    "skeleton and pose",
                    file.string(), skeleton_channel ? "pose" : "skeleton"));
  }
  Skeleton skeleton = first_skeleton(reader, file, skeleton_channel->id, rate_hz);
  const std::uint32_t id = bus::skeleton_id(skeleton);
  msg::SkeletonPose message;
  std::uint64_t refused = 0, other_body = 0;
  reader.for_each([&](const recording::McapMessage& raw) {
    if (raw.channel != pose_channel->id) return true;
    StampedPose pose;
    if (!bus::decode(raw.data, message)) {
      ++refused;
    } else if (message.skeleton_id() != id) {
      ++other_body;
    } else {
      // An invalid pose stays in: whoever consumed the stream met it too.
      (void)bus::from_message(message, pose);
      if (pose.pose.q_PB.size() == skeleton.size()) poses.push_back(std::move(pose));
    }
    return true;
  });
  if (refused > 0) spdlog::warn("{}: {} pose messages are unreadable", file.string(), refused);
  if (other_body > 0) {
    spdlog::warn("{}: {} poses are of another body than the first and left out", file.string(),
                 other_body);
  }
  for (const auto& damage : reader.damage()) spdlog::warn("{}: {}", file.string(), damage);
  if (poses.empty()) throw std::runtime_error(fmt::format("{}: holds no poses", file.string()));
  return skeleton;
}

}  // namespace

RecordingSource::RecordingSource(const std::filesystem::path& file)
    : skeleton_(read(file, rate_hz_, poses_)) {}

Next RecordingSource::next(StampedPose& pose) {
  if (next_ >= poses_.size()) return Next::kEnd;
  pose = poses_[next_++];
  return Next::kPose;
}

bool RecordingSource::rewind() {
  next_ = 0;
  return true;
}

}  // namespace secondskin::server
