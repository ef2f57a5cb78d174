#include "coach/coach_messages.h"

#include <cmath>

namespace secondskin::coach {
namespace {

namespace msg = bus::msg;

void set_header(const StampedPose& pose, msg::SampleHeader& header) {
  header.frame(pose.frame);
  header.stamp_ns(pose.stamp_ns);
}

void set(const Eigen::Vector3d& v, msg::Vector3& out) {
  out.x(v.x());
  out.y(v.y());
  out.z(v.z());
}

void set_name(std::size_t joint, eprosima::fastrtps::fixed_string<64>& out) {
  const auto name = joint_name(static_cast<Joint>(joint));
  out.assign(name.data(), name.size());
}

}  // namespace

void to_message(const StampedPose& pose, const AlignmentEstimate& alignment,
                msg::Alignment& message) {
  set_header(pose, message.header());
  message.reference_time(alignment.reference_time);
  message.tempo(alignment.tempo);
  message.confidence(alignment.confidence);
  message.phase(static_cast<msg::AlignmentPhase>(alignment.phase));
  message.repetition(alignment.repetition);
}

void to_message(const StampedPose& pose, const CoachOutput& output,
                const std::array<double, kJointCount>& tolerance, msg::Correction& message) {
  set_header(pose, message.header());
  message.status(static_cast<msg::SolverStatus>(output.correction.status));
  message.handed_over(output.handed_over);
  message.solved_frame(output.correction.frame);
  message.solve_time(output.correction.solve_time);
  message.iterations(output.correction.iterations);
  message.joints().resize(kJointCount);
  for (std::size_t j = 0; j < kJointCount; ++j) {
    auto& joint = message.joints()[j];
    set_name(j, joint.joint());
    set(output.error[j], joint.error());
    joint.tolerance(tolerance[j]);
    set(output.correction.target[j], joint.target());
    joint.benefit(output.correction.benefit[j]);
  }
}

void to_message(const StampedPose& pose, const wire::BoardState& tactors,
                std::uint64_t command_number, msg::TactorCommand& message) {
  set_header(pose, message.header());
  message.command_number(command_number);
  message.valid_for_ns(std::llround(kCommandLifetime * 1e9));
  message.intensities() = tactors;
}

void to_message(const StampedPose& pose, const RepetitionScore& score,
                msg::RepetitionScore& message) {
  set_header(pose, message.header());
  message.repetition(score.repetition);
  message.start_ns(score.start_ns);
  message.end_ns(score.end_ns);
  message.total(score.total);
  message.cues(score.cues);
  message.joints().resize(kJointCount);
  for (std::size_t j = 0; j < kJointCount; ++j) {
    auto& joint = message.joints()[j];
    set_name(j, joint.joint());
    joint.rms(score.joints[j].rms);
    joint.peak(score.joints[j].peak);
    joint.in_band(score.joints[j].in_band);
  }
}

Phase phase_of(msg::AlignmentPhase phase) noexcept { return static_cast<Phase>(phase); }

SolverStatus status_of(msg::SolverStatus status) noexcept {
  return static_cast<SolverStatus>(status);
}

static_assert(static_cast<int>(Phase::kLost) == static_cast<int>(msg::PHASE_LOST));
static_assert(static_cast<int>(SolverStatus::kFallback) == static_cast<int>(msg::SOLVER_FALLBACK));

}  // namespace secondskin::coach
