#pragma once

#include <array>
#include <random>
#include <vector>

#include "motion/anatomy.h"
#include "sim/learner/learner_parameters.h"
#include "wire/tactor_protocol.h"

/// What a person feels of sixteen tactors, and when they act on it. Knows what vibrates and where
/// the tactors sit; of the coach it knows nothing. Pure: time is passed in, [s], never back.
namespace secondskin::sim {

/// A tactor as the wearer was told of it.
struct WornTactor {
  std::size_t channel = 0;
  Joint segment{};     ///< that it is worn on
  double angle = 0.0;  ///< around it: 0 front, pi/2 left in the rest pose [rad]
};

/// What was understood of one segment's vibration.
struct FeltCue {
  Joint segment{};
  bool rotation = false;
  double angle = 0.0;     ///< where it was felt around the segment [rad]; of a swing
  bool positive = false;  ///< of a rotation: it ran from front to left to back
  double strength = 0.0;  ///< 0 to 1
  double felt = 0.0;      ///< since when, of what it was understood from [s]
};

class TactileSense {
 public:
  TactileSense(std::vector<WornTactor> tactors, const LearnerParameters& parameters,
               std::uint64_t seed);

  /// Takes how strongly each tactor vibrates now, 0 to 1. Call it often enough for taps of 30 ms.
  void feel(double time, const std::array<double, wire::kTactorCount>& amplitude);

  /// What the person acts on at this time: cues that began a reaction time ago, and every
  /// refractory period again while they last. Some are missed, some misread.
  std::vector<FeltCue> react(double time);

  bool felt_anything() const noexcept { return contacts_felt_ > 0; }

 private:
  struct Contact {
    std::size_t tactor = 0;  ///< index in tactors_
    double begin = 0.0, end = 0.0;
    double peak = 0.0;
    bool over = false;
  };
  struct Segment {
    Joint joint{};
    std::vector<Contact> contacts;  ///< of the last seconds, by their beginning
    double last_felt = -1e9;
    bool expects = false;  ///< a reaction is under way
    double reaction = 0.0, due = 0.0;
  };

  std::optional<FeltCue> understand(const Segment& segment, double from, double to) const;

  std::vector<WornTactor> tactors_;
  std::vector<std::size_t> segment_of_;  ///< of each tactor
  std::vector<Segment> segments_;
  LearnerParameters p_;
  std::mt19937_64 random_;
  std::uint64_t contacts_felt_ = 0;
};

}  // namespace secondskin::sim
