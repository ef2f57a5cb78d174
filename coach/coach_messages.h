#pragma once

#include "bus/messages.h"
#include "coach/coach.h"

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

Phase phase_of(bus::msg::AlignmentPhase phase) noexcept;
SolverStatus status_of(bus::msg::SolverStatus status) noexcept;

}  // namespace secondskin::coach
