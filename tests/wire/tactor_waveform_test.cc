#include "wire/tactor_waveform.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>
#include <vector>

namespace secondskin::wire {
namespace {

using Levels = std::array<double, kTactorCount>;

Levels drive_at(const BoardPatterns& board, double time) {
  Levels level;
  board.drive(time, level);
  return level;
}

/// The one tactor that is driven; -1 for none, -2 for several.
int driven(const Levels& level) {
  int found = -1;
  for (std::size_t i = 0; i < kTactorCount; ++i) {
    if (level[i] > 0.0) found = found == -1 ? static_cast<int>(i) : -2;
  }
  return found;
}

TEST(BoardPatterns, HoldsAContinuousTactorAtItsLevel) {
  for (std::size_t tactor = 0; tactor < kTactorCount; ++tactor) {
    BoardPatterns board;
    board.apply({continuous_slot(tactor), 150}, 3.0);
    for (double time = 3.0; time < 4.0; time += 0.01) {
      const Levels level = drive_at(board, time);
      ASSERT_EQ(driven(level), static_cast<int>(tactor));
      EXPECT_EQ(level[tactor], drive_of(150).level);
    }
  }
}

TEST(BoardPatterns, PulsesAtFifteenHertzAtFullIntensityBeginningAtOnce) {  // 4.3
  BoardPatterns board;
  board.apply({pulsed_slot(9), 255}, 1.0);
  int starts = 0;
  bool was_on = false;
  double on = 0.0;
  for (int ms10 = 0; ms10 < 10'000; ++ms10) {  // a second in steps of 0.1 ms
    const bool is_on = drive_at(board, 1.0 + ms10 * 1e-4)[9] > 0.0;
    if (is_on && !was_on) ++starts;
    if (is_on) on += 1e-4;
    EXPECT_TRUE(is_on || ms10 > 0);
    was_on = is_on;
  }
  EXPECT_EQ(starts, 15);
  EXPECT_NEAR(on, 0.5, 0.005);
}

TEST(BoardPatterns, TapsEachSaltationSiteTwiceThenTheNextRoundTheLimb) {  // 4.2
  for (std::size_t group = 0; group < 4; ++group) {
    for (const bool reverse : {false, true}) {
      for (const std::uint8_t intensity : {54, 150, 255}) {
        BoardPatterns board;
        board.apply({saltation_slot(group, reverse), intensity}, 0.5);
        const double interval = drive_of(intensity).tap_interval;
        for (int tap = 0; tap < 20; ++tap) {  // two and a half times round
          const int site = tap / 2 % 4;
          const int tactor = static_cast<int>(4 * group) + (reverse ? 3 - site : site);
          const double begin = 0.5 + tap * interval;
          EXPECT_EQ(driven(drive_at(board, begin)), tactor) << "tap " << tap;
          EXPECT_EQ(driven(drive_at(board, begin + kTapDuration - 1e-4)), tactor);
          EXPECT_EQ(driven(drive_at(board, begin + kTapDuration + 1e-4)), -1);
          EXPECT_EQ(driven(drive_at(board, begin + interval - 1e-4)), -1);
        }
      }
    }
  }
}

TEST(BoardPatterns, KeepsThePhaseWhenTheIntensityChanges) {
  // Whatever the rate does, the drive jumps at most where a pulse or tap begins or ends: half a
  // cycle at either rate lies between two edges.
  BoardPatterns board;
  const std::size_t slot = pulsed_slot(0);
  board.apply({slot, 54}, 0.0);                                       // 5 Hz: on to 0.1, off to 0.2
  board.apply({slot, 255}, 0.15);                                     // three quarters through
  EXPECT_EQ(driven(drive_at(board, 0.15)), -1);                       // still off
  EXPECT_EQ(driven(drive_at(board, 0.15 + 0.25 / 15.0 - 1e-4)), -1);  // the last quarter, at 15 Hz
  EXPECT_EQ(driven(drive_at(board, 0.15 + 0.25 / 15.0 + 1e-4)), 0);
  // A refresh with the same value changes nothing at all.
  const BoardPatterns before = board;
  board.apply({slot, 255}, 0.16);
  for (double time = 0.16; time < 0.5; time += 0.001) {
    EXPECT_EQ(drive_at(board, time), drive_at(before, time));
  }
}

TEST(BoardPatterns, KeepsTheSaltationSiteWhenTheIntensityChanges) {
  BoardPatterns board;
  board.apply({saltation_slot(0, false), 54}, 0.0);
  board.apply({saltation_slot(0, false), 255}, 0.120 * 4 + 0.010);  // in the third site's first tap
  EXPECT_EQ(driven(drive_at(board, 0.120 * 4 + 0.011)), 2);
}

TEST(BoardPatterns, RunsTheSaltationDirectionCommandedLast) {
  BoardPatterns board;
  const std::size_t forward = saltation_slot(1, false);
  const std::size_t reverse = saltation_slot(1, true);
  board.apply({forward, 200}, 0.0);
  board.apply({reverse, 100}, 0.3);
  EXPECT_EQ(board.state()[forward], 0);
  EXPECT_EQ(driven(drive_at(board, 0.3)), 7);
  board.apply({forward, 0}, 0.31);  // turning the other off stops nothing
  EXPECT_EQ(board.state()[reverse], 100);
  board.apply({forward, 255}, 0.4);
  EXPECT_EQ(board.state()[reverse], 0);
  EXPECT_EQ(driven(drive_at(board, 0.4)), 4);
}

TEST(BoardPatterns, LetsTheStrongestModeDriveATactorThatSeveralClaim) {
  BoardPatterns board;
  board.apply({continuous_slot(0), 100}, 0.0);
  board.apply({pulsed_slot(0), 255}, 0.0);
  board.apply({saltation_slot(0, false), 180}, 0.0);
  EXPECT_EQ(drive_at(board, 0.001)[0], 1.0);         // the pulse
  EXPECT_EQ(drive_at(board, 0.5 / 15.0 + 0.001)[0],  // between pulses, and between
            drive_of(100).level);                    // taps: the continuous one
  board.apply({pulsed_slot(0), 0}, 0.001);
  EXPECT_EQ(drive_at(board, 0.002)[0], drive_of(180).level);  // the tap
}

TEST(BoardPatterns, StaysWithinTheStrongestCommandAndIsZeroWhenAllIsOff) {
  std::mt19937 random(5);
  std::uniform_int_distribution<std::size_t> slot(0, kSlotCount - 1);
  std::uniform_int_distribution<int> intensity(0, 255);
  BoardPatterns board;
  double time = 0.0;
  for (int n = 0; n < 20'000; ++n) {
    time += 0.003;
    const bool off = n % 3 == 0;
    board.apply({slot(random), static_cast<std::uint8_t>(off ? 0 : intensity(random))}, time);
    if (n % 500 == 499) board.all_off();
    const BoardState& state = board.state();
    const double strongest = drive_of(*std::max_element(state.begin(), state.end())).level;
    const Levels level = drive_at(board, time);
    for (const double l : level) {
      ASSERT_GE(l, 0.0);
      ASSERT_LE(l, strongest);
    }
  }
}

TEST(BoardPatterns, DrivesItsTactorsWithinAPeriodOfEverySlotThatIsOn) {
  for (std::size_t slot = 0; slot < kSlotCount; ++slot) {
    BoardPatterns board;
    board.apply({slot, 54}, 0.0);
    double most = 0.0;
    for (double time = 7.0; time < 7.2; time += 0.001) {  // the slowest pulse takes 0.2 s
      for (const double l : drive_at(board, time)) most = std::max(most, l);
    }
    EXPECT_NEAR(most, 0.30, 1e-12) << "slot " << slot;
    board.apply({slot, 0}, 7.5);
    for (double time = 7.5; time < 8.5; time += 0.001) {
      ASSERT_EQ(driven(drive_at(board, time)), -1);
    }
  }
}

TEST(BoardPatterns, TakesIntensitiesThatCannotBeSentAsOff) {
  BoardPatterns board;
  board.apply({3, 200}, 0.0);
  board.apply({3, 53}, 0.1);
  EXPECT_EQ(board.state()[3], 0);
  board.apply({kSlotCount, 200}, 0.1);  // no such slot
  EXPECT_EQ(board.state(), BoardState{});
}

TEST(ActuatorResponse, ReachesNinetyFivePercentInItsRiseTime) {  // 4.3
  for (const auto& [kind, rise] :
       {std::pair{Actuator::kVoiceCoil, 0.005}, std::pair{Actuator::kDcMotor, 0.100}}) {
    ActuatorResponse actuator(kind);
    double amplitude = 0.0;
    for (int i = 0; i < 50; ++i) amplitude = actuator.step(1.0, rise / 50.0);
    EXPECT_NEAR(amplitude, 0.95, 1e-9);
    ActuatorResponse in_one(kind);  // steps of any length agree
    EXPECT_NEAR(in_one.step(1.0, rise), 0.95, 1e-9);
    for (int i = 0; i < 50; ++i) amplitude = actuator.step(0.0, rise / 50.0);
    EXPECT_NEAR(amplitude, 0.95 * 0.05, 1e-9);  // and stops as fast as it starts
  }
}

TEST(ActuatorResponse, ShowsWhyMotorsCannotPulseFast) {  // 4.3
  const auto swing = [](Actuator kind) {
    BoardPatterns board;
    board.apply({pulsed_slot(0), 255}, 0.0);
    ActuatorResponse actuator(kind);
    double least = 1.0;
    double most = 0.0;
    for (int ms = 0; ms < 1000; ++ms) {
      const double amplitude = actuator.step(drive_at(board, ms * 1e-3)[0], 1e-3);
      if (ms < 500) continue;
      least = std::min(least, amplitude);
      most = std::max(most, amplitude);
    }
    return most - least;
  };
  EXPECT_GT(swing(Actuator::kVoiceCoil), 0.99);
  EXPECT_LT(swing(Actuator::kDcMotor), 0.55);
}

}  // namespace
}  // namespace secondskin::wire
