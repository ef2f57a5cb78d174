#include "clients/stream/mvn_streamer.h"

#include "motion/body_shape.h"

namespace secondskin::stream {
namespace {

constexpr std::int64_t kDescribeEvery = 1'000'000'000;  // [ns]

using Segments = std::array<TPoseSegment, kXsensSegmentCount>;

Segments segments_of(const Skeleton& body, const Pose& pose) noexcept {
  std::array<Eigen::Isometry3d, kJointCount> X_WB;
  std::array<TPoseSegment, kJointCount> joints;
  Segments segments;
  to_t_pose_segments(body, pose, X_WB, joints);
  to_xsens(joints, segments);
  return segments;
}

std::array<float, 3> floats(const Eigen::Vector3d& v) noexcept {
  return {static_cast<float>(v.x()), static_cast<float>(v.y()), static_cast<float>(v.z())};
}

// The T-pose with the soles on the ground.
std::vector<wire::MvnPlace> t_pose_places(const Skeleton& body) {
  Segments segments = segments_of(body, t_pose());
  const double toes = segments[kXsensSegmentOf[index(Joint::kLeftToes)]].p_WN.z();
  const Eigen::Vector3d lift(0.0, 0.0, ball_height(body, Joint::kLeftToes) - toes);
  std::vector<wire::MvnPlace> places;
  for (std::size_t i = 0; i < segments.size(); ++i) {
    places.push_back({kXsensSegmentNames[i], floats(segments[i].p_WN + lift)});
  }
  return places;
}

}  // namespace

void MvnStreamer::set_body(const Skeleton& body) {
  body_ = body;
  described_ns_ = 0;
}

std::vector<wire::Datagram> MvnStreamer::encode(const StampedPose& pose) {
  if (!body_) return {};
  if (!start_ns_ || pose.stamp_ns < *start_ns_) start_ns_ = pose.stamp_ns;
  wire::MvnHeader header;
  header.sample = static_cast<std::uint32_t>(pose.frame);
  header.time_ms = static_cast<std::uint32_t>((pose.stamp_ns - *start_ns_) / 1'000'000);

  const Segments from = segments_of(*body_, pose.pose);
  std::array<wire::MvnSegment, kXsensSegmentCount> segments;
  for (std::size_t i = 0; i < segments.size(); ++i) {
    const Eigen::Quaternionf q = from[i].q_WN.cast<float>();
    segments[i] = {
        static_cast<std::uint32_t>(i + 1), floats(from[i].p_WN), {q.w(), q.x(), q.y(), q.z()}};
  }
  std::vector<wire::Datagram> datagrams{wire::encode_mvn_pose(header, segments)};
  if (pose.stamp_ns - described_ns_ >= kDescribeEvery) {
    described_ns_ = pose.stamp_ns;
    datagrams.push_back(wire::encode_mvn_meta_data(header, name_));
    datagrams.push_back(wire::encode_mvn_scale(header, t_pose_places(*body_)));
  }
  return datagrams;
}

}  // namespace secondskin::stream
