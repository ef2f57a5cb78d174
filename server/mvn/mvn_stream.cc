#include "server/mvn/mvn_stream.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <stdexcept>

namespace secondskin::server {
namespace {

constexpr std::uint32_t kWhole = (1U << kXsensSegmentCount) - 1;
// A datagram of one of so many last samples is late; of an older one, the sender began anew.
constexpr std::int32_t kReordered = 64;
constexpr std::int32_t kLongestGap = 10'000;        // samples; a longer jump is a new start
constexpr std::int64_t kAnewAfter = 1'000'000'000;  // of silence [ns]
constexpr std::int64_t kRateWindow = 500'000'000;   // that the rate is told from [ns]
constexpr double kClockError = 1e-4;                // of the sender's clock [share]
constexpr double kLongestThigh = 5.0;               // in metres; longer is centimetres

// MVN's y-up stream: x forward, y up, z to the right.
Eigen::Vector3d z_up(const Eigen::Vector3d& v) { return {v.x(), -v.z(), v.y()}; }

}  // namespace

bool MvnStream::add(std::span<const std::uint8_t> datagram, std::int64_t arrival_ns,
                    StampedPose& pose) {
  wire::MvnFault fault{};
  const auto header = wire::decode_mvn_header(datagram, fault);
  if (header && header->type_text() != wire::kMvnPose) {
    ++counts_.other_types;
    last_other_ = header->type;
    return false;
  }
  if (header) fault = wire::decode_mvn_pose(datagram, *header, decoded_);
  if (fault != wire::MvnFault::kNone) {
    ++counts_.garbled[static_cast<std::size_t>(fault)];
    last_fault_ = fault;
    return false;
  }
  if (!avatar_) avatar_ = header->avatar;
  if (*avatar_ != header->avatar) {
    ++counts_.other_avatars;
    return false;
  }
  if (!place(*header, arrival_ns)) return false;
  // What comes after a whole body are props and fingers.
  if (sample_.seen == kWhole) return false;
  for (const wire::MvnSegment& segment : decoded_) fill(segment);
  if (sample_.seen != kWhole || !begin()) return false;

  const std::uint32_t step = following_ ? sample_.number - last_number_ : 1;
  counts_.lost += step - 1;
  frame_ += step;
  last_number_ = sample_.number;
  following_ = true;
  const std::int64_t stamp_ns = stamp(sample_.time_ms, arrival_ns);
  if (!knows_rate(stamp_ns)) return false;
  ++counts_.poses;
  pose.frame = frame_;
  pose.stamp_ns = stamp_ns;
  if (pose.pose.q_PB.size() != kJointCount) pose.pose = Pose(kJointCount);
  std::fill(pose.pose.confidence.begin(), pose.pose.confidence.end(), 1.0F);
  from_xsens(sample_.segments, joints_);
  from_t_pose_segments(joints_, pose.pose);
  return true;
}

// Makes sample_ the one that the datagram belongs to. @returns false when it is too late.
bool MvnStream::place(const wire::MvnHeader& header, std::int64_t arrival_ns) {
  const bool silence = arrival_ns - last_arrival_ns_ > kAnewAfter;
  last_arrival_ns_ = arrival_ns;
  const auto step = static_cast<std::int32_t>(header.sample - sample_.number);
  const bool known = following_ || sample_.seen != 0;
  const bool anew = !known || silence || step < -kReordered || step > kLongestGap;
  if (!anew && step < 0) {
    ++counts_.late;
    return false;
  }
  if (!anew && step == 0) return true;
  if (sample_.seen != 0 && sample_.seen != kWhole) ++counts_.incomplete;
  if (anew) {
    following_ = false;
    last_time_ns_ = -1;
  }
  sample_.number = header.sample;
  sample_.time_ms = header.time_ms;
  sample_.seen = 0;
  return true;
}

void MvnStream::fill(const wire::MvnSegment& segment) noexcept {
  if (segment.id > kXsensSegmentCount) return;
  TPoseSegment& to = sample_.segments[segment.id - 1];
  Eigen::Vector3d p(segment.position[0], segment.position[1], segment.position[2]);
  Eigen::Vector3d v(segment.orientation[1], segment.orientation[2], segment.orientation[3]);
  if (options_.up == UpAxis::kY) {
    p = z_up(p);
    v = z_up(v);
  }
  to.p_WN = metres_per_unit_ * p;
  to.q_WN = Eigen::Quaterniond(segment.orientation[0], v.x(), v.y(), v.z()).normalized();
  sample_.seen |= 1U << (segment.id - 1);
}

// The first whole sample tells unit and body. @returns false while there is none that makes one.
bool MvnStream::begin() {
  if (has_body_) return true;
  const auto& hip = sample_.segments[kXsensSegmentOf[index(Joint::kRightHip)]];
  const auto& knee = sample_.segments[kXsensSegmentOf[index(Joint::kRightKnee)]];
  const bool centimetres = (knee.p_WN - hip.p_WN).norm() > kLongestThigh;
  const double unit = options_.metres_per_unit.value_or(centimetres ? 0.01 : 1.0);
  for (TPoseSegment& segment : sample_.segments) segment.p_WN *= unit;
  try {
    skeleton_ = xsens_skeleton(sample_.segments);
  } catch (const std::runtime_error& error) {
    bad_body_ = error.what();
    return false;
  }
  metres_per_unit_ = unit;
  has_body_ = true;
  return true;
}

std::int64_t MvnStream::stamp(std::uint32_t time_ms, std::int64_t arrival_ns) noexcept {
  const std::int64_t time_ns = std::int64_t{time_ms} * 1'000'000;
  if (last_time_ns_ < 0 || time_ns <= last_time_ns_) {
    origin_ns_ = arrival_ns - time_ns;  // a new start, or a sender without a clock
  } else {
    origin_ns_ +=
        static_cast<std::int64_t>(kClockError * static_cast<double>(time_ns - last_time_ns_));
    origin_ns_ = std::min(origin_ns_, arrival_ns - time_ns);
  }
  last_time_ns_ = time_ns;
  last_stamp_ns_ = std::max(last_stamp_ns_ + 1, origin_ns_ + time_ns);
  return last_stamp_ns_;
}

// Half a second of samples tells the rate; they are not given.
bool MvnStream::knows_rate(std::int64_t stamp_ns) noexcept {
  if (has_rate_) return true;
  if (rate_frame_ == 0) {
    rate_frame_ = frame_;
    rate_stamp_ns_ = stamp_ns;
  }
  if (stamp_ns - rate_stamp_ns_ < kRateWindow) return false;
  rate_hz_ = std::max(1.0, std::round(1e9 * static_cast<double>(frame_ - rate_frame_) /
                                      static_cast<double>(stamp_ns - rate_stamp_ns_)));
  has_rate_ = true;
  return true;
}

std::string MvnStream::trouble() const {
  if (!bad_body_.empty() && !has_body_) return fmt::format("MVN: {}", bad_body_);
  if (counts_.poses > 0) return {};
  if (counts_.other_types > 0 && !avatar_) {
    return fmt::format(
        "MVN datagrams of type {}{} come, none of type 02; switch on 'Position + Orientation "
        "(Quaternion)' in MVN's network streamer",
        last_other_[0], last_other_[1]);
  }
  if (counts_.all_garbled() > 0) {
    return fmt::format("{} datagrams come that are garbled: {}", counts_.all_garbled(),
                       wire::words(last_fault_));
  }
  if (counts_.incomplete > 0) return "MVN samples come without all of the body's 23 segments";
  return {};
}

}  // namespace secondskin::server
