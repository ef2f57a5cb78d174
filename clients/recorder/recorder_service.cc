#include "clients/recorder/recorder_service.h"

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <array>
#include <chrono>
#include <condition_variable>
#include <mutex>
#include <stdexcept>
#include <vector>

#include "bus/health.h"
#include "bus/raw.h"
#include "bus/topics.h"
#include "bus/wait_set.h"
#include "motion/whole_file.h"
#include "recording/mcap_writer.h"

namespace secondskin::recorder {

namespace msg = bus::msg;
using namespace std::chrono_literals;

namespace {

constexpr auto kFlushPeriod = 250ms;
// After a stop the others' last words (scores, final states) are still under way.
constexpr auto kLastWords = 150ms;

std::filesystem::path with_folder(const std::filesystem::path& file) {
  if (file.has_parent_path()) std::filesystem::create_directories(file.parent_path());
  return file;
}

}  // namespace

struct RecorderService::State {
  State(bus::Participant& participant, const RecorderOptions& options)
      : raw(participant.config()),
        writer(with_folder(options.file)),
        health(participant, "recorder") {
    const std::string idl = read_whole_file(options.idl);
    for (std::size_t t = 0; t < bus::kTopics.size(); ++t) {
      const auto& info = bus::kTopics[t];
      channels[t] = writer.add_channel(
          fmt::format("/secondskin/{}/{}", participant.config().subject, info.name),
          bus::idl_type_name(info.type_name), "omgidl", idl);
      readers.push_back(std::make_unique<bus::RawReader>(raw, t));
      news.attach(*readers.back());
    }
  }

  void take_all() {
    for (std::size_t t = 0; t < readers.size(); ++t) {
      while (readers[t]->take(message)) {
        const std::int64_t now = bus::now_ns();
        writer.write(channels[t], ++sequence[t], now, message.source_ns, message.bytes);
        describe(t);
        health.sample(static_cast<double>(now - message.source_ns) * 1e-9);
        ++counts.messages;
      }
    }
  }

  void count_topics() {
    std::size_t heard = 0;
    for (const auto& reader : readers) heard += reader->counts().writers > 0 ? 1 : 0;
    {
      const std::lock_guard lock(mutex);
      topics_heard = heard;
    }
    heard_more.notify_all();
  }

  // What somebody who opens the file wants to know first.
  void describe(std::size_t topic) {
    if (topic == bus::kTopicOf<msg::SkeletonPose>) {
      if (bus::decode(message.bytes, pose)) count_missing(pose.header().frame());
    }
    if (topic == bus::kTopicOf<msg::SkeletonDefinition>) {
      msg::SkeletonDefinition body;
      if (!bus::decode(message.bytes, body)) return;
      std::string joints;
      for (const auto& joint : body.joints()) {
        joints += fmt::format("{}{}", joints.empty() ? "" : " ", joint.name().c_str());
      }
      writer.write_metadata("skeleton", {{"source", body.source().to_string()},
                                         {"rate_hz", fmt::format("{:g}", body.rate_hz())},
                                         {"skeleton_id", std::to_string(body.skeleton_id())},
                                         {"joints", joints}});
    } else if (topic == bus::kTopicOf<msg::SessionState>) {
      msg::SessionState state;
      if (!bus::decode(message.bytes, state) || state.session_start_ns() == described_session)
        return;
      described_session = state.session_start_ns();
      writer.write_metadata(
          "settings", {{"reference", state.reference().to_string()},
                       {"reference_fingerprint", std::to_string(state.reference_fingerprint())},
                       {"body_map", state.body_map().to_string()},
                       {"tolerance_scale", fmt::format("{:g}", state.tolerance_scale())},
                       {"max_cues", std::to_string(state.max_cues())}});
    }
  }

  bus::Participant raw;  // one participant reads a topic either raw or typed
  // A reliable reader misses only what was published before it was found: after a capture server's
  // restart the first frames.
  void count_missing(std::uint64_t frame) {
    const bool restarted = frame <= last_frame;
    const std::uint64_t missing = restarted         ? frame - 1
                                  : last_frame == 0 ? 0
                                                    : frame - last_frame - 1;
    counts.lost += missing;
    health.lost(missing);
    last_frame = frame;
  }

  recording::McapWriter writer;
  std::vector<std::unique_ptr<bus::RawReader>> readers;
  bus::WaitSet news;
  bus::HealthReporter health;
  std::array<std::uint16_t, bus::kTopics.size()> channels{};
  std::array<std::uint32_t, bus::kTopics.size()> sequence{};
  std::int64_t described_session = 0;
  bus::RawMessage message;
  msg::SkeletonPose pose;
  std::uint64_t last_frame = 0;
  std::mutex mutex;  // guards topics_heard
  std::condition_variable heard_more;
  std::size_t topics_heard = 0;
  RecorderCounts counts;
};

RecorderService::RecorderService(bus::Participant& participant, const RecorderOptions& options)
    : state_(std::make_unique<State>(participant, options)) {}

RecorderService::~RecorderService() = default;

bool RecorderService::wait_until_heard(std::size_t topics, std::chrono::nanoseconds at_most) {
  std::unique_lock lock(state_->mutex);
  return state_->heard_more.wait_for(lock, at_most, [&] { return state_->topics_heard >= topics; });
}

RecorderCounts RecorderService::run(std::stop_token stop) {
  auto& s = *state_;
  const std::stop_callback wake(stop, [&s] { s.news.wake(); });
  s.health.state(msg::SERVICE_RUNNING);
  try {
    while (!stop.stop_requested()) {
      s.news.wait(kFlushPeriod);
      s.count_topics();
      s.take_all();
      s.writer.flush_if_due(bus::now_ns());
      s.health.tick(bus::now_ns());
    }
    const auto end = std::chrono::steady_clock::now() + kLastWords;
    for (auto now = std::chrono::steady_clock::now(); now < end;
         now = std::chrono::steady_clock::now()) {
      s.news.wait(end - now);
      s.take_all();
    }
    s.writer.close();
    s.health.state(msg::SERVICE_ENDED);
  } catch (const std::exception& error) {
    s.counts.error = error.what();
    spdlog::error("recording ended: {}", error.what());
    s.health.state(msg::SERVICE_FAULT, error.what());
  }
  for (const auto& reader : s.readers) s.counts.lost += reader->counts().lost;
  s.counts.messages = s.writer.messages();
  s.counts.bytes = s.writer.stored_bytes();
  return s.counts;
}

}  // namespace secondskin::recorder
