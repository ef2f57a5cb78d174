#include "sim/learner/tactile_sense.h"

#include <gtest/gtest.h>

#include <limits>

#include "wire/tactor_waveform.h"

namespace secondskin::sim {
namespace {

using Amplitude = std::array<double, wire::kTactorCount>;
constexpr double kStep = 0.002;

// A ring around the forearm (0 to 3), one around the upper arm (4 to 7).
std::vector<WornTactor> arm() {
  std::vector<WornTactor> tactors;
  for (std::size_t c = 0; c < 8; ++c) {
    tactors.push_back({c, c < 4 ? Joint::kRightElbow : Joint::kRightShoulder,
                       0.5 * std::numbers::pi * static_cast<double>(c % 4)});
  }
  return tactors;
}

// Feels everything and is always right.
LearnerParameters perfect() {
  LearnerParameters p;
  p.missed = p.misread = p.misread_with_each = p.weber = p.reaction_deviation = 0.0;
  return p;
}

double wrapped(double angle) { return std::remainder(angle, 2.0 * std::numbers::pi); }

// What is understood of a board state that is held for a second, through real actuators.
std::vector<std::pair<double, FeltCue>> felt(const wire::BoardState& state,
                                             LearnerParameters p = perfect(),
                                             std::uint64_t seed = 1) {
  TactileSense sense(arm(), p, seed);
  wire::BoardPatterns patterns;
  for (std::size_t slot = 0; slot < wire::kSlotCount; ++slot) {
    if (state[slot] != 0) patterns.apply({slot, state[slot]}, 1.0);
  }
  std::vector<wire::ActuatorResponse> actuators(wire::kTactorCount,
                                                wire::ActuatorResponse(wire::Actuator::kVoiceCoil));
  std::vector<std::pair<double, FeltCue>> cues;
  for (double time = 0.0; time < 3.0; time += kStep) {
    Amplitude level{};
    if (time >= 1.0 && time < 2.0) patterns.drive(time, level);
    for (std::size_t t = 0; t < level.size(); ++t) level[t] = actuators[t].step(level[t], kStep);
    sense.feel(time, level);
    for (const FeltCue& cue : sense.react(time)) cues.emplace_back(time, cue);
  }
  return cues;
}

wire::BoardState with(std::initializer_list<std::pair<std::size_t, std::uint8_t>> slots) {
  wire::BoardState state{};
  for (const auto& [slot, intensity] : slots) state[slot] = intensity;
  return state;
}

TEST(TactileSense, DoesNotFeelADeadOrTooFaintTactor) {
  EXPECT_TRUE(felt({}).empty());
  TactileSense sense(arm(), perfect(), 1);
  Amplitude faint;
  faint.fill(perfect().threshold - 1e-6);
  faint[2] = std::numeric_limits<double>::quiet_NaN();
  for (double time = 0.0; time < 5.0; time += kStep) {
    sense.feel(time, faint);
    EXPECT_TRUE(sense.react(time).empty());
  }
  EXPECT_FALSE(sense.felt_anything());
}

TEST(TactileSense, DoesNotFeelAChannelThatIsNotWorn) {
  EXPECT_TRUE(felt(with({{wire::continuous_slot(12), 255}})).empty());
}

TEST(TactileSense, DoesNothingBeforeTheReactionTimeAndThenOnceEveryRefractoryPeriod) {
  LearnerParameters p = perfect();
  for (const auto& [channel, delay] : {std::pair(0u, 0.0), std::pair(4u, 0.020)}) {
    const auto cues = felt(with({{wire::continuous_slot(channel), 255}}), p);
    ASSERT_GE(cues.size(), 3u);
    const double expected = 1.0 + p.reaction_time + p.second_task + delay;
    EXPECT_GE(cues[0].first, expected);
    EXPECT_NEAR(cues[0].first, expected, 0.005);
    EXPECT_NEAR(cues[1].first - cues[0].first, p.refractory, 0.005);
    EXPECT_LT(cues.back().first, 2.0 + p.reaction_time + p.second_task + delay + 0.01)
        << "nothing is done about what is over";
  }
  p = LearnerParameters{};
  for (std::uint64_t seed = 0; seed < 200; ++seed) {
    for (const auto& [time, cue] : felt(with({{wire::continuous_slot(0), 255}}), p, seed)) {
      EXPECT_GE(time, 1.0 + 0.5 * (p.reaction_time + p.second_task));
    }
  }
}

TEST(TactileSense, TellsTheSideOfASteadyOrPulsedTactor) {
  for (std::size_t channel = 0; channel < 8; ++channel) {
    for (const int intensity : {54, 120, 190, 255}) {
      for (const std::size_t slot : {wire::continuous_slot(channel), wire::pulsed_slot(channel)}) {
        const auto cues = felt(with({{slot, static_cast<std::uint8_t>(intensity)}}));
        ASSERT_FALSE(cues.empty());
        for (const auto& [time, cue] : cues) {
          EXPECT_EQ(cue.segment, channel < 4 ? Joint::kRightElbow : Joint::kRightShoulder);
          EXPECT_FALSE(cue.rotation);
          EXPECT_NEAR(wrapped(cue.angle - arm()[channel].angle), 0.0, 1e-9);
        }
      }
    }
  }
}

TEST(TactileSense, FeelsTwoAtOnceAsOneBetweenThem) {
  const auto cues = felt(with({{wire::continuous_slot(0), 200}, {wire::continuous_slot(1), 200}}));
  ASSERT_FALSE(cues.empty());
  for (const auto& [time, cue] : cues) {
    EXPECT_FALSE(cue.rotation);
    EXPECT_NEAR(cue.angle, 0.25 * std::numbers::pi, 1e-9);
  }
  for (const auto& [time, cue] :
       felt(with({{wire::pulsed_slot(0), 200}, {wire::pulsed_slot(1), 200}}))) {
    EXPECT_FALSE(cue.rotation) << "pulses in step are no turn";
  }
}

TEST(TactileSense, TellsTheDirectionOfSaltationAtEveryIntensityThatTheCoachUses) {
  for (int intensity = 54; intensity <= 255; ++intensity) {
    const auto level = static_cast<std::uint8_t>(intensity);
    if (wire::drive_of(level).tap_interval > 0.100) continue;
    for (const bool reverse : {false, true}) {
      const auto cues = felt(with({{wire::saltation_slot(0, reverse), level}}));
      ASSERT_FALSE(cues.empty());
      for (const auto& [time, cue] : cues) {
        if (time > 2.0 + 0.38) continue;  // its end, cut short
        EXPECT_TRUE(cue.rotation) << intensity << " at " << time;
        EXPECT_EQ(cue.positive, !reverse) << intensity << " at " << time;
      }
    }
  }
}

TEST(TactileSense, ATurnThatFollowsASteadyTactorAtOnceIsATurn) {
  TactileSense sense(arm(), perfect(), 1);
  wire::BoardPatterns patterns;
  std::vector<wire::ActuatorResponse> actuators(wire::kTactorCount,
                                                wire::ActuatorResponse(wire::Actuator::kVoiceCoil));
  std::size_t turns = 0;
  for (double time = 0.0; time < 3.0; time += kStep) {
    // One coil dies away within 5 ms while the first tap begins beside it.
    patterns.apply({wire::continuous_slot(2), static_cast<std::uint8_t>(time < 1.0 ? 200 : 0)},
                   time);
    patterns.apply(
        {wire::saltation_slot(0, false), static_cast<std::uint8_t>(time < 1.0 ? 0 : 200)}, time);
    Amplitude level{};
    patterns.drive(time, level);
    for (std::size_t t = 0; t < level.size(); ++t) level[t] = actuators[t].step(level[t], kStep);
    sense.feel(time, level);
    for (const FeltCue& cue : sense.react(time)) {
      // Some of what is acted upon was felt across the change.
      if (time < 1.0 + 0.38) {
        EXPECT_FALSE(cue.rotation) << time;
      } else if (time > 1.0 + 0.38 + 0.25) {
        EXPECT_TRUE(cue.rotation) << time;
        ++turns;
      }
    }
  }
  EXPECT_GT(turns, 3u);
}

TEST(TactileSense, TheBeginningOfTheNextCueDoesNotOutweighTheOneBefore) {
  TactileSense sense(arm(), perfect(), 1);
  std::vector<FeltCue> cues;
  for (double time = 0.0; time < 2.0; time += kStep) {
    Amplitude level{};
    // Faint at the back for 0.2 s, then a strong tap in front.
    if (time >= 1.0 && time < 1.2) level[2] = 0.3;
    if (time >= 1.2 && time < 1.235) level[0] = 0.4;
    sense.feel(time, level);
    for (const FeltCue& cue : sense.react(time)) cues.push_back(cue);
  }
  ASSERT_FALSE(cues.empty());
  EXPECT_FALSE(cues[0].rotation);
  EXPECT_NEAR(std::abs(wrapped(cues[0].angle)), std::numbers::pi, 1e-9);
  EXPECT_NEAR(cues[0].strength, 0.3, 1e-9);
}

TEST(TactileSense, MissesAndMisreadsAsOftenAsItsParametersSay) {
  LearnerParameters p = perfect();
  p.missed = 0.3;
  p.misread = 0.2;
  const std::size_t whole = felt(with({{wire::continuous_slot(0), 255}})).size();
  std::size_t got = 0, wrong = 0;
  constexpr int kPeople = 600;
  for (std::uint64_t seed = 0; seed < kPeople; ++seed) {
    for (const auto& [time, cue] : felt(with({{wire::continuous_slot(0), 255}}), p, seed)) {
      ++got;
      wrong += std::abs(wrapped(cue.angle)) > 0.1 ? 1 : 0;
    }
  }
  EXPECT_NEAR(static_cast<double>(got) / static_cast<double>(whole * kPeople), 0.7, 0.04);
  EXPECT_NEAR(static_cast<double>(wrong) / static_cast<double>(got), 0.2, 0.04);
}

TEST(TactileSense, TellsTwoCuesAtOnceWorseThanOne) {
  LearnerParameters p = perfect();
  p.misread = 0.05;
  p.misread_with_each = 0.336;
  std::size_t wrong = 0, got = 0;
  for (std::uint64_t seed = 0; seed < 400; ++seed) {
    for (const auto& [time, cue] :
         felt(with({{wire::continuous_slot(0), 255}, {wire::continuous_slot(4), 255}}), p, seed)) {
      ++got;
      wrong += std::abs(wrapped(cue.angle)) > 0.1 ? 1 : 0;
    }
  }
  // Both are told with 1 - 0.05 - 0.336 = 0.614, each with its square root.
  EXPECT_NEAR(static_cast<double>(wrong) / static_cast<double>(got), 1.0 - std::sqrt(0.614), 0.04);
}

}  // namespace
}  // namespace secondskin::sim
