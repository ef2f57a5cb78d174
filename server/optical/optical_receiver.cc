#include "server/optical/optical_receiver.h"

#include <fmt/format.h>
#include <poll.h>

#include <chrono>
#include <filesystem>
#include <fstream>
#include <stdexcept>

#include "wire/serial_port.h"

namespace secondskin::server {
namespace {

namespace fs = std::filesystem;

// While a set may be about to be confirmed by silence, and otherwise.
constexpr int kShortWaitMs = 1;
constexpr int kLongWaitMs = 5;
constexpr std::int64_t kSilenceTold = 250'000'000;
constexpr std::int64_t kSilenceNs = wire::TagDecoder::kSilenceNs + 1'000'000;

std::int64_t monotonic_ns() {
  return std::chrono::nanoseconds(std::chrono::steady_clock::now().time_since_epoch()).count();
}

std::int64_t epoch_minus_monotonic_ns() {
  return std::chrono::nanoseconds(std::chrono::system_clock::now().time_since_epoch()).count() -
         monotonic_ns();
}

struct Tag {
  std::string place;
  wire::TagDecoder decoder;
  std::unique_ptr<wire::SerialPort> port;  // or
  std::ifstream file;
  std::uint64_t openings = 0;
};

}  // namespace

struct OpticalReceiver::State {
  State(const OpticalFormat& format_, TagMerger::Clock clock)
      : format(format_), merger(format.detectors, format.projectors, clock) {}

  Next next_from_files(ProjectorFrame& frame);
  Next next_from_ports(ProjectorFrame& frame);

  OpticalFormat format;
  std::vector<std::unique_ptr<Tag>> tags;
  TagMerger merger;
  bool live = false;
  std::int64_t epoch_offset_ns = 0;
  std::int64_t last_read_ns = 0;
  std::vector<pollfd> waiting;
  std::vector<std::uint8_t> buffer;
};

OpticalReceiver::OpticalReceiver(const std::vector<std::string>& places,
                                 const OpticalFormat& format) {
  if (places.size() != format.detectors.size()) {
    throw std::runtime_error(
        fmt::format("{} ports or files for a suit of {} tags; expected one a tag", places.size(),
                    format.detectors.size()));
  }
  std::size_t files = 0;
  for (const auto& place : places) files += fs::is_regular_file(place) ? 1 : 0;
  if (files != 0 && files != places.size()) {
    for (const auto& place : places) {
      if (!fs::is_regular_file(place)) {
        throw std::runtime_error(fmt::format(
            "'{}' is no file while others are; expected ports only or files only", place));
      }
    }
  }
  const bool live = files == 0;
  state_ =
      std::make_unique<State>(format, live ? TagMerger::Clock::kArrival : TagMerger::Clock::kCount);
  auto& s = *state_;
  s.live = live;
  s.epoch_offset_ns = epoch_minus_monotonic_ns();
  for (std::size_t i = 0; i < places.size(); ++i) {
    const wire::TagFormat tag_format{format.detectors[i], format.projectors, format.gray};
    auto tag = std::make_unique<Tag>(Tag{places[i], wire::TagDecoder(tag_format), nullptr, {}, 0});
    if (live) {
      tag->port = std::make_unique<wire::SerialPort>(places[i], kBaudRate);
    } else {
      tag->file.open(places[i], std::ios::binary);
      if (!tag->file) throw std::runtime_error(fmt::format("'{}' cannot be read", places[i]));
    }
    s.tags.push_back(std::move(tag));
  }
  s.waiting.reserve(places.size());
  // From a file so few at once that no tag runs far ahead of the others.
  s.buffer.resize(live ? 4096 : 512);
}

OpticalReceiver::~OpticalReceiver() = default;

const OpticalFormat& OpticalReceiver::format() const noexcept { return state_->format; }
bool OpticalReceiver::live() const noexcept { return state_->live; }
std::size_t OpticalReceiver::tags() const noexcept { return state_->tags.size(); }
std::size_t OpticalReceiver::detectors() const noexcept { return state_->merger.detectors(); }
std::size_t OpticalReceiver::projectors() const noexcept { return state_->merger.projectors(); }

Next OpticalReceiver::next(ProjectorFrame& frame) {
  return state_->live ? state_->next_from_ports(frame) : state_->next_from_files(frame);
}

Next OpticalReceiver::State::next_from_files(ProjectorFrame& frame) {
  while (true) {
    if (merger.next(0, frame)) return Next::kPose;
    const auto wanted = merger.wanted();
    if (!wanted) return Next::kEnd;
    Tag& tag = *tags[*wanted];
    const auto sink = [&](const wire::TagSet& set) { merger.add(*wanted, set); };
    tag.file.read(reinterpret_cast<char*>(buffer.data()),
                  static_cast<std::streamsize>(buffer.size()));
    const auto got = static_cast<std::size_t>(tag.file.gcount());
    tag.decoder.feed({buffer.data(), got}, 0, sink);
    if (got == 0) {
      tag.decoder.finish(sink);
      merger.finish(*wanted);
    }
  }
}

Next OpticalReceiver::State::next_from_ports(ProjectorFrame& frame) {
  const std::int64_t end = monotonic_ns() + kSilenceTold;
  for (std::int64_t now = monotonic_ns(); now < end; now = monotonic_ns()) {
    waiting.clear();
    for (std::size_t i = 0; i < tags.size(); ++i) {
      Tag& tag = *tags[i];
      if (!tag.port->poll(static_cast<double>(now) * 1e-9)) continue;
      const auto sink = [&](const wire::TagSet& set) { merger.add(i, set); };
      if (tag.port->openings() != tag.openings) {
        tag.openings = tag.port->openings();
        tag.decoder.finish(sink);
      }
      std::size_t got = tag.port->read_some(buffer);
      while (got > 0) {
        last_read_ns = now;
        tag.decoder.feed({buffer.data(), got}, now, sink);
        got = got == buffer.size() ? tag.port->read_some(buffer) : 0;
      }
      tag.decoder.tick(now, sink);
      if (tag.port->fd() >= 0) waiting.push_back({tag.port->fd(), POLLIN, 0});
    }
    if (merger.next(now, frame)) {
      frame.stamp_ns += epoch_offset_ns;
      return Next::kPose;
    }
    ::poll(waiting.data(), waiting.size(),
           now - last_read_ns < kSilenceNs ? kShortWaitMs : kLongWaitMs);
  }
  return Next::kSilence;
}

TagStatus OpticalReceiver::status(std::size_t i) const {
  const Tag& tag = *state_->tags[i];
  TagStatus status;
  status.place = tag.place;
  status.connected = tag.port ? tag.port->connected() : tag.file.good();
  status.alive = state_->merger.alive(i);
  if (tag.port) status.trouble = tag.port->last_error();
  status.bytes = tag.decoder.counters();
  status.sets = state_->merger.counters(i);
  return status;
}

}  // namespace secondskin::server
