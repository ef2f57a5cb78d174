#include "coach/tactile/envelope.h"

#include <gtest/gtest.h>

#include <random>
#include <vector>

namespace secondskin::coach {
namespace {

constexpr double kStep = 0.001;

std::vector<EnvelopeSample> rendered(const std::vector<TimedCommand>& commands, double seconds) {
  std::vector<EnvelopeSample> out(static_cast<std::size_t>(seconds / kStep));
  render_envelope(commands, {}, 0.0, kStep, out);
  return out;
}

TEST(Envelope, IsOffBeforeBetweenAndAfterCommands) {
  wire::BoardState board{};
  board[wire::continuous_slot(5)] = wire::kStrongestIntensity;
  const auto out = rendered({{0.1, board, 0.06}, {0.3, board, 0.06}}, 0.5);
  for (std::size_t i = 0; i < out.size(); ++i) {
    const double t = kStep * static_cast<double>(i);
    const bool on = (t >= 0.1 && t < 0.16) || (t >= 0.3 && t < 0.36);
    EXPECT_EQ(out[i].drive[5], on ? 1.0 : 0.0) << t;
    EXPECT_EQ(out[i].drive[4], 0.0);
  }
  EXPECT_GT(out[110].vibration[5], 0.9);
  EXPECT_LT(out[110 + 60].vibration[5], 0.1);
}

TEST(Envelope, KeepsThePhaseOfARepeatedCommand) {
  wire::BoardState board{};
  board[wire::pulsed_slot(2)] = wire::kStrongestIntensity;  // 15 Hz, half of each on
  std::vector<TimedCommand> commands;
  for (int i = 0; i < 60; ++i) commands.push_back({0.016 * i, board, 0.06});
  const auto out = rendered(commands, 0.9);
  int onsets = 0;
  for (std::size_t i = 1; i < out.size(); ++i) {
    onsets += out[i].drive[2] > 0.0 && out[i - 1].drive[2] == 0.0 ? 1 : 0;
  }
  EXPECT_EQ(onsets, 13);
}

TEST(Envelope, RunsTheStrongerOfTwoDirections) {
  for (const bool reverse : {false, true}) {
    wire::BoardState board{};
    board[wire::saltation_slot(1, reverse)] = 255;
    board[wire::saltation_slot(1, !reverse)] = 100;
    const auto out = rendered({{0.0, board, 0.25}}, 0.25);
    EXPECT_EQ(out[0].drive[reverse ? 7 : 4], 1.0);
    EXPECT_EQ(out[90].drive[reverse ? 6 : 5], 1.0);
  }
}

// Whatever bytes come when: never beyond the strongest command in force, never after its life.
TEST(Envelope, NeverOutlivesOrExceedsItsCommands) {
  std::mt19937 generator(3);
  std::uniform_real_distribution<double> unit(0.0, 1.0);
  for (int trial = 0; trial < 300; ++trial) {
    std::vector<TimedCommand> commands;
    double time = 0.0;
    for (int i = 0; i < 10; ++i) {
      TimedCommand command;
      command.time = time += 0.05 * unit(generator);
      command.valid_for = unit(generator) < 0.1 ? -1.0 : 0.08 * unit(generator);
      for (auto& intensity : command.board) {
        if (unit(generator) < 0.2) intensity = static_cast<std::uint8_t>(generator() % 256);
      }
      commands.push_back(command);
    }
    std::array<wire::Actuator, wire::kTactorCount> actuators{};
    for (auto& kind : actuators) {
      kind = unit(generator) < 0.5 ? wire::Actuator::kVoiceCoil : wire::Actuator::kDcMotor;
    }
    std::vector<EnvelopeSample> out(600);
    render_envelope(commands, actuators, 0.0, kStep, out);
    for (std::size_t i = 0; i < out.size(); ++i) {
      const double t = kStep * static_cast<double>(i);
      const TimedCommand* in_force = nullptr;
      for (const auto& command : commands) {
        if (command.time <= t && command.valid_for > 0.0) in_force = &command;
      }
      double most = 0.0;
      if (in_force != nullptr && t < in_force->time + in_force->valid_for) {
        for (const auto intensity : in_force->board) {
          most = std::max(most, wire::drive_of(intensity).level);
        }
      }
      for (std::size_t c = 0; c < wire::kTactorCount; ++c) {
        ASSERT_LE(out[i].drive[c], most) << t;
        ASSERT_LE(out[i].vibration[c], 1.0);
      }
    }
  }
}

}  // namespace
}  // namespace secondskin::coach
