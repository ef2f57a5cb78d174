#include "server/capture_service.h"

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <chrono>
#include <condition_variable>
#include <memory>
#include <mutex>
#include <stdexcept>

#include "bus/health.h"
#include "bus/pose_messages.h"
#include "bus/sole_writer.h"
#include "bus/writer.h"

namespace secondskin::server {

namespace msg = bus::msg;
using Clock = std::chrono::steady_clock;
using namespace std::chrono_literals;

namespace {

constexpr auto kLongestWaitForReaders = 5s;

}  // namespace

struct CaptureService::State {
  State(bus::Participant& participant, PoseSource& source_, const CaptureOptions& options_)
      : source(source_),
        options(options_),
        poses(participant),
        sole(participant, "capture server"),
        skeletons(participant),
        health(participant, "capture") {}

  // @returns the id that its poses name
  std::uint32_t publish_skeleton() {
    msg::SkeletonDefinition definition;
    bus::to_message(source.skeleton(), options.source_name, source.rate_hz(), definition);
    definition.publish_ns(bus::now_ns());
    skeletons.write(definition);
    return definition.skeleton_id();
  }

  PoseSource& source;
  CaptureOptions options;
  bus::Writer<msg::SkeletonPose> poses;
  bus::SoleWriter<msg::SkeletonPose> sole;
  bus::Writer<msg::SkeletonDefinition> skeletons;
  bus::HealthReporter health;
  std::mutex mutex;
  std::condition_variable_any alarm;
};

CaptureService::CaptureService(bus::Participant& participant, PoseSource& source,
                               const CaptureOptions& options)
    : state_(std::make_unique<State>(participant, source, options)) {
  if (source.knows_body()) state_->publish_skeleton();
}

CaptureService::~CaptureService() = default;

CaptureCounts CaptureService::run(std::stop_token stop) {
  auto& s = *state_;
  CaptureCounts counts;
  std::unique_lock lock(s.mutex);
  const auto sleep_until = [&](Clock::time_point time) {
    s.alarm.wait_until(lock, stop, time, [] { return false; });
  };

  const bool live = s.source.live();

  s.health.state(msg::SERVICE_WAITING);
  if (s.options.wait_for_readers > 0) {
    // One of the readers is this service's own.
    s.poses.wait_for_readers(s.options.wait_for_readers + 1, kLongestWaitForReaders, stop);
  }

  const bool body_is_told = s.source.knows_body();
  std::uint32_t id = bus::skeleton_id(s.source.skeleton());
  const auto period = std::chrono::duration<double>(
      s.options.speed > 0.0 ? 1.0 / (s.source.rate_hz() * s.options.speed) : 0.0);
  s.health.state(msg::SERVICE_RUNNING);

  msg::SkeletonPose message;
  StampedPose pose;
  std::uint64_t frame = 0;
  std::uint64_t last_frame = 0;
  auto start = Clock::now();
  std::int64_t first_stamp_ns = 0;
  bool first = true;
  while (!stop.stop_requested()) {
    Next next = s.source.next(pose);
    if (next == Next::kSilence) {
      const std::string trouble = s.source.trouble();
      s.health.state(msg::SERVICE_WAITING,
                     trouble.empty() ? "no sample comes; is the device on and in reach?" : trouble);
      s.health.tick(bus::now_ns());
      continue;
    }
    if (next == Next::kEnd) {
      if (!s.options.loop || !s.source.rewind()) break;
      next = s.source.next(pose);
      if (next != Next::kPose) break;
      first = true;  // time goes on from here
      start = std::max(start, Clock::now());
    }
    if (first) {
      first_stamp_ns = pose.stamp_ns;
      first = false;
      if (!body_is_told) id = s.publish_skeleton();
    }
    auto due = start;
    if (live) {
      if (last_frame > 0 && pose.frame > last_frame + 1) s.health.lost(pose.frame - last_frame - 1);
      last_frame = pose.frame;
    } else if (s.options.speed > 0.0) {
      const double since = static_cast<double>(pose.stamp_ns - first_stamp_ns) / s.options.speed;
      due = start + std::chrono::nanoseconds(static_cast<std::int64_t>(since));
      sleep_until(due);
      if (stop.stop_requested()) break;
      if (Clock::now() > due + period) ++counts.late;
    }
    frame = live ? pose.frame : frame + 1;
    if (!pose.pose.is_valid()) {
      ++counts.refused;
      s.health.lost(1);
      continue;
    }
    const std::int64_t now = bus::now_ns();
    pose.frame = frame;
    if (!live) pose.stamp_ns = now;  // a replayed pose is measured when it is played
    bus::to_message(pose, id, message);
    message.header().publish_ns(bus::now_ns());
    if (s.poses.write(message)) ++counts.published;
    s.health.sample(static_cast<double>(message.header().publish_ns() - pose.stamp_ns) * 1e-9);
    const auto seen = s.poses.counts();
    if (s.sole.another()) {
      s.health.state(msg::SERVICE_FAULT,
                     "another capture server publishes poses of this subject too; end one");
    } else if (seen.incompatible > 0) {
      s.health.state(msg::SERVICE_RUNNING, "a reader asks for another QoS and gets no poses");
    } else {
      s.health.state(msg::SERVICE_RUNNING);
    }
    s.health.tick(now);
  }
  s.health.state(msg::SERVICE_ENDED);
  return counts;
}

}  // namespace secondskin::server
