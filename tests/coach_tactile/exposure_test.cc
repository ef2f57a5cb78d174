#include "coach/tactile/exposure.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <fstream>
#include <random>

#include "coach/tactile/exposure_file.h"
#include "wire/tactor_waveform.h"

namespace secondskin::coach {
namespace {

constexpr double kLife = 0.060;
constexpr std::int64_t kFrame_ns = 16'000'000;

BodyMap map_of(wire::Actuator actuator, double acceleration) {
  BodyMap map;
  map.tactors = {{.channel = 3,
                  .segment = Joint::kLeftElbow,
                  .actuator = actuator,
                  .acceleration = acceleration}};
  return map;
}

wire::BoardState on(std::size_t slot, std::uint8_t intensity = wire::kStrongestIntensity) {
  wire::BoardState board{};
  board[slot] = intensity;
  return board;
}

TEST(Exposure, MeansWhatTheBoardRenders) {
  std::mt19937 generator(1);
  for (std::size_t slot = 0; slot < wire::kSlotCount; ++slot) {
    const auto intensity = static_cast<std::uint8_t>(
        wire::kFaintestIntensity +
        generator() % (wire::kStrongestIntensity - wire::kFaintestIntensity + 1u));
    const wire::BoardState board = on(slot, intensity);
    wire::BoardPatterns patterns;
    patterns.apply({slot, intensity}, 0.0);
    std::array<double, wire::kTactorCount> level{}, square{}, share{};
    constexpr int kSamples = 60'000;
    for (int i = 0; i < kSamples; ++i) {
      patterns.drive(0.001 * i, level);
      for (std::size_t c = 0; c < level.size(); ++c) {
        square[c] += level[c] * level[c] / kSamples;
        share[c] += (level[c] > 0.0 ? 1.0 : 0.0) / kSamples;
      }
    }
    for (std::size_t c = 0; c < level.size(); ++c) {
      EXPECT_NEAR(mean_drive(board, c).square, square[c], 0.01) << slot;
      EXPECT_NEAR(mean_drive(board, c).on, share[c], 0.01) << slot;
    }
  }
}

// ISO 5349-1: A(8) = a sqrt(T / 8 h); at the limit itself eight hours are allowed, at twice it two.
TEST(Exposure, AllowsTheDailyDoseOfIso5349) {
  for (const auto& [acceleration, hours] : {std::pair(2.5, 8.0), std::pair(5.0, 2.0)}) {
    const BodyMap map = map_of(wire::Actuator::kDcMotor, acceleration);
    EXPECT_NEAR(daily_exposure(map.tactors[0], 3600.0 * hours), kDailyExposure, 1e-12);
    ExposureState used;
    used.sites[3].dose = 0.89 * 3600.0 * hours;
    EXPECT_FALSE(ExposureLimiter(map, used).rests(3, false));
    used.sites[3].dose = 0.91 * 3600.0 * hours;  // the rest of the day is for alarms
    EXPECT_TRUE(ExposureLimiter(map, used).rests(3, false));
    EXPECT_FALSE(ExposureLimiter(map, used).rests(3, true));
    used.sites[3].dose = 3600.0 * hours;
    EXPECT_TRUE(ExposureLimiter(map, used).rests(3, true));
  }
}

TEST(Exposure, CountsACommandNoLongerThanItLived) {
  ExposureLimiter limiter(map_of(wire::Actuator::kVoiceCoil, 6.0));
  limiter.advance(kFrame_ns, {}, kLife);
  limiter.advance(2 * kFrame_ns, on(3), kLife);
  EXPECT_NEAR(limiter.state().sites[3].dose, 0.016, 1e-9);
  limiter.advance(3'600'000'000'000, on(3), kLife);
  EXPECT_NEAR(limiter.state().sites[3].dose, 0.016 + kLife, 1e-9);
  EXPECT_LT(limiter.state().sites[3].heat, 1e-9);
  limiter.advance(1, on(3), kLife);  // a clock that went back
  EXPECT_NEAR(limiter.state().sites[3].dose, 0.016 + kLife, 1e-9);
  EXPECT_EQ(limiter.state().sites[2].dose, 0.0);
}

TEST(Exposure, LetsAHotOrTiredSiteRestUntilItHasRecovered) {
  for (const auto actuator : {wire::Actuator::kVoiceCoil, wire::Actuator::kDcMotor}) {
    ExposureLimiter limiter(map_of(actuator, 1.0));
    std::int64_t stamp = kFrame_ns;
    const auto run_until = [&](bool rests, const wire::BoardState& board) {
      const std::int64_t begin = stamp;
      while (limiter.rests(3, false) != rests && stamp - begin < 300'000'000'000) {
        limiter.advance(stamp += kFrame_ns, board, kLife);
      }
      return 1e-9 * static_cast<double>(stamp - begin);
    };
    limiter.advance(stamp, {}, kLife);
    const double on_for = run_until(true, on(3));
    // Closed forms: 1 - exp(-t / tau) reaches the limit.
    const double tired = -kDutyWindow * std::log(1.0 - kLongestDuty);
    const double hot = -kHeatWindow * std::log(1.0 - kHottest / kHeatAtFull);
    EXPECT_NEAR(on_for, actuator == wire::Actuator::kVoiceCoil ? std::min(hot, tired) : tired, 0.1);
    EXPECT_GT(run_until(false, {}), 5.0);
    // Half the time on is never too much.
    EXPECT_NEAR(run_until(true, on(wire::pulsed_slot(3))), 300.0, 0.1);
  }
}

class Files : public testing::Test {
 protected:
  void SetUp() override { std::filesystem::remove(file_); }
  std::filesystem::path file_ =
      std::filesystem::path(testing::TempDir()) /
      (std::string("secondskin_exposure_") +
       testing::UnitTest::GetInstance()->current_test_info()->name() + ".toml");
};
using ExposureFile = Files;

TEST_F(ExposureFile, KeepsADayAndForgetsTheLast) {
  const BodyMap map = map_of(wire::Actuator::kVoiceCoil, 6.0);
  EXPECT_EQ(load_exposure(file_, map, "2026-01-01").sites[3].dose, 0.0);
  ExposureState state;
  state.stamp_ns = 1'700'000'000'123'456'789;
  state.sites[3] = {12.345678901234567, 0.25, 3.5};
  save_exposure(file_, map, state, "2026-01-01");
  const ExposureState again = load_exposure(file_, map, "2026-01-01");
  EXPECT_EQ(again.stamp_ns, state.stamp_ns);
  EXPECT_EQ(again.sites[3].dose, state.sites[3].dose);
  EXPECT_EQ(again.sites[3].duty, state.sites[3].duty);
  EXPECT_EQ(again.sites[3].heat, state.sites[3].heat);
  EXPECT_EQ(load_exposure(file_, map, "2026-01-02").sites[3].dose, 0.0);
}

TEST_F(ExposureFile, FindsTheSameSkinUnderAnotherMap) {
  BodyMap map = map_of(wire::Actuator::kVoiceCoil, 6.0);
  ExposureState state;
  state.sites[3].dose = 50.0;
  save_exposure(file_, map, state, "d");
  map.tactors[0].channel = 7;
  map.tactors[0].angle = 0.5;
  map.tactors[0].along = 0.6;
  EXPECT_EQ(load_exposure(file_, map, "d").sites[7].dose, 50.0);
  map.tactors[0].segment = Joint::kRightElbow;
  EXPECT_EQ(load_exposure(file_, map, "d").sites[7].dose, 0.0);
  // A session on the other arm does not wipe the first one's.
  ExposureState other;
  other.sites[7].dose = 20.0;
  save_exposure(file_, map, other, "d");
  EXPECT_EQ(load_exposure(file_, map, "d").sites[7].dose, 20.0);
  EXPECT_EQ(load_exposure(file_, map_of(wire::Actuator::kVoiceCoil, 6.0), "d").sites[3].dose, 50.0);
}

TEST_F(ExposureFile, SaysWhatIsWrong) {
  std::ofstream(file_) << "day = \"d\"\nstamp_ns = 1\n[[site]]\nsegment = \"tail\"\n";
  try {
    (void)load_exposure(file_, map_of(wire::Actuator::kVoiceCoil, 6.0), "d");
    FAIL();
  } catch (const std::runtime_error& error) {
    EXPECT_THAT(error.what(), testing::HasSubstr(".toml:4: segment: expected a canonical segment"));
  }
}

}  // namespace
}  // namespace secondskin::coach
