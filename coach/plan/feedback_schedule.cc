#include "coach/plan/feedback_schedule.h"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace secondskin::coach {
namespace {

// Steele, Lea & Flood 2014, "Fast splittable pseudorandom number generators": the same numbers
// with every compiler.
std::uint64_t splitmix(std::uint64_t& state) noexcept {
  std::uint64_t z = state += 0x9e3779b97f4a7c15ull;
  z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9ull;
  z = (z ^ (z >> 27)) * 0x94d049bb133111ebull;
  return z ^ (z >> 31);
}

// [0, 1)
double uniform(std::uint64_t& state) noexcept {
  return static_cast<double>(splitmix(state) >> 11) * 0x1.0p-53;
}

double phase(std::uint64_t seed, std::size_t which) noexcept {
  std::uint64_t state = seed * kJointCount + which;
  (void)splitmix(state);
  return uniform(state);
}

std::span<const Outcome> recent(std::span<const Outcome> done) noexcept {
  return done.last(std::min(done.size(), kRecentRepetitions));
}

double share_at(const FeedbackSchedule& schedule, double success) noexcept {
  return schedule.first +
         (schedule.last - schedule.first) * std::clamp(success / schedule.goal, 0.0, 1.0);
}

double joint_share(const FeedbackSchedule& schedule, std::span<const Outcome> done,
                   std::size_t joint) noexcept {
  double sum = 0.0;
  for (const Outcome& outcome : recent(done)) sum += outcome.in_band[joint];
  return share_at(schedule, done.empty() ? 0.0 : sum / static_cast<double>(recent(done).size()));
}

// Whether the repetition after `done` is cued; share(n) is that of the repetition after n others.
template <class Share>
bool is_cued(double phase, std::size_t done, Share share) noexcept {
  double before = phase, after = phase;
  for (std::size_t n = 0; n <= done; ++n) {
    before = after;
    after += share(n);
  }
  return std::floor(after) > std::floor(before);
}

}  // namespace

std::string_view schedule_name(FeedbackSchedule::Kind kind) noexcept {
  constexpr std::string_view kNames[] = {"always",          "bandwidth", "fading",
                                         "fading_by_joint", "yoked",     "off"};
  return kNames[static_cast<std::size_t>(kind)];
}

double cued_share(const FeedbackSchedule& schedule, std::span<const Outcome> done,
                  std::size_t repetitions, std::span<const double, kJointCount> weight) noexcept {
  if (!schedule.by_success) {
    if (repetitions < 2) return schedule.first;
    const double gone = static_cast<double>(done.size()) / static_cast<double>(repetitions - 1);
    return schedule.first + (schedule.last - schedule.first) * std::min(gone, 1.0);
  }
  double sum = 0.0, weights = 0.0;
  for (const Outcome& outcome : recent(done)) {
    for (std::size_t j = 0; j < kJointCount; ++j) {
      sum += weight[j] * outcome.in_band[j];
      weights += weight[j];
    }
  }
  return share_at(schedule, weights > 0.0 ? sum / weights : 0.0);
}

Feedback decide(const FeedbackSchedule& schedule, std::uint64_t seed, std::span<const Outcome> done,
                std::size_t repetitions, std::uint32_t number,
                std::span<const double, kJointCount> weight) {
  using Kind = FeedbackSchedule::Kind;
  Feedback feedback;
  switch (schedule.kind) {
    case Kind::kAlways:
      break;
    case Kind::kBandwidth:
      feedback.band = schedule.band;
      break;
    case Kind::kFading:
      if (!is_cued(phase(seed, 0), done.size(), [&](std::size_t n) {
            return cued_share(schedule, done.first(n), repetitions, weight);
          })) {
        feedback.joints.reset();
      }
      break;
    case Kind::kFadingByJoint:
      for (std::size_t j = 0; j < kJointCount; ++j) {
        feedback.joints[j] = is_cued(phase(seed, j), done.size(), [&](std::size_t n) {
          return joint_share(schedule, done.first(n), j);
        });
      }
      break;
    case Kind::kYoked:
      feedback.yoked = true;
      for (const GivenCue& cue : schedule.cues) {
        if (cue.repetition == number) feedback.cues.push_back(cue);
      }
      break;
    case Kind::kOff:
      feedback.joints.reset();
      break;
  }
  return feedback;
}

std::vector<GivenCue> shuffled(std::vector<GivenCue> cues, std::span<const Joint> among,
                               std::uint64_t seed) {
  std::uint64_t state = seed;
  for (GivenCue& cue : cues) {
    std::vector<Joint> others;
    for (const Joint joint : among) {
      if (joint != cue.joint || among.size() == 1) others.push_back(joint);
    }
    if (!others.empty()) {
      cue.joint =
          others[static_cast<std::size_t>(uniform(state) * static_cast<double>(others.size()))];
    }
    // Even on the sphere: z and the angle about it.
    const double z = 2.0 * uniform(state) - 1.0;
    const double angle = 2.0 * std::numbers::pi * uniform(state);
    const double r = std::sqrt(1.0 - z * z);
    cue.ask = cue.ask.norm() * Eigen::Vector3d(r * std::cos(angle), r * std::sin(angle), z);
  }
  return cues;
}

}  // namespace secondskin::coach
