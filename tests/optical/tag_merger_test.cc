#include "server/optical/tag_merger.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <limits>
#include <map>
#include <random>

namespace secondskin::server {
namespace {

constexpr std::size_t kProjectors = 16;
constexpr std::int64_t kPeriod = wire::cycle_ns(kProjectors);

// Every value says which cycle and which detector it is of.
std::uint8_t expected_value(std::uint64_t cycle, std::size_t detector) {
  return static_cast<std::uint8_t>(1 + (cycle * 7 + detector * 31) % 254);
}

wire::TagSet make_set(std::uint64_t number, std::uint64_t cycle, std::size_t first_detector,
                      std::size_t detectors, std::int64_t arrival_ns) {
  wire::TagSet set{number, arrival_ns, {}};
  for (std::size_t d = 0; d < detectors; ++d) {
    set.values.insert(set.values.end(), kProjectors, expected_value(cycle, first_detector + d));
  }
  return set;
}

struct Arrival {
  std::int64_t at;
  std::size_t tag;
  std::uint64_t number;
  std::uint64_t cycle;
};

// What arrives of `cycles` cycles of two tags over a link that delays each set by up to `jitter`
// and keeps their order. `lost(tag, cycle)` sets leave no trace.
template <class Lost>
std::vector<Arrival> radio(std::uint64_t cycles, std::int64_t jitter, double drift, unsigned seed,
                           Lost lost) {
  std::mt19937_64 random(seed);
  std::uniform_int_distribution<std::int64_t> delay(0, jitter);
  std::vector<Arrival> arrivals;
  for (std::size_t tag = 0; tag < 2; ++tag) {
    std::int64_t before = 0;
    std::uint64_t number = 0;
    for (std::uint64_t c = 0; c < cycles; ++c) {
      const auto sent =
          static_cast<std::int64_t>(5'000'000'000.0 + (1.0 + drift) * static_cast<double>(kPeriod) *
                                                          static_cast<double>(c + 1));
      before = std::max(before, sent + delay(random));
      if (lost(tag, c)) continue;
      arrivals.push_back({before, tag, number++, c});
    }
  }
  std::stable_sort(arrivals.begin(), arrivals.end(),
                   [](const Arrival& a, const Arrival& b) { return a.at < b.at; });
  return arrivals;
}

// Runs arrivals through a merger for two tags of 2 and 3 detectors, looking every millisecond.
std::vector<ProjectorFrame> merge(TagMerger& merger, const std::vector<Arrival>& arrivals) {
  std::vector<ProjectorFrame> frames;
  ProjectorFrame frame;
  std::int64_t now = arrivals.front().at;
  for (const auto& arrival : arrivals) {
    for (; now < arrival.at; now += 1'000'000) {
      while (merger.next(now, frame)) frames.push_back(frame);
    }
    const std::size_t first = arrival.tag == 0 ? 0 : 2;
    merger.add(arrival.tag,
               make_set(arrival.number, arrival.cycle, first, 2 + arrival.tag, arrival.at));
    while (merger.next(arrival.at, frame)) frames.push_back(frame);
  }
  while (merger.next(now + 1'000'000'000, frame)) frames.push_back(frame);
  return frames;
}

// Frames whose values are not all of one cycle, that one being the frame's plus a constant.
std::size_t mixed(const std::vector<ProjectorFrame>& frames) {
  std::size_t wrong = 0;
  for (const auto& frame : frames) {
    for (std::size_t d = 0; d < frame.detectors; ++d) {
      const auto value = frame.value(d, 3);
      wrong += value != wire::kNoValue && value != expected_value(frame.cycle, d) ? 1 : 0;
    }
  }
  return wrong;
}

TEST(TagMerger, PutsSetsOfOneCycleTogetherThoughTheLinkDelaysThemByNearlyACycle) {
  for (unsigned seed = 0; seed < 20; ++seed) {
    TagMerger merger({2, 3}, kProjectors, TagMerger::Clock::kArrival);
    const auto frames =
        merge(merger, radio(2000, 15'000'000, 50e-6, seed, [](auto, auto) { return false; }));
    ASSERT_EQ(frames.size(), 2000u) << "seed " << seed;
    EXPECT_EQ(mixed(frames), 0u) << "seed " << seed;
    for (std::size_t i = 0; i < frames.size(); ++i) ASSERT_EQ(frames[i].cycle, i);
  }
}

TEST(TagMerger, StampsFramesWithinTheTimeThatTheClocksDrift) {
  TagMerger merger({2, 3}, kProjectors, TagMerger::Clock::kArrival);
  const auto frames =
      merge(merger, radio(4000, 15'000'000, 100e-6, 3, [](auto, auto) { return false; }));
  for (const auto& frame : frames) {
    const double truth =
        5e9 + 1.0001 * static_cast<double>(kPeriod) * static_cast<double>(frame.cycle);
    ASSERT_NEAR(static_cast<double>(frame.stamp_ns), truth, 2e6) << frame.cycle;
  }
}

TEST(TagMerger, KnowsTheCycleAfterSetsVanishedWithoutATrace) {
  std::size_t wrong = 0, frames = 0;
  for (unsigned seed = 0; seed < 20; ++seed) {
    std::mt19937_64 random(seed + 100);
    std::map<std::pair<std::size_t, std::uint64_t>, bool> drawn;
    const auto lost = [&](std::size_t tag, std::uint64_t cycle) {
      return cycle > 64 && random() % 20 == 0 && drawn.emplace(std::pair{tag, cycle}, true).second;
    };
    TagMerger merger({2, 3}, kProjectors, TagMerger::Clock::kArrival);
    const auto got = merge(merger, radio(2000, 15'000'000, -50e-6, seed, lost));
    frames += got.size();
    wrong += mixed(got);
  }
  // Where the earliest line is known to half a millisecond only, a loss can hide in it: one in
  // 10,000.
  EXPECT_LE(wrong, 5 * frames / 10'000) << "of " << frames;
  EXPECT_GT(frames, 39'000u);
}

TEST(TagMerger, GoesOnWithoutATagThatIsUnpluggedAndTakesItBackInTheRightCycle) {
  const auto away = [](std::size_t tag, std::uint64_t cycle) {
    return tag == 1 && cycle > 500 && cycle < 1500;
  };
  TagMerger merger({2, 3}, kProjectors, TagMerger::Clock::kArrival);
  const auto frames = merge(merger, radio(2000, 12'000'000, 0.0, 7, away));
  ASSERT_EQ(frames.size(), 2000u);
  EXPECT_EQ(mixed(frames), 0u);
  EXPECT_EQ(frames[1000].value(2, 0), wire::kNoValue);
  EXPECT_NE(frames[1000].value(0, 0), wire::kNoValue);
  EXPECT_NE(frames[1999].value(4, 0), wire::kNoValue);
  EXPECT_NEAR(static_cast<double>(merger.counters(1).missing), 999.0, 2.0);
  EXPECT_TRUE(merger.alive(0));
}

TEST(TagMerger, BeginsWithoutATagThatNeverComes) {
  const auto never = [](std::size_t tag, std::uint64_t) { return tag == 0; };
  TagMerger merger({2, 3}, kProjectors, TagMerger::Clock::kArrival);
  const auto frames = merge(merger, radio(500, 15'000'000, 0.0, 1, never));
  EXPECT_GT(frames.size(), 400u);
  EXPECT_FALSE(merger.alive(0));
  EXPECT_EQ(frames.back().value(0, 0), wire::kNoValue);
}

TEST(TagMerger, FollowsProjectorsThatWereSwitchedOffAndOnAgain) {
  auto arrivals = radio(1500, 15'000'000, 0.0, 11, [](auto, auto) { return false; });
  for (auto& arrival : arrivals) {
    if (arrival.cycle >= 700) arrival.at += 3 * kPeriod + kPeriod * 6 / 10;  // another phase
  }
  TagMerger merger({2, 3}, kProjectors, TagMerger::Clock::kArrival);
  const auto frames = merge(merger, arrivals);
  // A second later tags and cycles are in step again.
  std::size_t torn = 0;
  for (std::size_t i = frames.size() - 600; i < frames.size(); ++i) {
    const auto& f = frames[i];
    bool whole = true;
    for (std::size_t d = 0; d < 5; ++d) whole = whole && f.value(d, 0) != wire::kNoValue;
    torn += whole ? 0 : 1;
  }
  EXPECT_EQ(torn, 0u);
}

TEST(TagMerger, CountsTheSetsOfFiles) {
  TagMerger merger({2, 3}, kProjectors, TagMerger::Clock::kCount);
  ProjectorFrame frame;
  std::vector<ProjectorFrame> frames;
  std::array<std::uint64_t, 2> at{0, 0};
  while (const auto tag = merger.wanted()) {
    const std::size_t t = *tag;
    if (at[t] == (t == 0 ? 300u : 200u)) {
      merger.finish(t);
    } else {
      if (at[t] != 50) merger.add(t, make_set(at[t], at[t], t == 0 ? 0 : 2, 2 + t, 0));
      ++at[t];
    }
    while (merger.next(0, frame)) frames.push_back(frame);
  }
  EXPECT_EQ(frames.size(), 299u);  // both tags lost set 50
  EXPECT_EQ(mixed(frames), 0u);
  EXPECT_EQ(frames[10].stamp_ns, 10 * kPeriod);
  EXPECT_EQ(merger.counters(1).missing, 101u);
}

TEST(TagMerger, IgnoresASetOfAnotherSize) {
  TagMerger merger({2}, kProjectors, TagMerger::Clock::kCount);
  merger.add(0, wire::TagSet{0, 0, {1, 2, 3}});
  ProjectorFrame frame;
  EXPECT_FALSE(merger.next(0, frame));
}

TEST(TagMerger, RefusesWhatCannotBe) {
  using Clock = TagMerger::Clock;
  EXPECT_THROW(TagMerger({}, 16, Clock::kCount), std::invalid_argument);
  EXPECT_THROW(TagMerger({19}, 16, Clock::kCount), std::invalid_argument);
  EXPECT_THROW(TagMerger({18}, 0, Clock::kCount), std::invalid_argument);
}

}  // namespace
}  // namespace secondskin::server
