#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <string_view>
#include <vector>

#include "coach/correct/correction.h"

/// Which repetitions, joints and errors are cued. Feedback helps while it is on and can hurt when
/// it is gone, so when it is given is part of the teaching. docs/learning.md.
///
/// Pure: a decision follows from the schedule, its seed and the repetitions done, nothing else.
namespace secondskin::coach {

/// A cue as it was given in some session.
struct GivenCue {
  std::uint32_t repetition = 0;  ///< of the session, from 0
  double from = 0.0, to = 0.0;   ///< share of the reference's duration, 0 to 1
  Joint joint{};
  /// The movement that was asked for, as a rotation vector in the joint's frame; its length is the
  /// error beyond the dead band [rad].
  Eigen::Vector3d ask = Eigen::Vector3d::Zero();
};

/// What may be cued in one repetition.
struct Feedback {
  JointSet joints = JointSet().set();
  double band = 1.0;  ///< a joint is cued only beyond so many times its tolerance
  bool yoked = false;
  std::vector<GivenCue> cues;  ///< yoked: these are given, whatever the own error
};

/// A repetition that was done: the share of its time that each joint was inside its band, 0 to 1.
struct Outcome {
  std::array<double, kJointCount> in_band{};
};

struct FeedbackSchedule {
  enum class Kind : std::uint8_t {
    kAlways,
    kBandwidth,      ///< only beyond a wider band
    kFading,         ///< fewer and fewer repetitions are cued
    kFadingByJoint,  ///< a joint that is done well is cued in fewer repetitions
    kYoked,          ///< the cues of another session
    kOff,            ///< retention, transfer
  };
  Kind kind = Kind::kAlways;
  double band = 1.0;                ///< bandwidth: times the tolerance, at least 1
  double first = 1.0, last = 0.0;   ///< fading: share of repetitions that are cued
  bool by_success = false;          ///< fading: with success, not with the repetitions of the block
  double goal = 0.9;                ///< share of time in the band at which the share is `last`
  std::vector<GivenCue> cues = {};  ///< yoked
};

/// As a plan's file has it, e.g. "fading_by_joint".
std::string_view schedule_name(FeedbackSchedule::Kind kind) noexcept;

/// Success is the mean of so many repetitions.
inline constexpr std::size_t kRecentRepetitions = 3;

/// The share of repetitions that fading cues at this point of the block, 0 to 1.
///   over the block:  f = first + (last - first) * n / (N - 1)
///   with success:    f = first + (last - first) * min(1, s / goal)
/// with n repetitions done of N, and s the mean share of time in the band of the last
/// kRecentRepetitions, the joints weighted (0 before the first).
double cued_share(const FeedbackSchedule& schedule, std::span<const Outcome> done,
                  std::size_t repetitions, std::span<const double, kJointCount> weight) noexcept;

/// What is cued in the block's next repetition.
///
/// Of repetitions that are cued with the shares f_1, f_2, ... the n-th is cued when
/// floor(u + f_1 + ... + f_n) is more than floor(u + f_1 + ... + f_(n-1)): evenly spread, and never
/// off the wanted number by one. The phase u in [0, 1) comes from the seed, by joint one for
/// itself.
/// @param done         the repetitions of this block so far
/// @param repetitions  of the block; 0: without end, which fades with success only
/// @param number       the next repetition's in the session, from 0; yoked cues go by it
Feedback decide(const FeedbackSchedule& schedule, std::uint64_t seed, std::span<const Outcome> done,
                std::size_t repetitions, std::uint32_t number,
                std::span<const double, kJointCount> weight);

/// The same cues at the same times, each at another joint, drawn from `among`, and with its
/// direction turned at random: a sham. With one joint in `among` only the direction is another.
std::vector<GivenCue> shuffled(std::vector<GivenCue> cues, std::span<const Joint> among,
                               std::uint64_t seed);

}  // namespace secondskin::coach
