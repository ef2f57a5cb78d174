#include "sim/board/virtual_board.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <limits>
#include <random>
#include <stdexcept>
#include <vector>

namespace secondskin::sim {
namespace {

using wire::Actuator;
using wire::encode;
using wire::kTactorCount;

constexpr double kForever = std::numeric_limits<double>::infinity();
constexpr std::array<double, kTactorCount> kSilent{};

TEST(VirtualBoard, DrivesWhatABytePairCommands) {
  VirtualBoard board;
  board.receive(encode(wire::continuous_slot(3), 255), 1.0);
  EXPECT_EQ(board.drive()[3], 1.0);
  EXPECT_EQ(board.slots_on(), 1U);
  board.receive(encode(wire::continuous_slot(12), 54), 1.1);
  EXPECT_NEAR(board.drive()[12], 0.30, 1e-12);
  board.receive(encode(wire::continuous_slot(3), 0), 1.2);
  EXPECT_EQ(board.drive()[3], 0.0);
  EXPECT_EQ(board.counters().commands, 3U);
  EXPECT_EQ(board.counters().bytes, 6U);
  EXPECT_EQ(board.counters().dropped_bytes, 0U);
}

TEST(VirtualBoard, WaitsForTheSecondByteAcrossArrivals) {
  VirtualBoard board;
  const auto pair = encode(5, 200);
  board.receive(std::span(pair).first(1), 1.0);
  EXPECT_EQ(board.slots_on(), 0U);
  board.receive(std::span(pair).last(1), 1.015);
  EXPECT_EQ(board.slots_on(), 1U);
  board.receive(std::span(pair).first(1), 2.0);
  board.receive(std::span(pair).last(1), 2.025);  // too late: forgotten
  EXPECT_EQ(board.counters().dropped_bytes, 2U);
}

TEST(VirtualBoard, TurnsEverythingOffAfterAQuarterSecondWithoutAByte) {
  VirtualBoard board;
  board.receive(encode(0, 200), 1.0);
  board.receive(encode(wire::pulsed_slot(9), 200), 1.0);
  board.step(1.249);
  EXPECT_EQ(board.slots_on(), 2U);
  board.step(1.250);
  EXPECT_EQ(board.slots_on(), 0U);
  EXPECT_EQ(board.drive(), kSilent);
  EXPECT_EQ(board.counters().watchdog_trips, 1U);
  board.step(5.0);
  EXPECT_EQ(board.counters().watchdog_trips, 1U);  // nothing left to turn off
}

TEST(VirtualBoard, CountsAnyByteAsASignOfLife) {
  VirtualBoard board;
  board.receive(encode(0, 200), 1.0);
  const std::array<std::uint8_t, 1> noise{255};
  for (int i = 1; i <= 10; ++i) board.receive(noise, 1.0 + 0.2 * i);
  EXPECT_EQ(board.slots_on(), 1U);
  board.step(3.25);
  EXPECT_EQ(board.slots_on(), 0U);
}

TEST(VirtualBoard, StaysOnWithoutAWatchdogAsThePapersFirmwareDoes) {
  VirtualBoard board({.actuators = {}, .watchdog = kForever});
  board.receive(encode(0, 200), 1.0);
  board.step(1e6);
  EXPECT_EQ(board.slots_on(), 1U);
  EXPECT_EQ(board.counters().watchdog_trips, 0U);
}

TEST(VirtualBoard, LetsEachActuatorRiseAndFallInItsOwnTime) {  // 4.3: 5 ms and about 100 ms
  VirtualBoardConfig config;
  config.actuators[1] = Actuator::kDcMotor;
  VirtualBoard board(config);
  board.receive(encode(0, 255), 0.0);
  board.receive(encode(1, 255), 0.0);
  board.step(0.005);
  EXPECT_NEAR(board.amplitude()[0], 0.95, 1e-6);
  EXPECT_LT(board.amplitude()[1], 0.15);
  board.step(0.100);
  EXPECT_NEAR(board.amplitude()[1], 0.95, 1e-6);
  board.receive(encode(0, 0), 0.1);
  board.receive(encode(1, 0), 0.1);
  EXPECT_TRUE(board.active());  // still vibrating
  board.step(0.2);
  EXPECT_LT(board.amplitude()[0], 1e-6);
  EXPECT_NEAR(board.amplitude()[1], 0.95 * 0.05, 0.01);
  board.step(0.5);
  EXPECT_FALSE(board.active());
}

TEST(VirtualBoard, IsTheSameHoweverOftenItIsLookedAt) {
  VirtualBoard often;
  VirtualBoard rarely;
  for (VirtualBoard* board : {&often, &rarely}) {
    board->receive(encode(wire::pulsed_slot(2), 255), 0.0);
  }
  for (int i = 1; i <= 2000; ++i) often.step(i * 1e-4);
  rarely.step(0.2);
  EXPECT_EQ(often.drive(), rarely.drive());
  EXPECT_NEAR(often.amplitude()[2], rarely.amplitude()[2], 0.1);  // its own step is 1 ms
}

TEST(VirtualBoard, NeverExceedsFullDriveWhateverTheBytesAre) {
  std::mt19937 random(6);
  std::uniform_int_distribution<int> byte(0, 255);
  VirtualBoard board;
  double time = 0.0;
  std::vector<std::uint8_t> bytes(20);
  for (int n = 0; n < 5000; ++n) {
    for (std::uint8_t& b : bytes) b = static_cast<std::uint8_t>(byte(random));
    time += 0.004;
    board.receive(bytes, time);
    for (const double drive : board.drive()) ASSERT_TRUE(drive >= 0.0 && drive <= 1.0);
    for (const double a : board.amplitude()) ASSERT_TRUE(a >= 0.0 && a <= 1.0);
  }
  board.step(time + 0.25);
  EXPECT_EQ(board.drive(), kSilent);
}

TEST(VirtualBoard, RefusesAWatchdogThatIsNoTime) {
  EXPECT_THROW(VirtualBoard({.actuators = {}, .watchdog = 0.0}), std::invalid_argument);
  EXPECT_THROW(
      VirtualBoard({.actuators = {}, .watchdog = std::numeric_limits<double>::quiet_NaN()}),
      std::invalid_argument);
}

TEST(Voltage, IsASquareWaveOf250HertzForVoiceCoilsAndDirectCurrentForMotors) {  // 4.1
  EXPECT_DOUBLE_EQ(voltage_of(Actuator::kVoiceCoil, 1.0, 0.001), 2.5);          // 5 V peak to peak,
  EXPECT_DOUBLE_EQ(voltage_of(Actuator::kVoiceCoil, 1.0, 0.003), -2.5);         // centred at zero
  EXPECT_DOUBLE_EQ(voltage_of(Actuator::kVoiceCoil, 0.5, 0.005), 1.25);  // 4 ms later: the next
  EXPECT_DOUBLE_EQ(voltage_of(Actuator::kDcMotor, 1.0, 0.003), 5.0);
  EXPECT_DOUBLE_EQ(voltage_of(Actuator::kDcMotor, 0.0, 0.003), 0.0);
}

TEST(Bars, ShowsSixteenTactorsInALine) {
  std::array<double, kTactorCount> levels{};
  EXPECT_EQ(bars(levels), "................");
  levels[0] = 1.0;
  levels[4] = 0.30;
  levels[15] = 0.01;
  EXPECT_EQ(bars(levels), "9...3..........1");
}

}  // namespace
}  // namespace secondskin::sim
