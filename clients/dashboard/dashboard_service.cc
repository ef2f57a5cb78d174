#include "clients/dashboard/dashboard_service.h"

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <array>
#include <chrono>
#include <stdexcept>
#include <thread>

#include "bus/health.h"
#include "bus/raw.h"
#include "bus/topics.h"
#include "bus/wait_set.h"
#include "bus/writer.h"
#include "clients/dashboard/foxglove_server.h"
#include "clients/dashboard/live_scene.h"
#include "clients/dashboard/orders.h"
#include "motion/whole_file.h"

namespace secondskin::dashboard {

namespace msg = bus::msg;
using namespace std::chrono_literals;

namespace {

constexpr auto kHealthPeriod = 250ms;
// A pose's message wakes the coach, too. Clients are sent theirs when the session's own work on it
// is most likely done, together with what came of it.
constexpr auto kSessionFirst = 4ms;

// The channels that follow those of bus::kTopics, in the order of Drawn.
std::size_t place_of(Drawn drawn) { return bus::kTopics.size() + static_cast<std::size_t>(drawn); }

template <class Message>
constexpr std::size_t place_of() {
  return bus::kTopicOf<Message>;
}

std::string topic_of(const std::string& subject, std::string_view name) {
  return fmt::format("/secondskin/{}/{}", subject, name);
}

// What changes seldom and must not be missed; the rest are streams.
Keep keep_of(std::size_t topic) {
  switch (topic) {
    case place_of<msg::SkeletonDefinition>():
    case place_of<msg::ServiceHealth>():
    case place_of<msg::ReferenceMotionList>():
    case place_of<msg::SessionCommand>():
    case place_of<msg::SessionState>():
    case place_of<msg::EmergencyStop>():
    case place_of<msg::RepetitionScore>():
      return Keep::kEach;
    default:
      return Keep::kStream;
  }
}

std::vector<ServedChannel> channels(const std::string& subject, const DashboardOptions& options) {
  const std::string idl = read_whole_file(options.idl);
  std::vector<ServedChannel> list;
  for (std::size_t t = 0; t < bus::kTopics.size(); ++t) {
    const auto& info = bus::kTopics[t];
    list.push_back({{.topic = topic_of(subject, info.name),
                     .encoding = "cdr",
                     .schema_name = bus::idl_type_name(info.type_name),
                     .schema = idl,
                     .schema_encoding = "omgidl"},
                    keep_of(t)});
  }
  auto expert = list[place_of<msg::SkeletonPose>()];
  expert.channel.topic = topic_of(subject, "expert");
  list.push_back(std::move(expert));
  for (const auto& [topic, type] :
       {std::pair("/tf", "FrameTransforms"), {"/scene", "SceneUpdate"}}) {
    list.push_back(
        {{.topic = topic,
          .encoding = "json",
          .schema_name = fmt::format("foxglove.{}", type),
          .schema = read_whole_file(options.foxglove_schemas / fmt::format("{}.json", type)),
          .schema_encoding = "jsonschema"},
         Keep::kStream});
  }
  return list;
}

// Sorts as numbers do.
std::string time_key(std::int64_t time_ns) { return fmt::format("{:020}", time_ns); }

}  // namespace

struct DashboardService::State {
  State(bus::Participant& participant, DashboardOptions given)
      : options(std::move(given)),
        session_topic(topic_of(participant.config().subject, "session")),
        server(
            channels(participant.config().subject, options),
            {session_topic, topic_of(participant.config().subject, "stop")},
            [this](const auto& channel, auto payload) { return publish(channel, payload); },
            options.web, options.handlers),
        raw(participant.config()),
        commands(participant),
        stops(participant),
        health(participant, "dashboard"),
        scene({.subject = participant.config().subject,
               .reference = options.reference,
               .wanted = [this](Drawn drawn) { return server.wanted(place_of(drawn)); },
               .publish =
                   [this](Drawn drawn, std::int64_t time_ns, std::vector<std::uint8_t> bytes) {
                     server.publish(place_of(drawn), time_ns, std::move(bytes));
                   }}) {
    for (std::size_t t = 0; t < bus::kTopics.size(); ++t) {
      readers.push_back(std::make_unique<bus::RawReader>(raw, t));
      news.attach(*readers.back());
    }
  }

  ~State() { server.stop(); }  // its thread uses the writers

  // ---- from clients, on the sockets' thread

  std::string publish(const foxglove::ClientChannel& channel,
                      std::span<const std::uint8_t> payload) {
    const bool is_session = channel.topic == session_topic;
    return is_session ? pass_on(session_command(channel.encoding, payload), commands)
                      : pass_on(emergency_stop(channel.encoding, payload), stops);
  }

  template <class Message>
  std::string pass_on(tl::expected<Message, std::string> message, bus::Writer<Message>& writer) {
    if (!message) return message.error();
    message->publish_ns(bus::now_ns());
    return writer.write(*message) ? "" : "the bus did not take it";
  }

  // ---- to clients, on run()'s thread

  void forward_all() {
    for (std::size_t t = 0; t < readers.size(); ++t) {
      while (readers[t]->take(message)) {
        const std::int64_t source_ns = message.source_ns;
        std::string key = key_of(t);
        scene.take(t, source_ns, message.bytes);
        server.publish(t, source_ns, std::move(message.bytes), std::move(key));
        if (t == place_of<msg::RepetitionScore>()) forget_former_sessions();
        health.sample(static_cast<double>(bus::now_ns() - source_ns) * 1e-9);
        ++counts.messages;
      }
    }
  }

  // Of the seldom ones; the newest of each key is what a new client needs to know.
  std::string key_of(std::size_t topic) {
    if (topic == place_of<msg::ServiceHealth>()) {
      if (!bus::decode(message.bytes, service)) return {};
      return service.service().to_string() + " " + service.instance().to_string();
    }
    if (topic == place_of<msg::RepetitionScore>()) {
      return bus::decode(message.bytes, repetition) ? time_key(repetition.start_ns()) : "";
    }
    if (topic == place_of<msg::SessionState>() && bus::decode(message.bytes, state) &&
        state.session_start_ns() != session_start_ns) {
      session_start_ns = state.session_start_ns();
      forget_former_sessions();
    }
    return {};
  }

  void forget_former_sessions() {
    server.forget_before(place_of<msg::RepetitionScore>(), time_key(session_start_ns));
  }

  void report() {
    const auto web = server.counts();
    if (web.dropped != counts.web.dropped) {
      health.lost(web.dropped - counts.web.dropped);
      health.state(msg::SERVICE_RUNNING,
                   fmt::format("{} clients were too slow and were closed", web.dropped));
    }
    counts.web = web;
    health.tick(bus::now_ns());
  }

  DashboardOptions options;
  std::string session_topic;
  FoxgloveServer server;  // first, so that a port in use costs nothing
  bus::Participant raw;   // one participant reads a topic either raw or typed
  bus::Writer<msg::SessionCommand> commands;
  bus::Writer<msg::EmergencyStop> stops;
  bus::HealthReporter health;
  std::vector<std::unique_ptr<bus::RawReader>> readers;
  bus::WaitSet news;
  LiveScene scene;
  bus::RawMessage message;
  msg::ServiceHealth service;
  msg::RepetitionScore repetition;
  msg::SessionState state;
  std::int64_t session_start_ns = 0;
  DashboardCounts counts;
};

DashboardService::DashboardService(bus::Participant& participant, DashboardOptions options)
    : state_(std::make_unique<State>(participant, std::move(options))) {}

DashboardService::~DashboardService() = default;

std::uint16_t DashboardService::port() const noexcept { return state_->server.port(); }

DashboardCounts DashboardService::run(std::stop_token stop) {
  auto& s = *state_;
  const std::stop_callback wake(stop, [&s] { s.news.wake(); });
  s.server.start();
  std::jthread scene([&s](std::stop_token over) { s.scene.run(over); });
  s.health.state(msg::SERVICE_RUNNING);
  while (!stop.stop_requested()) {
    if (s.news.wait(kHealthPeriod)) std::this_thread::sleep_for(kSessionFirst);
    s.forward_all();
    s.report();
  }
  scene.request_stop();
  scene.join();
  s.server.stop();
  s.health.state(msg::SERVICE_ENDED);
  s.counts.web = s.server.counts();
  return s.counts;
}

}  // namespace secondskin::dashboard
