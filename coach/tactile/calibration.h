#pragma once

#include <cstdint>
#include <optional>
#include <random>
#include <vector>

#include "coach/tactile/learner_profile.h"

/// The measurements behind a learner's profile: what to present next, given the answers so far.
/// Pure; whoever presents (clients/cli/calibrate_tactors.cc) drives the board. Levels stay between
/// a floor and a ceiling whatever is answered. Same seed and answers, same trials.
namespace secondskin::coach {

/// Absolute threshold: a two-down one-up staircase, which settles where 71 % are felt (Levitt
/// 1971, J. Acoust. Soc. Am. 49:467). Steps are ratios of 1.2; every sixth trial or so presents
/// nothing, to catch guessing.
class ThresholdStaircase {
 public:
  /// @param floor  faintest level that the board drives; @param ceiling  at least the floor
  ThresholdStaircase(double floor, double ceiling, std::uint32_t seed);

  /// Level to present, 0 for a catch trial; empty once it is known.
  std::optional<double> next() noexcept;
  /// To the last next().
  void answer(bool felt) noexcept;

  /// Once it is known: the level; above the ceiling if even that was not felt.
  double threshold() const noexcept { return threshold_; }
  bool felt() const noexcept { return threshold_ <= ceiling_; }
  std::uint32_t catch_trials() const noexcept { return catch_trials_; }
  std::uint32_t false_alarms() const noexcept { return false_alarms_; }

 private:
  double level_of(int step) const noexcept;
  void move(int direction) noexcept;

  double floor_, ceiling_;
  int top_;   ///< step of the ceiling
  int step_;  ///< 0 at the floor
  int stride_ = 2;
  int direction_ = 0;
  int felt_in_a_row_ = 0;
  int at_end_ = 0;  ///< times that it wanted to go beyond the floor or the ceiling
  int trials_ = 0;
  bool catching_ = false;
  bool known_ = false;
  std::vector<double> reversals_;
  double threshold_ = 0.0;
  std::uint32_t catch_trials_ = 0, false_alarms_ = 0;
  std::mt19937 random_;
};

/// Comfort: rises from the threshold by a noticeable step at a time until the learner stops it.
class ComfortRamp {
 public:
  ComfortRamp(double threshold, double ceiling) noexcept
      : level_(threshold), ceiling_(ceiling), comfortable_(threshold) {}
  /// Level to present; empty once it is known.
  std::optional<double> next() const noexcept;
  void answer(bool too_strong) noexcept;
  /// Strongest level that was not too strong; the threshold if none was.
  double comfortable() const noexcept { return comfortable_; }

 private:
  double level_, ceiling_, comfortable_;
  bool known_ = false;
};

/// Which one was it? Every site so many times, shuffled.
class WhichOneTest {
 public:
  WhichOneTest(const std::vector<std::size_t>& channels, std::uint32_t presentations,
               std::uint32_t seed);
  /// Channel to present; empty when all were.
  std::optional<std::size_t> next() const noexcept;
  /// Which channel the learner named.
  void answer(std::size_t channel) noexcept;
  std::size_t left() const noexcept { return order_.size() - done_; }
  /// How often each was named when one was presented.
  const std::array<std::array<std::uint32_t, wire::kTactorCount>, wire::kTactorCount>& confusion()
      const noexcept {
    return confusion_;
  }

 private:
  std::vector<std::size_t> order_;
  std::size_t done_ = 0;
  std::array<std::array<std::uint32_t, wire::kTactorCount>, wire::kTactorCount> confusion_{};
};

/// A level that is clearly felt and comfortable: the geometric middle.
double clear_level(double threshold, double ceiling) noexcept;

}  // namespace secondskin::coach
