#include "server/optical/calibrate/value_sync.h"

#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <random>
#include <stdexcept>

#include "wire/photo_tag.h"

namespace secondskin::server {
namespace {

constexpr std::size_t kProjectors = 16;

// One detector that receives value(projector, t), each at its slot's time.
ProjectorFrame frame_at(std::uint64_t cycle,
                        const std::function<double(std::size_t, double)>& value) {
  ProjectorFrame frame(1, kProjectors);
  frame.cycle = cycle;
  frame.stamp_ns = 1'000'000'000 + static_cast<std::int64_t>(cycle) * wire::cycle_ns(kProjectors);
  for (std::size_t p = 0; p < kProjectors; ++p) {
    const double t = 1e-9 * static_cast<double>(frame.stamp_ns + wire::value_time_ns(p));
    frame.values[p] = static_cast<std::uint8_t>(std::lround(value(p, t)));
  }
  return frame;
}

// 150 counts/s is a detector at 1 m/s across a projector's field 3.3 m away.
double moving(std::size_t projector, double t) {
  return 100.0 + static_cast<double>(projector) + 150.0 * (t - 1.2) - 200.0 * (t - 1.2) * (t - 1.2);
}

TEST(ValueSync, BringsTheValuesOfAllSlotsToOneInstant) {
  ValueSync sync(1, kProjectors);
  double square = 0.0, worst_unsynced = 0.0;
  int n = 0;
  for (std::uint64_t cycle = 0; cycle < 40; ++cycle) {
    const ProjectorFrame frame = frame_at(cycle, moving);
    const auto out = sync.add(frame);
    ASSERT_EQ(out.has_value(), cycle >= 2 * ValueSync::kReach);
    if (!out) continue;
    EXPECT_EQ(out->cycle, cycle - ValueSync::kReach);
    const double t = 1e-9 * static_cast<double>(out->stamp_ns);
    for (std::size_t p = 0; p < kProjectors; ++p) {
      const auto v = out->value(0, p);
      ASSERT_TRUE(v);
      EXPECT_NEAR(*v, moving(p, t), 0.8);
      square += std::pow(*v - moving(p, t), 2);
      worst_unsynced = std::max(
          worst_unsynced,
          std::fabs(frame.value(0, p) -
                    moving(p, 1e-9 * static_cast<double>(frame.stamp_ns +
                                                         wire::cycle_ns(kProjectors) / 2))));
      ++n;
    }
  }
  // Rounding alone has 0.29 counts; the parabola keeps 0.58 of it. The slots would add over one.
  EXPECT_LT(std::sqrt(square / n), 0.25);
  EXPECT_GT(worst_unsynced, 1.0);
}

TEST(ValueSync, ThrowsWildValuesAway) {
  std::mt19937 random(1);
  std::uniform_real_distribution<double> uniform;
  ValueSync sync(1, kProjectors);
  int given = 0, all = 0;
  for (std::uint64_t cycle = 0; cycle < 300; ++cycle) {
    const auto still = [&](std::size_t, double) {
      return uniform(random) < 0.05 ? 1.0 + 253.0 * uniform(random) : 120.0;
    };
    const auto out = sync.add(frame_at(cycle, still));
    if (!out) continue;
    for (std::size_t p = 0; p < kProjectors; ++p) {
      ++all;
      if (const auto v = out->value(0, p)) {
        ++given;
        EXPECT_NEAR(*v, 120.0, 2.5);
      }
    }
  }
  EXPECT_GT(given, 0.95 * all);
}

TEST(ValueSync, GivesNoValueAtTheEndOfWhatADetectorSees) {
  ValueSync sync(1, kProjectors);
  std::vector<bool> seen;
  for (std::uint64_t cycle = 0; cycle < 30; ++cycle) {
    const auto out =
        sync.add(frame_at(cycle, [&](std::size_t, double) { return cycle < 15 ? 90.0 : 0.0; }));
    if (out) seen.push_back(out->value(0, 3).has_value());
  }
  // Frames 3 to 12 have two values after them; no value is ever guessed beyond the last one.
  for (std::size_t k = 0; k < seen.size(); ++k) EXPECT_EQ(seen[k], k <= 9) << k;
}

TEST(ValueSync, IsNotMisledByAGapInTheCycles) {
  ValueSync sync(1, kProjectors);
  for (std::uint64_t cycle = 0; cycle < 60; ++cycle) {
    if (cycle % 20 == 10 || (cycle >= 30 && cycle < 45)) continue;
    const auto out = sync.add(frame_at(cycle, moving));
    if (!out) continue;
    const double t = 1e-9 * static_cast<double>(out->stamp_ns);
    for (std::size_t p = 0; p < kProjectors; ++p) {
      if (const auto v = out->value(0, p)) {
        EXPECT_NEAR(*v, moving(p, t), 1.0);
      }
    }
  }
}

TEST(ValueSync, IgnoresAFrameThatComesTwice) {
  ValueSync sync(1, kProjectors);
  for (std::uint64_t cycle = 0; cycle < 7; ++cycle) {
    EXPECT_EQ(sync.add(frame_at(cycle, moving)).has_value(), cycle == 6);
    EXPECT_FALSE(sync.add(frame_at(cycle, moving)));
  }
}

TEST(ValueSync, RefusesAFrameOfAnotherShape) {
  ValueSync sync(2, kProjectors);
  EXPECT_THROW(sync.add(ProjectorFrame(1, kProjectors)), std::invalid_argument);
  EXPECT_THROW(sync.add(ProjectorFrame(2, 4)), std::invalid_argument);
  ProjectorFrame torn(2, kProjectors);
  torn.values.pop_back();
  EXPECT_THROW(sync.add(torn), std::invalid_argument);
}

}  // namespace
}  // namespace secondskin::server
