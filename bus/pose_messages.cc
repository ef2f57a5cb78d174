#include "bus/pose_messages.h"

#include <fmt/format.h>

#include <cmath>
#include <cstring>
#include <stdexcept>

namespace secondskin::bus {
namespace {

msg::Vector3 vector(const Eigen::Vector3d& v) {
  msg::Vector3 out;
  out.x(v.x());
  out.y(v.y());
  out.z(v.z());
  return out;
}

Eigen::Vector3d vector(const msg::Vector3& v) { return {v.x(), v.y(), v.z()}; }

}  // namespace

void to_message(const Skeleton& skeleton, std::string_view source, double rate_hz,
                msg::SkeletonDefinition& message) {
  message.skeleton_id(skeleton_id(skeleton));
  message.source(std::string(source.substr(0, 256)));
  message.rate_hz(rate_hz);
  message.joints().resize(skeleton.size());
  for (std::size_t i = 0; i < skeleton.size(); ++i) {
    const Segment& segment = skeleton[i];
    auto& joint = message.joints()[i];
    joint.name(segment.name);
    joint.parent(segment.parent ? static_cast<std::int32_t>(*segment.parent) : -1);
    joint.offset(vector(segment.p_PB));
    joint.end(vector(segment.p_BE));
    joint.mass_fraction(segment.mass_fraction);
    joint.mass_centre(vector(segment.p_BC));
  }
}

Skeleton to_skeleton(const msg::SkeletonDefinition& message) {
  std::vector<Segment> segments;
  segments.reserve(message.joints().size());
  for (const auto& joint : message.joints()) {
    Segment segment;
    segment.name = joint.name().to_string();
    if (joint.parent() >= 0) segment.parent = static_cast<std::size_t>(joint.parent());
    segment.p_PB = vector(joint.offset());
    segment.p_BE = vector(joint.end());
    segment.mass_fraction = joint.mass_fraction();
    segment.p_BC = vector(joint.mass_centre());
    segments.push_back(std::move(segment));
  }
  try {
    return Skeleton(std::move(segments));
  } catch (const std::invalid_argument& error) {
    throw std::runtime_error(fmt::format("topic skeleton: {}", error.what()));
  }
}

std::uint32_t skeleton_id(const Skeleton& skeleton) noexcept {
  std::uint32_t hash = 2166136261u;  // FNV-1a
  const auto mix = [&hash](const void* data, std::size_t size) {
    const auto* bytes = static_cast<const unsigned char*>(data);
    for (std::size_t i = 0; i < size; ++i) hash = (hash ^ bytes[i]) * 16777619u;
  };
  for (const auto& segment : skeleton.segments()) {
    mix(segment.name.data(), segment.name.size());
    mix(segment.p_PB.data(), 3 * sizeof(double));
  }
  return hash;
}

void to_message(const StampedPose& pose, std::uint32_t skeleton_id, msg::SkeletonPose& message) {
  message.header().frame(pose.frame);
  message.header().stamp_ns(pose.stamp_ns);
  message.skeleton_id(skeleton_id);
  message.root_position(vector(pose.pose.p_WR));
  const std::size_t n = pose.pose.q_PB.size();
  message.orientations().resize(n);
  message.confidences().resize(n);
  for (std::size_t i = 0; i < n; ++i) {
    const auto& q = pose.pose.q_PB[i];
    auto& out = message.orientations()[i];
    out.x(q.x());
    out.y(q.y());
    out.z(q.z());
    out.w(q.w());
    message.confidences()[i] = pose.pose.confidence[i];
  }
}

bool from_message(const msg::SkeletonPose& message, StampedPose& pose) {
  const std::size_t n = message.orientations().size();
  if (n == 0 || message.confidences().size() != n) return false;
  pose.frame = message.header().frame();
  pose.stamp_ns = message.header().stamp_ns();
  pose.pose.p_WR = vector(message.root_position());
  pose.pose.q_PB.resize(n);
  pose.pose.confidence.resize(n);
  for (std::size_t i = 0; i < n; ++i) {
    const auto& q = message.orientations()[i];
    pose.pose.q_PB[i] = Eigen::Quaterniond(q.w(), q.x(), q.y(), q.z());
    pose.pose.confidence[i] = message.confidences()[i];
  }
  return pose.pose.is_valid();
}

}  // namespace secondskin::bus
