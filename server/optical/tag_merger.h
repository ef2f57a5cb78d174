#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "server/optical/projector_frame.h"
#include "wire/photo_tag.h"

/// Puts the sets of several tags into frames of whole projector cycles.
///
/// A tag's stream does not number its sets, a burst of lost bytes can swallow one without a trace,
/// and the radio link delays each by anything up to 15 ms (Second Skin, 2.3), nearly a cycle. But
/// the projectors' clock is steady and bytes are never early: the earliest arrivals lie on a line,
/// arrival = origin + cycle * period, that a lower envelope finds; a set that comes later after its
/// line than the link can delay it is of a later cycle. One thread; no allocation after
/// construction.
namespace secondskin::server {

/// How a tag fares, from the beginning.
struct TagMergeCounters {
  std::uint64_t sets = 0;     ///< put into frames
  std::uint64_t missing = 0;  ///< cycles without a whole set of this tag
  std::uint64_t late = 0;     ///< sets that came after their frame had gone out, or doubted ones
};

class TagMerger {
 public:
  /// Whether sets have times of arrival, or come from a file and are only counted.
  enum class Clock { kArrival, kCount };

  static constexpr std::size_t kLockSets = 32;  ///< sets of each tag that the first lock waits for
  /// Beyond the earliest arrival a frame waits so long for a tag that has not delivered.
  static constexpr std::int64_t kPatienceNs = 18'000'000;
  /// So many arrivals make the envelope: two seconds, in which two quartzes drift apart by some
  /// tenths of a millisecond.
  static constexpr std::size_t kEnvelopeSets = 128;

  /// @param detectors  of each tag, 1 to wire::kDetectorsOnATag; at least one tag
  /// @throws std::invalid_argument
  TagMerger(std::vector<std::size_t> detectors, std::size_t projectors, Clock clock);

  std::size_t tags() const noexcept { return tags_.size(); }
  std::size_t detectors() const noexcept { return detectors_; }
  std::size_t projectors() const noexcept { return projectors_; }

  /// Takes a tag's next set; sets of a tag in the order of their arrival. A set of another size
  /// than the tag's is ignored.
  void add(std::size_t tag, const wire::TagSet& set);
  /// No more sets will come of this tag.
  void finish(std::size_t tag) noexcept { tags_[tag].finished = true; }

  /// The next frame that is whole, or that has waited long enough; detectors in the order of tags.
  /// Values of a tag that did not deliver are wire::kNoValue. Its stamp is on the clock of the
  /// arrivals: when the cycle began, had the bytes taken no time.
  [[nodiscard]] bool next(std::int64_t now_ns, ProjectorFrame& frame);

  /// With Clock::kCount: the tag whose bytes are wanted next; empty when all have finished.
  std::optional<std::size_t> wanted() const noexcept;

  const TagMergeCounters& counters(std::size_t tag) const noexcept { return tags_[tag].counters; }
  /// Whether the tag has delivered of late.
  bool alive(std::size_t tag) const noexcept;

 private:
  static constexpr std::size_t kRing = 128;         // cycles that may be in work at once
  static constexpr std::uint64_t kAliveCycles = 8;  // a tag that missed so many is not waited for
  static constexpr std::int64_t kRelockNs = 60'000'000'000;  // silence after which drift blurs

  struct Tag {
    std::size_t detectors = 0;
    std::size_t first_detector = 0;
    bool locked = false;
    bool finished = false;
    std::int64_t shift = 0;                        // cycle = set number + shift
    std::array<double, kEnvelopeSets> arrivals{};  // arrival - cycle * period, the last ones
    std::size_t next_arrival = 0;
    double envelope_ns = 0.0;  // the least of them
    std::int64_t last_cycle = -1;
    std::int64_t last_arrival = 0;
    std::vector<wire::TagSet> held;  // until the lock
    std::size_t holds = 0;
    TagMergeCounters counters;
  };
  struct Slot {
    std::int64_t cycle = -1;
    ProjectorFrame frame;
    std::uint64_t delivered = 0;  // a bit a tag
  };

  double period() const noexcept { return static_cast<double>(wire::cycle_ns(projectors_)); }
  void lock(std::int64_t now_ns, bool impatient);
  void release(std::size_t tag);
  void place(std::size_t tag, const wire::TagSet& set);
  void note_arrival(Tag& tag, double since_cycle_ns) noexcept;
  void put(std::size_t tag, std::int64_t cycle, const wire::TagSet& set);
  double origin() const noexcept;

  std::vector<Tag> tags_;
  std::size_t detectors_ = 0;
  std::size_t projectors_;
  Clock clock_;
  bool started_ = false;
  std::int64_t out_ = 0;      // the next cycle to give out
  std::int64_t newest_ = -1;  // the newest cycle of any tag
  std::vector<Slot> ring_;
};

}  // namespace secondskin::server
