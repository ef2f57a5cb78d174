#include "sim/optical/virtual_tags.h"

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <fstream>
#include <stdexcept>
#include <system_error>
#include <utility>

namespace secondskin::sim {
namespace {

// A machine that is later than this leaves cycles out instead of sending old ones in a burst.
constexpr double kLongestDelay = 0.25;  // [s]

bool is_share(double value) noexcept { return value >= 0.0 && value <= 1.0; }

}  // namespace

std::vector<std::size_t> tag_sizes(const Suit& suit) {
  std::vector<std::size_t> sizes;
  for (std::size_t tag = 0; tag < suit.tags(); ++tag) sizes.push_back(suit.detectors_of(tag));
  return sizes;
}

VirtualTags::VirtualTags(VirtualRig& rig, std::vector<std::size_t> tag_sizes, const TagLink& link,
                         std::uint64_t seed)
    : rig_(rig),
      sizes_(std::move(tag_sizes)),
      link_(link),
      cycle_time_(1e-9 * static_cast<double>(wire::cycle_ns(rig.projectors().size()))),
      random_(seed),
      values_(rig.detectors() * rig.projectors().size()) {
  std::size_t detectors = 0;
  for (const std::size_t size : sizes_) {
    if (size < 1 || size > wire::kDetectorsOnATag) {
      throw std::invalid_argument("virtual tags: a tag has " + std::to_string(size) +
                                  " detectors, expected 1 to " +
                                  std::to_string(wire::kDetectorsOnATag));
    }
    detectors += size;
    lines_.push_back({{size, rig.projectors().size(), link.gray}});
  }
  if (detectors != rig.detectors()) {
    throw std::invalid_argument("virtual tags: the tags have " + std::to_string(detectors) +
                                " detectors, the scene " + std::to_string(rig.detectors()));
  }
  if (!is_share(link.torn_share) || !is_share(link.byte_loss) || !(link.latency >= 0.0) ||
      !(link.jitter >= 0.0)) {
    throw std::invalid_argument(
        "virtual tags: expected shares from 0 to 1 and delays of at least 0");
  }
}

void VirtualTags::cycle(double time, const Sink& sink) {
  rig_.cycle(time, values_);
  std::span<const std::uint8_t> values = values_;
  std::span<const std::uint8_t> synced = rig_.synced();
  for (std::size_t tag = 0; tag < sizes_.size(); ++tag) {
    const std::size_t count = lines_[tag].format.values();
    const auto in_step = synced.first(sizes_[tag]);
    if (std::find(in_step.begin(), in_step.end(), 1) != in_step.end()) {
      bytes_.clear();
      wire::encode_set(lines_[tag].format, values.first(count), bytes_);
      send(tag, time + cycle_time_ + link_.latency, sink);
    }
    values = values.subspan(count);
    synced = synced.subspan(sizes_[tag]);
  }
}

void VirtualTags::send(std::size_t tag, double time, const Sink& sink) {
  lose_bytes();
  std::span<const std::uint8_t> rest = bytes_;
  while (!rest.empty()) {
    const std::size_t count = link_.packet == 0 ? rest.size() : std::min(link_.packet, rest.size());
    const double delay = link_.jitter > 0.0 ? link_.jitter * uniform_(random_) : 0.0;
    double& last = lines_[tag].last_arrival;
    last = std::max(last, time + delay);
    sink(tag, last, rest.first(count));
    rest = rest.subspan(count);
  }
}

void VirtualTags::lose_bytes() {
  if (link_.torn_share > 0.0 && uniform_(random_) < link_.torn_share) {
    const auto size = static_cast<std::ptrdiff_t>(bytes_.size());
    const auto begin = static_cast<std::ptrdiff_t>(uniform_(random_) * static_cast<double>(size));
    const auto longest = static_cast<double>(size - begin);
    const auto length = 1 + static_cast<std::ptrdiff_t>(uniform_(random_) * longest);
    bytes_.erase(bytes_.begin() + begin, bytes_.begin() + std::min(begin + length, size));
  }
  if (link_.byte_loss > 0.0) {
    std::erase_if(bytes_, [&](std::uint8_t) { return uniform_(random_) < link_.byte_loss; });
  }
}

void write_tag_files(VirtualTags& tags, std::size_t cycles,
                     std::span<const std::filesystem::path> files) {
  if (files.size() != tags.tags()) {
    throw std::invalid_argument("virtual tags: " + std::to_string(files.size()) + " files for " +
                                std::to_string(tags.tags()) + " tags");
  }
  const auto fail = [](const std::filesystem::path& file) {
    throw std::system_error(errno, std::system_category(),
                            "virtual tags: " + file.string() + " cannot be written");
  };
  std::vector<std::ofstream> out;
  for (const std::filesystem::path& file : files) {
    out.emplace_back(file, std::ios::binary | std::ios::trunc);
    if (!out.back()) fail(file);
  }
  for (std::size_t i = 0; i < cycles; ++i) {
    tags.cycle(static_cast<double>(i) * tags.cycle_time(),
               [&](std::size_t tag, double, std::span<const std::uint8_t> bytes) {
                 out[tag].write(reinterpret_cast<const char*>(bytes.data()),
                                static_cast<std::streamsize>(bytes.size()));
               });
  }
  for (std::size_t tag = 0; tag < out.size(); ++tag) {
    out[tag].close();
    if (!out[tag]) fail(files[tag]);
  }
}

VirtualTagsRunner::VirtualTagsRunner(VirtualRig& rig, std::vector<std::size_t> tag_sizes,
                                     const TagLink& link, std::uint64_t seed,
                                     std::vector<std::string> links)
    : rig_(rig), tags_(rig, std::move(tag_sizes), link, seed), links_(std::move(links)) {
  if (links_.empty()) links_.resize(tags_.tags());
  if (links_.size() != tags_.tags()) {
    throw std::invalid_argument("virtual tags: " + std::to_string(links_.size()) + " links for " +
                                std::to_string(tags_.tags()) + " tags");
  }
  for (const std::string& path : links_) {
    terminals_.push_back(std::make_unique<wire::PseudoTerminal>(path));
  }
  pending_.resize(tags_.tags());
}

void VirtualTagsRunner::run(std::stop_token stop) {
  using Clock = std::chrono::steady_clock;
  const Clock::time_point start = Clock::now();
  const auto now = [&] { return std::chrono::duration<double>(Clock::now() - start).count(); };
  std::unique_lock lock(mutex_);
  start_ns_ =
      std::chrono::duration_cast<std::chrono::nanoseconds>(start.time_since_epoch()).count();
  std::uint64_t next = 0;
  while (!stop.stop_requested()) {
    const double cycle_time = tags_.cycle_time();
    const auto behind =
        static_cast<std::int64_t>(now() / cycle_time) - static_cast<std::int64_t>(next);
    if (static_cast<double>(behind) * cycle_time > kLongestDelay) {
      next += static_cast<std::uint64_t>(behind);
      counters_.skipped += static_cast<std::uint64_t>(behind);
    }
    if (now() >= static_cast<double>(next) * cycle_time) {
      tags_.cycle(static_cast<double>(next) * cycle_time,
                  [&](std::size_t tag, double time, std::span<const std::uint8_t> bytes) {
                    pending_[tag].push_back({time, {bytes.begin(), bytes.end()}});
                  });
      ++next;
      ++counters_.cycles;
    }
    write_due(now());
    double wake = static_cast<double>(next) * cycle_time;
    for (const auto& packets : pending_) {
      if (!packets.empty()) wake = std::min(wake, packets.front().time);
    }
    wake_.wait_until(
        lock, stop,
        start + std::chrono::duration_cast<Clock::duration>(std::chrono::duration<double>(wake)),
        [] { return false; });
  }
}

void VirtualTagsRunner::write_due(double now) {
  for (std::size_t tag = 0; tag < pending_.size(); ++tag) {
    auto& packets = pending_[tag];
    while (!packets.empty() && packets.front().time <= now) {
      const std::vector<std::uint8_t>& bytes = packets.front().bytes;
      const std::size_t written = terminals_[tag] ? terminals_[tag]->write_some(bytes) : 0;
      counters_.bytes += written;
      counters_.dropped_bytes += bytes.size() - written;
      packets.pop_front();
    }
  }
}

std::string VirtualTagsRunner::path(std::size_t tag) const {
  const std::lock_guard lock(mutex_);
  return terminals_.at(tag) ? terminals_[tag]->path() : std::string();
}

void VirtualTagsRunner::unplug(std::size_t tag) {
  const std::lock_guard lock(mutex_);
  terminals_.at(tag).reset();
}

void VirtualTagsRunner::plug(std::size_t tag) {
  const std::lock_guard lock(mutex_);
  if (!terminals_.at(tag)) {
    terminals_[tag] = std::make_unique<wire::PseudoTerminal>(links_[tag]);
  }
}

void VirtualTagsRunner::darken(std::size_t projector, bool dark) {
  const std::lock_guard lock(mutex_);
  rig_.projectors().at(projector).dark = dark;
}

VirtualTagsRunner::Counters VirtualTagsRunner::counters() const {
  const std::lock_guard lock(mutex_);
  return counters_;
}

std::optional<std::int64_t> VirtualTagsRunner::start_ns() const {
  const std::lock_guard lock(mutex_);
  return start_ns_;
}

}  // namespace secondskin::sim
