#include "clients/stream/stream_service.h"

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <chrono>
#include <optional>

#include "bus/health.h"
#include "bus/pose_messages.h"
#include "bus/reader.h"
#include "bus/wait_set.h"
#include "motion/anatomy.h"

namespace secondskin::stream {

namespace msg = bus::msg;
using namespace std::chrono_literals;

namespace {

constexpr auto kLookEvery = 250ms;
constexpr std::int64_t kSilenceAfter = 1'000'000'000;  // [ns]
// Not every datagram to nobody is refused; health does not change with each.
constexpr std::int64_t kAwayFor = 1'000'000'000;  // [ns]

}  // namespace

struct StreamService::State {
  State(bus::Participant& participant, const std::string& name,
        std::unique_ptr<PoseEncoder> encoder_, const wire::UdpPlace& to_)
      : encoder(std::move(encoder_)),
        to(to_),
        sender(to_),
        bodies(participant),
        poses(participant),
        health(participant, name) {
    news.attach(bodies);
    news.attach(poses);
  }

  void take_body() {
    if (bodies.take_newest(body_message) == 0) return;
    body_id.reset();
    const Skeleton body = bus::to_skeleton(body_message);
    if (!is_canonical(body)) throw std::runtime_error("the body is not the canonical one");
    encoder->set_body(body);
    body_id = body_message.skeleton_id();
  }

  void take_pose() {
    const std::size_t taken = poses.take_newest(pose_message);
    if (taken == 0) return;
    counts.skipped += taken - 1;
    if (pose_message.skeleton_id() != body_id) return;  // its body is still under way
    if (!bus::from_message(pose_message, pose) || !pose.pose.is_valid() ||
        pose.pose.q_PB.size() != kJointCount) {
      health.lost(1);
      return;
    }
    for (const wire::Datagram& datagram : encoder->encode(pose)) {
      ++counts.datagrams;
      if (sender.send(datagram)) continue;
      ++counts.refused;
      refused_ns = bus::now_ns();
    }
    ++counts.poses;
    last_ns = bus::now_ns();
    const bool away = last_ns - refused_ns < kAwayFor;
    health.sample(1e-9 * static_cast<double>(last_ns - pose.stamp_ns));
    health.state(msg::SERVICE_RUNNING,
                 away ? fmt::format("nobody listens at {}", to.text()) : std::string());
  }

  std::unique_ptr<PoseEncoder> encoder;
  wire::UdpPlace to;
  wire::UdpSender sender;
  bus::Reader<msg::SkeletonDefinition> bodies;
  bus::Reader<msg::SkeletonPose> poses;
  bus::WaitSet news;
  bus::HealthReporter health;
  msg::SkeletonDefinition body_message;
  msg::SkeletonPose pose_message;
  StampedPose pose;
  std::optional<std::uint32_t> body_id;
  std::int64_t last_ns = 0, refused_ns = 0;
  StreamCounts counts;
};

StreamService::StreamService(bus::Participant& participant, std::string name,
                             std::unique_ptr<PoseEncoder> encoder, const wire::UdpPlace& to)
    : state_(std::make_unique<State>(participant, name, std::move(encoder), to)) {}

StreamService::~StreamService() = default;

StreamCounts StreamService::run(std::stop_token stop) {
  auto& s = *state_;
  const std::stop_callback wake(stop, [&s] { s.news.wake(); });
  s.health.state(msg::SERVICE_WAITING, "no pose comes");
  while (!stop.stop_requested()) {
    s.news.wait(kLookEvery);
    try {
      s.take_body();
      s.take_pose();
    } catch (const std::runtime_error& error) {  // a body that is none; another may come
      spdlog::warn("{}", error.what());
      s.health.state(msg::SERVICE_FAULT, error.what());
    }
    const std::int64_t now = bus::now_ns();
    if (s.last_ns != 0 && now - s.last_ns > kSilenceAfter) {
      s.last_ns = 0;
      s.health.state(msg::SERVICE_WAITING, "no pose comes");
    }
    s.health.tick(now);
  }
  s.health.state(msg::SERVICE_ENDED);
  return s.counts;
}

}  // namespace secondskin::stream
