#include "server/wearable/wearable_topics.h"

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <string>
#include <vector>

#include "bus/health.h"
#include "bus/pose_messages.h"
#include "bus/writer.h"

namespace secondskin::server {

namespace msg = bus::msg;

namespace {

struct Seen {
  std::uint64_t used = 0, gated = 0, missing = 0;
};

Seen seen_of(const BoardCounts& counts) {
  return {counts.gyro.used + counts.accel.used, counts.gyro.gated + counts.accel.gated,
          counts.gyro.missing + counts.accel.missing};
}

double share(double part, double whole) { return whole > 0.0 ? part / whole : 0.0; }

}  // namespace

struct WearableTopics::State {
  State(bus::Participant& participant, const WearableSource& source)
      : uncertainty(participant), health(participant, "wearable"), skeleton(source.skeleton()) {
    message.skeleton_id(bus::skeleton_id(skeleton));
    message.rotations().resize(skeleton.size());
    // Of a recording the start is known, and told by who opened it.
    if (source.started()) know(source, false);
  }

  void report(const WearableSource& source, std::int64_t now_ns);
  void know(const WearableSource& source, bool tell) {
    knows = true;
    for (const auto& warning : source.start().warnings) {
      if (tell) spdlog::warn("{}", warning);
    }
    odd = fmt::format("{}", fmt::join(source.start().warnings, "; ")).substr(0, 255);
  }

  bus::Writer<msg::PoseUncertainty> uncertainty;
  bus::HealthReporter health;
  Skeleton skeleton;
  msg::PoseUncertainty message;
  std::uint64_t poses = 0, poses_before = 0;
  std::vector<Seen> before;
  std::string odd;
  std::int64_t reported_ns = 0;
  bool knows = false;
};

WearableTopics::WearableTopics(bus::Participant& participant, const WearableSource& source)
    : state_(std::make_unique<State>(participant, source)) {}
WearableTopics::~WearableTopics() = default;

void WearableTopics::publish(const WearableSource& source, Next what) {
  auto& s = *state_;
  const std::int64_t now = bus::now_ns();
  if (source.started() && !s.knows) s.know(source, true);
  if (what == Next::kPose) {
    const BodyFilter& filter = source.filter();
    ++s.poses;
    msg::SampleHeader header;
    header.frame(source.frame());
    header.stamp_ns(source.live() ? filter.stamp_ns() : now);
    header.publish_ns(now);
    s.message.header(header);
    const auto root = filter.root_covariance();
    const Eigen::Vector3d p = root.diagonal().head<3>().cwiseMax(0.0).cwiseSqrt();
    s.message.root_position().x(p.x());
    s.message.root_position().y(p.y());
    s.message.root_position().z(p.z());
    for (std::size_t i = 0; i < s.message.rotations().size(); ++i) {
      const Eigen::Vector3d sigma = filter.sigma(static_cast<Joint>(i));
      s.message.rotations()[i].x(sigma.x());
      s.message.rotations()[i].y(sigma.y());
      s.message.rotations()[i].z(sigma.z());
    }
    s.uncertainty.write(s.message);
    if (source.live()) s.health.sample(static_cast<double>(now - filter.stamp_ns()) * 1e-9);
  }
  if (now - s.reported_ns >= 1'000'000'000) s.report(source, now);
  s.health.tick(now);
}

void WearableTopics::State::report(const WearableSource& source, std::int64_t now_ns) {
  const double seconds = reported_ns == 0 ? 1.0 : static_cast<double>(now_ns - reported_ns) * 1e-9;
  reported_ns = now_ns;
  if (!source.started()) {
    health.state(msg::SERVICE_WAITING,
                 "stand still in the rest pose: upright, arms hanging, palms to the thighs");
    return;
  }
  const auto counts = source.filter().counts();
  before.resize(counts.size());
  auto& sensors = health.sensors();
  sensors.clear();
  std::string trouble;
  double fitting = 0.0;
  for (std::size_t b = 0; b < counts.size(); ++b) {
    const Seen now = seen_of(counts[b]);
    const auto used = static_cast<double>(now.used - before[b].used);
    const auto gated = static_cast<double>(now.gated - before[b].gated);
    const auto missing = static_cast<double>(now.missing - before[b].missing);
    before[b] = now;
    msg::SensorHealth sensor;
    sensor.name(source.garment().boards[b].name.substr(0, 63));
    sensor.rate_hz(0.5 * (used + gated) / seconds);
    sensor.loss(share(missing, used + gated + missing));
    sensor.confidence(share(used, used + gated));
    fitting += sensor.confidence();
    if (sensors.size() < msg::MAX_SENSORS) sensors.push_back(sensor);
    if (used + gated == 0.0 && missing > 0.0 && trouble.empty()) {
      trouble = fmt::format("{} is silent: is it plugged in?", source.garment().boards[b].name);
    }
  }
  if (trouble.empty()) trouble = odd;
  health.confidence(share(fitting, static_cast<double>(counts.size())));
  health.state(poses > poses_before ? msg::SERVICE_RUNNING : msg::SERVICE_WAITING, trouble);
  poses_before = poses;
}

}  // namespace secondskin::server
