#pragma once

#include "bus/messages.h"
#include "coach/coach.h"
#include "coach/plan/session_plan.h"

/// The coach's results to their messages: the one place that knows both. Nothing here allocates
/// once a message has been filled before; publish_ns is left to whoever publishes.
namespace secondskin::coach {

void to_message(const StampedPose& pose, const AlignmentEstimate& alignment,
                bus::msg::Alignment& message);
void to_message(const StampedPose& pose, const CoachOutput& output,
                const std::array<double, kJointCount>& tolerance, bus::msg::Correction& message);
void to_message(const StampedPose& pose, const wire::BoardState& tactors,
                std::uint64_t command_number, bus::msg::TactorCommand& message);
void to_message(const StampedPose& pose, const RepetitionScore& score,
                bus::msg::RepetitionScore& message);

/// The body map as the session uses it and the tactile setup at its start, so that a replay needs
/// neither the map's file nor the learner's. Start-up only.
void to_message(const BodyMap& map, const TactileSetup& tactile, bus::msg::SessionState& message);
/// @returns whether the message has a map; older recordings have none
bool from_message(const bus::msg::SessionState& message, BodyMap& map, TactileSetup& tactile);

/// Where the session is in its plan, and what is cued next. Allocates where cues are yoked.
void to_message(const PlanProgress& progress, bus::msg::SessionState& message);
Feedback feedback_of(const bus::msg::SessionState& message);

Phase phase_of(bus::msg::AlignmentPhase phase) noexcept;
SolverStatus status_of(bus::msg::SolverStatus status) noexcept;

}  // namespace secondskin::coach
