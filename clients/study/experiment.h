#pragma once

#include <memory>
#include <vector>

#include "coach/coach.h"
#include "coach/plan/feedback_schedule.h"
#include "sim/learner/virtual_learner.h"

/// One simulated person in one group of a study, through the whole chain in simulated time: the
/// person's poses, the coach with its solver, the driver's bytes, the virtual board, its actuators,
/// the person's skin. docs/study.md has the protocol.
namespace secondskin::study {

enum class Group {
  kVisual,   ///< sees the expert
  kTactile,  ///< sees the expert and is cued
  kSham,     ///< sees the expert and gets the tactile group's cues at other joints
};

struct Protocol {
  std::shared_ptr<const coach::Reference> reference;
  coach::BodyMap map;
  coach::CoachSettings settings{.tolerance_scale = 0.5, .max_cues = 2};
  bool endless_cues = false;         ///< without a pause for the answer
  coach::FeedbackSchedule schedule;  ///< of the tactile group's practice
  std::size_t before = 3;            ///< repetitions alone: from memory, without expert or cues
  std::size_t practice = 15;
  double rest = 300.0;        ///< [s]
  std::size_t retention = 3;  ///< repetitions alone
  sim::LearnerParameters learner;

  std::size_t repetitions() const noexcept { return before + practice + retention; }
};

/// What became of a person.
struct Person {
  /// By repetition, root mean squares over its time: of the true angular error of the joints that
  /// the body map serves, by their weights [rad]; of the place of hands, feet and head of the limbs
  /// that it serves, in the pelvis' frame [m].
  std::vector<double> error, place_error;
  std::uint64_t cues = 0;              ///< onsets that the coach gave
  std::uint64_t reactions = 0;         ///< corrections that the person made of them
  std::uint64_t right = 0, wrong = 0;  ///< of them, made while moving: towards what was missing
                                       ///< then, or not
  std::uint64_t counted = 0;           ///< repetitions that the coach counted
  std::vector<coach::GivenCue> given;
};

/// The reference with only those joints that wear tactors themselves: what TIKL taught. Its other
/// joints have no weight.
std::shared_ptr<const coach::Reference> of_worn_joints(const coach::Reference& reference,
                                                       const coach::BodyMap& map);

/// Joints that the body map can say something to and the reference gives a weight.
std::vector<Joint> served(const Protocol& protocol);

/// The same seed is the same person, whatever the group.
/// @param cues  of a sham: what a person of the tactile group was given
Person run_person(const Protocol& protocol, Group group, std::uint64_t seed,
                  const std::vector<coach::GivenCue>& cues = {});

}  // namespace secondskin::study
