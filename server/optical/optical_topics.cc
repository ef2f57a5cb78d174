#include "server/optical/optical_topics.h"

#include <fmt/format.h>

#include <algorithm>

#include "bus/health.h"
#include "bus/pose_messages.h"
#include "bus/writer.h"

namespace secondskin::server {

namespace msg = bus::msg;

namespace {

constexpr std::size_t kNameLength = 31;  // of msg::Marker
constexpr std::size_t kMostValues = 4096;

// What was seen until the last report.
struct Seen {
  std::uint64_t frames = 0;
  std::vector<std::uint64_t> visible, gated, used;  // a detector
  std::vector<ValueCounts> projectors;
  std::vector<std::uint64_t> sets, lost;  // a tag
};

msg::SensorHealth sensor(const std::string& name, double rate_hz, double loss, double confidence) {
  msg::SensorHealth out;
  out.name(name.substr(0, 63));
  out.rate_hz(rate_hz);
  out.loss(std::clamp(loss, 0.0, 1.0));
  out.confidence(std::clamp(confidence, 0.0, 1.0));
  return out;
}

double share(double part, double whole) { return whole > 0.0 ? part / whole : 0.0; }

}  // namespace

struct OpticalTopics::State {
  State(bus::Participant& participant, std::vector<std::string> names_)
      : names(std::move(names_)),
        points(participant),
        raw(participant),
        health(participant, "optical") {
    visible.resize(names.size());
    cloud.markers().resize(std::min<std::size_t>(names.size(), msg::MAX_MARKERS));
    for (std::size_t i = 0; i < cloud.markers().size(); ++i) {
      cloud.markers()[i].name(names[i].substr(0, kNameLength));
    }
  }

  void report(const OpticalSource& source, std::int64_t now_ns);

  std::vector<std::string> names;
  bus::Writer<msg::MarkerCloud> points;
  bus::Writer<msg::ProjectorValues> raw;
  bus::HealthReporter health;
  msg::MarkerCloud cloud;
  msg::ProjectorValues values;
  std::uint64_t frames = 0;
  std::vector<std::uint64_t> visible;  // frames in which a detector's point was known
  Seen before;
  std::int64_t reported_ns = 0;
};

OpticalTopics::OpticalTopics(bus::Participant& participant, std::vector<std::string> detectors)
    : state_(std::make_unique<State>(participant, std::move(detectors))) {}
OpticalTopics::~OpticalTopics() = default;

void OpticalTopics::publish(const OpticalSource& source, Next what) {
  auto& s = *state_;
  const std::int64_t now = bus::now_ns();
  if (what == Next::kPose) {
    const auto& frame = source.values();
    const auto& points = source.points();
    msg::SampleHeader header;
    header.frame(frame.cycle + 1);
    header.stamp_ns(source.live() ? source.stamp_ns() : now);
    header.publish_ns(now);
    s.cloud.header(header);
    for (std::size_t i = 0; i < s.cloud.markers().size() && i < points.p_WM.size(); ++i) {
      auto& marker = s.cloud.markers()[i];
      const auto& p = points.p_WM[i];
      marker.valid(points.visible[i] != 0);
      if (marker.valid()) {
        marker.position().x(p.x());
        marker.position().y(p.y());
        marker.position().z(p.z());
        marker.residual(points.residual[i]);
        ++s.visible[i];
      }
    }
    s.points.write(s.cloud);
    s.values.header(header);
    s.values.projectors(static_cast<std::uint16_t>(frame.projectors));
    // A sequence of 4,096 bounds what can be shown of very large suits.
    const std::size_t shown = std::min(frame.detectors, kMostValues / frame.projectors);
    s.values.detectors(static_cast<std::uint16_t>(shown));
    s.values.values().assign(
        frame.values.begin(),
        frame.values.begin() + static_cast<std::ptrdiff_t>(shown * frame.projectors));
    s.raw.write(s.values);
    ++s.frames;
    if (source.live()) s.health.sample(static_cast<double>(now - source.stamp_ns()) * 1e-9);
  }
  if (now - s.reported_ns >= 1'000'000'000) s.report(source, now);
  s.health.tick(now);
}

void OpticalTopics::State::report(const OpticalSource& source, std::int64_t now_ns) {
  const double seconds = reported_ns == 0 ? 1.0 : static_cast<double>(now_ns - reported_ns) * 1e-9;
  reported_ns = now_ns;
  const auto& tracker = source.tracker();
  const auto& receiver = source.receiver();
  const auto detectors = tracker.detector_counts();
  const auto projectors = tracker.projector_fits();
  before.visible.resize(detectors.size());
  before.used.resize(detectors.size());
  before.gated.resize(detectors.size());
  before.projectors.resize(projectors.size());
  before.sets.resize(receiver.tags());
  before.lost.resize(receiver.tags());
  const double new_frames = static_cast<double>(frames - before.frames);
  before.frames = frames;

  std::string trouble;
  auto& sensors = health.sensors();
  sensors.clear();
  for (std::size_t i = 0; i < receiver.tags(); ++i) {
    const auto status = receiver.status(i);
    const std::uint64_t lost = status.bytes.torn + status.sets.missing;
    const auto sets = static_cast<double>(status.sets.sets - before.sets[i]);
    const auto missing = static_cast<double>(lost - before.lost[i]);
    before.sets[i] = status.sets.sets;
    before.lost[i] = lost;
    sensors.push_back(sensor(fmt::format("tag {}", i), sets / seconds,
                             share(missing, missing + sets), status.alive ? 1.0 : 0.0));
    if (!status.connected && trouble.empty()) trouble = status.trouble;
    if (status.connected && !status.alive && trouble.empty() && source.live()) {
      trouble = fmt::format("tag {} on {} sends nothing: is it switched on, do the projectors run?",
                            i, status.place);
    }
  }
  double seen = 0.0;
  for (std::size_t p = 0; p < projectors.size(); ++p) {
    const auto used = static_cast<double>(projectors[p].used - before.projectors[p].used);
    const auto gated = static_cast<double>(projectors[p].gated - before.projectors[p].gated);
    before.projectors[p] = projectors[p];
    sensors.push_back(sensor(fmt::format("projector {}", p), used / seconds,
                             share(gated, used + gated), share(used, used + gated)));
    if (used + gated == 0.0 && new_frames > 0.0 && trouble.empty()) {
      trouble = fmt::format("nobody sees projector {}: is it dark, or out of the calibration?", p);
    }
  }
  for (std::size_t d = 0; d < detectors.size(); ++d) {
    const auto now_visible = static_cast<double>(visible[d] - before.visible[d]);
    const auto used = static_cast<double>(detectors[d].used - before.used[d]);
    const auto gated = static_cast<double>(detectors[d].gated - before.gated[d]);
    before.visible[d] = visible[d];
    before.used[d] = detectors[d].used;
    before.gated[d] = detectors[d].gated;
    seen += share(now_visible, new_frames);
    if (sensors.size() < msg::MAX_SENSORS) {
      sensors.push_back(sensor(names[d], now_visible / seconds,
                               1.0 - share(now_visible, new_frames), share(used, used + gated)));
    }
  }
  health.confidence(detectors.empty() ? 0.0 : seen / static_cast<double>(detectors.size()));
  health.state(new_frames > 0.0 ? msg::SERVICE_RUNNING : msg::SERVICE_WAITING, trouble);
}

}  // namespace secondskin::server
