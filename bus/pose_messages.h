#pragma once

#include <cstdint>
#include <string_view>

#include "bus/messages.h"
#include "motion/skeleton.h"

/// Skeletons and poses to their messages and back: the one place that knows both.
namespace secondskin::bus {

void to_message(const Skeleton& skeleton, std::string_view source, double rate_hz,
                msg::SkeletonDefinition& message);

/// @throws std::runtime_error naming the joint that is wrong.
Skeleton to_skeleton(const msg::SkeletonDefinition& message);

/// A fingerprint of a skeleton's names and offsets: poses name the body they are of by it.
std::uint32_t skeleton_id(const Skeleton& skeleton) noexcept;

/// publish_ns is left to whoever publishes. No allocation once the message has held as many joints.
void to_message(const StampedPose& pose, std::uint32_t skeleton_id, msg::SkeletonPose& message);

/// No allocation once `pose` has held as many joints.
/// @returns false when the lists differ in length or a number is not finite; `pose` is then
/// unusable.
[[nodiscard]] bool from_message(const msg::SkeletonPose& message, StampedPose& pose);

}  // namespace secondskin::bus
