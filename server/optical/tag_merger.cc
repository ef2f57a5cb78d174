#include "server/optical/tag_merger.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>

namespace secondskin::server {
namespace {

constexpr double kJitter = 15e6;  // of the link (2.3) [ns]
constexpr double kMargin = 5e5;   // what the envelope is usually wrong by, at most [ns]
constexpr double kEarly = 4e6;    // and what it never is, even when it is new [ns]

}  // namespace

TagMerger::TagMerger(std::vector<std::size_t> detectors, std::size_t projectors, Clock clock)
    : projectors_(projectors), clock_(clock) {
  if (detectors.empty() || detectors.size() > 64) {
    throw std::invalid_argument(fmt::format("{} tags: expected 1 to 64", detectors.size()));
  }
  if (projectors < 1 || projectors > 255) {
    throw std::invalid_argument(fmt::format("{} projectors: expected 1 to 255", projectors));
  }
  for (const std::size_t count : detectors) {
    if (count < 1 || count > wire::kDetectorsOnATag) {
      throw std::invalid_argument(
          fmt::format("a tag with {} detectors: expected 1 to {}", count, wire::kDetectorsOnATag));
    }
    Tag tag;
    tag.detectors = count;
    tag.first_detector = detectors_;
    tag.held.resize(2 * kLockSets);
    for (auto& set : tag.held) set.values.reserve(count * projectors);
    detectors_ += count;
    tags_.push_back(std::move(tag));
  }
  ring_.resize(kRing);
  for (auto& slot : ring_) slot.frame = ProjectorFrame(detectors_, projectors_);
}

bool TagMerger::alive(std::size_t tag) const noexcept {
  const Tag& t = tags_[tag];
  if (t.finished) return false;
  return t.last_cycle + static_cast<std::int64_t>(kAliveCycles) > newest_;
}

// The line of the earliest arrivals at cycle 0, of the tags that are heard.
double TagMerger::origin() const noexcept {
  double least = std::numeric_limits<double>::infinity();
  for (const Tag& tag : tags_) {
    if (tag.locked && tag.last_cycle >= 0) least = std::min(least, tag.envelope_ns);
  }
  return least;
}

void TagMerger::add(std::size_t tag, const wire::TagSet& set) {
  Tag& t = tags_[tag];
  if (set.values.size() != t.detectors * projectors_) return;
  if (clock_ == Clock::kCount) {
    t.locked = started_ = true;
    put(tag, static_cast<std::int64_t>(set.number), set);
    return;
  }
  if (t.locked && set.arrival_ns - t.last_arrival > kRelockNs) {
    t.locked = false;
    t.holds = 0;
  }
  t.last_arrival = set.arrival_ns;
  if (t.locked) {
    place(tag, set);
    return;
  }
  if (t.holds == t.held.size()) {  // nobody else came yet: forget the oldest half
    std::rotate(t.held.begin(), t.held.begin() + kLockSets, t.held.end());
    t.holds -= kLockSets;
  }
  auto& held = t.held[t.holds++];
  held.number = set.number;
  held.arrival_ns = set.arrival_ns;
  held.values.assign(set.values.begin(), set.values.end());
  lock(set.arrival_ns, false);
}

// Sets the tags' cycles against each other once enough arrivals show each one's earliest line.
void TagMerger::lock(std::int64_t now_ns, bool impatient) {
  if (!started_) {
    // The first lock waits for all tags, but not forever for one that is switched off.
    bool all = true;
    bool any = false;
    std::int64_t oldest = now_ns;
    for (const Tag& t : tags_) {
      all = all && (t.holds >= kLockSets || t.finished);
      any = any || t.holds >= kLockSets;
      if (t.holds > 0) oldest = std::min(oldest, t.held[0].arrival_ns);
    }
    const bool overdue =
        now_ns - oldest > static_cast<std::int64_t>(1.75 * kLockSets * period()) || impatient;
    if (!all && !(any && overdue)) return;
  }
  const auto envelope = [this](const Tag& t) {
    double least = std::numeric_limits<double>::infinity();
    for (std::size_t i = 0; i < t.holds; ++i) {
      least = std::min(least, static_cast<double>(t.held[i].arrival_ns) -
                                  static_cast<double>(t.held[i].number) * period());
    }
    return least;
  };
  double reference = origin();
  if (!started_) {
    // Cycle 0 is the first one that any tag delivered.
    for (const Tag& t : tags_) {
      if (t.holds < kLockSets) continue;
      reference =
          std::min(reference, envelope(t) + static_cast<double>(t.held[0].number) * period());
    }
    started_ = true;
    out_ = 0;
  }
  for (std::size_t i = 0; i < tags_.size(); ++i) {
    Tag& t = tags_[i];
    if (t.locked || t.holds < kLockSets) continue;
    const double own = envelope(t);
    t.shift = std::llround((own - reference) / period());
    t.envelope_ns = own - static_cast<double>(t.shift) * period();
    t.arrivals.fill(t.envelope_ns);
    t.locked = true;
    release(i);
  }
}

void TagMerger::release(std::size_t tag) {
  Tag& t = tags_[tag];
  t.last_cycle = std::max(t.last_cycle, out_ - 1);
  for (std::size_t i = 0; i < t.holds; ++i) place(tag, t.held[i]);
  t.holds = 0;
}

void TagMerger::note_arrival(Tag& tag, double since_cycle_ns) noexcept {
  tag.arrivals[tag.next_arrival++ % kEnvelopeSets] = since_cycle_ns;
  tag.envelope_ns = *std::min_element(tag.arrivals.begin(), tag.arrivals.end());
}

// A set of a locked tag: which cycle is it of?
void TagMerger::place(std::size_t tag, const wire::TagSet& set) {
  Tag& t = tags_[tag];
  const auto arrival = static_cast<double>(set.arrival_ns);
  std::int64_t cycle = static_cast<std::int64_t>(set.number) + t.shift;
  const double after = arrival - t.envelope_ns - static_cast<double>(cycle) * period();
  std::int64_t skipped = 0;
  if (const double over = after - kJitter - kMargin; over > 0.0) {
    // No delay explains it: sets vanished without a trace, at least so many.
    skipped = static_cast<std::int64_t>(std::ceil(over / period()));
  } else if (after < -kEarly) {
    // Bytes are never early: a delay beyond all bounds was taken for vanished sets before.
    skipped = -static_cast<std::int64_t>(std::ceil((-after - kEarly) / period()));
  }
  cycle += skipped;
  t.shift += skipped;
  note_arrival(t, arrival - static_cast<double>(cycle) * period());
  put(tag, cycle, set);
}

void TagMerger::put(std::size_t tag, std::int64_t cycle, const wire::TagSet& set) {
  Tag& t = tags_[tag];
  if (cycle < out_ || cycle <= t.last_cycle || cycle - out_ >= static_cast<std::int64_t>(kRing)) {
    if (cycle - out_ < static_cast<std::int64_t>(kRing)) {
      ++t.counters.late;
      return;
    }
    // Nobody took the frames in between, or all tags were away: go on from here.
    for (Slot& slot : ring_) slot.cycle = -1;
    out_ = cycle;
  }
  Slot& slot = ring_[static_cast<std::size_t>(cycle) % kRing];
  if (slot.cycle != cycle) {
    slot.cycle = cycle;
    slot.delivered = 0;
    std::fill(slot.frame.values.begin(), slot.frame.values.end(), wire::kNoValue);
  }
  std::copy(
      set.values.begin(), set.values.end(),
      slot.frame.values.begin() + static_cast<std::ptrdiff_t>(t.first_detector * projectors_));
  slot.delivered |= std::uint64_t{1} << tag;
  t.last_cycle = cycle;
  newest_ = std::max(newest_, cycle);
  ++t.counters.sets;
}

bool TagMerger::next(std::int64_t now_ns, ProjectorFrame& frame) {
  if (clock_ == Clock::kArrival && !started_) lock(now_ns, false);
  const double line = clock_ == Clock::kArrival ? origin() : 0.0;
  while (started_ && out_ <= newest_) {
    Slot& slot = ring_[static_cast<std::size_t>(out_) % kRing];
    const bool there = slot.cycle == out_;
    bool whole = true;
    for (std::size_t i = 0; i < tags_.size(); ++i) {
      if (there && (slot.delivered >> i & 1U) != 0) continue;
      // A tag that is past this cycle has lost it; one that is away is not waited for.
      const bool expected =
          clock_ == Clock::kCount ? !tags_[i].finished : tags_[i].locked && alive(i);
      whole = whole && !(expected && tags_[i].last_cycle < out_);
    }
    if (!whole) {
      if (clock_ == Clock::kCount) return false;
      const double waited =
          static_cast<double>(now_ns) - line - static_cast<double>(out_) * period();
      if (waited < static_cast<double>(kPatienceNs)) return false;
    }
    for (std::size_t i = 0; i < tags_.size(); ++i) {
      if (!there || (slot.delivered >> i & 1U) == 0) ++tags_[i].counters.missing;
    }
    const std::int64_t cycle = out_++;
    if (!there) continue;  // nobody received anything: the frame's number tells of the gap
    slot.frame.cycle = static_cast<std::uint64_t>(cycle);
    // The set of a cycle is sent when the cycle is over.
    slot.frame.stamp_ns =
        static_cast<std::int64_t>(line) + (cycle - 1) * wire::cycle_ns(projectors_);
    if (clock_ == Clock::kCount) slot.frame.stamp_ns = cycle * wire::cycle_ns(projectors_);
    std::swap(frame, slot.frame);
    if (slot.frame.values.size() != frame.values.size()) {
      slot.frame = ProjectorFrame(detectors_, projectors_);
    }
    slot.cycle = -1;
    return true;
  }
  return false;
}

std::optional<std::size_t> TagMerger::wanted() const noexcept {
  std::optional<std::size_t> behind;
  for (std::size_t i = 0; i < tags_.size(); ++i) {
    if (tags_[i].finished) continue;
    if (!behind || tags_[i].last_cycle < tags_[*behind].last_cycle) behind = i;
  }
  return behind;
}

}  // namespace secondskin::server
