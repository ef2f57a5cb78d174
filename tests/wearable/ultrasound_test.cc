#include "server/wearable/signal/ultrasound.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <numbers>
#include <random>
#include <vector>

namespace secondskin::server {
namespace {

constexpr double kRate = 140e3, kCarrier = 40e3;
constexpr std::size_t kSlot = 1120;
constexpr double kStrength = 3000.0;  // amplitude at 1 m [A/D counts]

// Ten cycles through a resonator of 2 kHz bandwidth, as a transducer sends them: envelope rises for
// 250 us towards 1, then rings down.
double pulse(double t) {
  if (t <= 0.0) return 0.0;
  constexpr double kFall = std::numbers::pi * 2000.0, kLength = 10.0 / kCarrier;
  const double rise = 1.0 - std::exp(-kFall * std::min(t, kLength));
  const double envelope = t < kLength ? rise : rise * std::exp(-kFall * (t - kLength));
  return envelope * std::sin(2.0 * std::numbers::pi * kCarrier * t);
}

struct Path {
  double length;  // [m]
  double gain = 1.0;
};

std::vector<std::int16_t> slot_of(const std::vector<Path>& paths, double noise, double temperature,
                                  std::mt19937& random) {
  std::normal_distribution<double> gauss;
  std::vector<std::int16_t> signal(kSlot);
  for (std::size_t n = 0; n < kSlot; ++n) {
    double x = noise > 0.0 ? noise * gauss(random) : 0.0;
    for (const auto& path : paths) {
      const double t = static_cast<double>(n) / kRate - path.length / speed_of_sound(temperature);
      x += path.gain * kStrength / path.length * pulse(t);
    }
    signal[n] = static_cast<std::int16_t>(std::lround(std::clamp(x, -32768.0, 32767.0)));
  }
  return signal;
}

class Ultrasound : public testing::Test {
 protected:
  // As the calibration does: at a known distance.
  double offset(double temperature = 20.0) {
    ArrivalFinder finder(kRate, kCarrier, kSlot);
    const auto arrival = finder.find(slot_of({{0.6}}, 0.0, temperature, random_));
    return arrival->inflection - 0.6 * kRate / speed_of_sound(temperature);
  }
  std::optional<double> distance(const std::vector<Path>& paths, double noise = 3.0,
                                 double temperature = 20.0) {
    ArrivalFinder finder(kRate, kCarrier, kSlot);
    (void)finder.find(slot_of({}, noise, temperature, random_));  // hears the room
    const auto arrival = finder.find(slot_of(paths, noise, temperature, random_));
    if (!arrival) return std::nullopt;
    return (arrival->inflection - offset_) * speed_of_sound(temperature) / kRate;
  }
  std::mt19937 random_{1};
  double offset_ = offset();
};

TEST(SpeedOfSound, IsThatOfTheTables) {
  EXPECT_DOUBLE_EQ(speed_of_sound(0.0), 331.3);
  EXPECT_NEAR(speed_of_sound(20.0), 343.2, 0.1);
  EXPECT_NEAR(speed_of_sound(20.0) * 0.008, 2.75, 0.01);  // 4.1: a slot is 2.75 m
}

TEST_F(Ultrasound, InflectionIsSomeFortySamplesAfterThePulsesStart) {
  // 4.1: "about 40"; the transducer's attack decides.
  EXPECT_GT(offset_, 10.0);
  EXPECT_LT(offset_, 50.0);
}

TEST_F(Ultrasound, DistanceIsRightToAMillimetreWhereTheSignalIsStrong) {
  for (double d = 0.12; d < 2.2; d += 0.00731) {
    const auto got = distance({{d}});
    ASSERT_TRUE(got) << d;
    EXPECT_NEAR(*got, d, 1e-3);
  }
}

TEST_F(Ultrasound, ErrorGrowsWithTheNoiseAndIsWithoutBias) {
  double sum = 0.0, square = 0.0;
  const int n = 400;
  for (int i = 0; i < n; ++i) {
    const auto got = distance({{1.0}}, 300.0);  // a tenth of the amplitude
    ASSERT_TRUE(got);
    sum += *got - 1.0;
    square += (*got - 1.0) * (*got - 1.0);
  }
  EXPECT_LT(std::abs(sum / n), 1e-3);
  EXPECT_LT(std::sqrt(square / n), 0.008);
}

TEST_F(Ultrasound, TemperatureIsCompensated) {
  for (const double temperature : {-10.0, 0.0, 35.0}) {
    const auto got = distance({{1.5}}, 3.0, temperature);
    ASSERT_TRUE(got);
    EXPECT_NEAR(*got, 1.5, 1e-3) << temperature;
  }
}

TEST_F(Ultrasound, FirstArrivalIsChosenOverAStrongerEcho) {
  for (double gain = 1.5; gain <= 4.0; gain += 0.5) {
    const auto got = distance({{0.8}, {1.2, gain * 1.2 / 0.8}, {1.9, 2.0}});
    ASSERT_TRUE(got);
    EXPECT_NEAR(*got, 0.8, 0.003) << gain;
  }
}

TEST_F(Ultrasound, LateEchoOfTheSlotBeforeIsPassedOver) {
  // 2.75 m + 0.7 m from the pulse before, off a wall.
  std::mt19937 random(3);
  auto slot = slot_of({{1.4}}, 3.0, 20.0, random);
  const double late = 0.7;
  for (std::size_t n = 0; n < kSlot; ++n) {
    const double t = static_cast<double>(n) / kRate - late / speed_of_sound(20.0);
    slot[n] = static_cast<std::int16_t>(slot[n] + 0.4 * kStrength / (2.75 + late) * pulse(t));
  }
  ArrivalFinder finder(kRate, kCarrier, kSlot);
  const auto arrival = finder.find(slot);
  ASSERT_TRUE(arrival);
  EXPECT_NEAR((arrival->inflection - offset_) * speed_of_sound(20.0) / kRate, 1.4, 0.002);
}

TEST_F(Ultrasound, NoiseAloneGivesNoArrival) {
  std::mt19937 random(4);
  for (const double noise : {0.0, 0.4, 3.0, 300.0, 20'000.0}) {
    ArrivalFinder finder(kRate, kCarrier, kSlot);
    for (int i = 0; i < 300; ++i) {
      EXPECT_FALSE(finder.find(slot_of({}, noise, 20.0, random))) << noise << " at " << i;
    }
  }
}

TEST_F(Ultrasound, NothingIsFoundBeforeTheEarliest) {
  std::mt19937 random(5);
  ArrivalFinder finder(kRate, kCarrier, kSlot);
  const auto slot = slot_of({{0.4}, {1.3, 0.8}}, 3.0, 20.0, random);
  const double earliest = 0.8 * kRate / speed_of_sound(20.0);
  const auto arrival = finder.find(slot, earliest);
  ASSERT_TRUE(arrival);
  EXPECT_NEAR((arrival->inflection - offset_) * speed_of_sound(20.0) / kRate, 1.3, 0.002);
}

TEST_F(Ultrasound, AnySignalGivesFiniteNumbers) {
  std::mt19937 random(6);
  ArrivalFinder finder(kRate, kCarrier, kSlot);
  DistanceTracker tracker;
  std::vector<std::int16_t> slot(kSlot);
  for (int i = 0; i < 400; ++i) {
    const int kind = static_cast<int>(random() % 5);
    for (std::size_t n = 0; n < kSlot; ++n) {
      const auto any = static_cast<std::int16_t>(random());
      slot[n] = kind == 0   ? std::int16_t{32767}
                : kind == 1 ? std::int16_t{0}
                : kind == 2 ? any
                : kind == 3 ? static_cast<std::int16_t>(n % 7 < 3 ? 32767 : -32768)
                            : static_cast<std::int16_t>(n == random() % kSlot ? any : 0);
    }
    const auto arrival = finder.find(slot);
    ASSERT_TRUE(std::isfinite(finder.noise()));
    if (!arrival) continue;
    const auto result = tracker.add(*arrival, 0.064 * i, {}, 343.0 / kRate);
    ASSERT_TRUE(std::isfinite(result.distance));
    ASSERT_GE(result.w_s * result.w_t, 0.0);
    ASSERT_LE(result.w_s * result.w_t, 1.0);
  }
}

TEST(Confidence, FollowsSection41) {
  // w_s: one above the threshold, falling with the squared inverse of what is missing.
  EXPECT_EQ(signal_confidence(1.0), 1.0);
  EXPECT_EQ(signal_confidence(DistanceTracker::kStrong), 1.0);
  EXPECT_NEAR(signal_confidence(DistanceTracker::kStrong * (1.0 - DistanceTracker::kWeakness)), 0.5,
              1e-12);
  EXPECT_LT(signal_confidence(0.0), 0.1);
  for (double share = 0.0; share < 0.2; share += 0.01) {
    EXPECT_LE(signal_confidence(share), signal_confidence(share + 0.01));
  }
  // w_t: one within a threshold, then down to zero.
  EXPECT_EQ(continuity_confidence(0.0), 1.0);
  EXPECT_EQ(continuity_confidence(-DistanceTracker::kSteadySpeed), 1.0);
  EXPECT_EQ(continuity_confidence(DistanceTracker::kJumpSpeed), 0.0);
  EXPECT_EQ(continuity_confidence(1e9), 0.0);
}

TEST(DistanceTracker, DistrustsAJumpAndWeakSound) {
  const SourceCalibration source{40.0, 9e6};
  const double metres = 343.2 / kRate;
  const auto arrival_at = [&](double d, double share) {
    return Arrival{d / metres + source.offset, share * source.strength / (d * d), 1.0};
  };
  DistanceTracker tracker;
  EXPECT_EQ(tracker.add(arrival_at(0.5, 1.0), 0.0, source, metres).w_t,
            DistanceTracker::kUnknownContinuity);
  const auto steady = tracker.add(arrival_at(0.55, 0.5), 0.064, source, metres);
  EXPECT_NEAR(steady.distance, 0.55, 1e-9);
  EXPECT_EQ(steady.w_t, 1.0);
  EXPECT_EQ(steady.w_s, 1.0);
  EXPECT_EQ(tracker.add(arrival_at(1.3, 1.0), 0.128, source, metres).w_t, 0.0);
  EXPECT_EQ(tracker.add(arrival_at(1.31, 1.0), 0.192, source, metres).w_t, 1.0);
  EXPECT_LT(tracker.add(arrival_at(1.31, 0.01), 0.256, source, metres).w_s, 0.15);
  EXPECT_EQ(tracker.add(arrival_at(1.31, 1.0), 1.0, source, metres).w_t,
            DistanceTracker::kUnknownContinuity);
}

}  // namespace
}  // namespace secondskin::server
