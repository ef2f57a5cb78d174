#include "coach/coach_messages.h"

#include <cmath>
#include <limits>

namespace secondskin::coach {
namespace {

namespace msg = bus::msg;

constexpr double kUnknown = std::numeric_limits<double>::quiet_NaN();

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
    const JointScore& from = score.joints[j];
    joint.measured(from.measured);
    joint.rms(from.rms);
    joint.peak(from.peak);
    joint.in_band(from.in_band);
    joint.timing_error(from.timing_error.value_or(kUnknown));
    joint.smoothness(from.smoothness.value_or(kUnknown));
    joint.range(from.range);
    joint.reference_range(from.reference_range);
  }
}

void to_message(const BodyMap& map, const TactileSetup& tactile, msg::SessionState& message) {
  message.body_map(map.name.substr(0, 64));
  message.repulsive(map.repulsive);
  message.duration_scaled(tactile.duration_scaled);
  message.exposure_stamp_ns(tactile.exposure.stamp_ns);
  message.tactors().clear();
  for (const Tactor& tactor : map.tactors) {
    const SiteExposure& exposure = tactile.exposure.sites[tactor.channel];
    msg::TactorSite site;
    site.channel(static_cast<std::uint8_t>(tactor.channel));
    set_name(index(tactor.segment), site.segment());
    site.along(tactor.along);
    site.angle(tactor.angle);
    site.dc_motor(tactor.actuator == wire::Actuator::kDcMotor);
    site.threshold(tactor.threshold);
    site.ceiling(tactor.ceiling);
    site.acceleration(tactor.acceleration);
    site.no_phantom_with(tactor.no_phantom_with);
    site.dose(exposure.dose);
    site.duty(exposure.duty);
    site.heat(exposure.heat);
    message.tactors().push_back(site);
  }
  message.safe_range().clear();
  for (const JointLimit& limit : tactile.safe_range.limits) {
    msg::JointLimit joint;
    set_name(index(limit.joint), joint.joint());
    joint.movement(static_cast<std::uint8_t>(limit.movement));
    joint.minimum(limit.minimum);
    joint.maximum(limit.maximum);
    message.safe_range().push_back(joint);
  }
}

bool from_message(const msg::SessionState& message, BodyMap& map, TactileSetup& tactile) {
  if (message.tactors().empty()) return false;
  map = {};
  map.name = message.body_map().to_string();
  map.repulsive = message.repulsive();
  tactile = {};
  tactile.duration_scaled = message.duration_scaled();
  tactile.exposure.stamp_ns = message.exposure_stamp_ns();
  for (const msg::TactorSite& site : message.tactors()) {
    const auto segment = find_joint(site.segment().to_string());
    if (!segment || site.channel() >= wire::kTactorCount) return false;
    Tactor tactor;
    tactor.channel = site.channel();
    tactor.segment = *segment;
    tactor.along = site.along();
    tactor.angle = site.angle();
    tactor.actuator = site.dc_motor() ? wire::Actuator::kDcMotor : wire::Actuator::kVoiceCoil;
    tactor.threshold = site.threshold();
    tactor.ceiling = site.ceiling();
    tactor.acceleration = site.acceleration();
    tactor.no_phantom_with = site.no_phantom_with();
    map.tactors.push_back(tactor);
    tactile.exposure.sites[tactor.channel] = {site.dose(), site.duty(), site.heat()};
  }
  for (const msg::JointLimit& limit : message.safe_range()) {
    const auto joint = find_joint(limit.joint().to_string());
    if (!joint || limit.movement() >= kMovementNames.size()) return false;
    tactile.safe_range.limits.push_back(
        {*joint, static_cast<Movement>(limit.movement()), limit.minimum(), limit.maximum()});
  }
  return true;
}

void to_message(const PlanProgress& progress, msg::SessionState& message) {
  const Block& block = progress.block();
  message.plan(progress.plan().name);
  message.blocks(static_cast<std::uint32_t>(progress.plan().blocks.size()));
  message.block(static_cast<std::uint32_t>(progress.block_index()));
  message.block_name(block.name);
  message.block_tempo(block.tempo);
  const auto schedule = schedule_name(block.schedule.kind);
  message.block_schedule().assign(schedule.data(), schedule.size());
  message.block_repetitions(static_cast<std::uint32_t>(progress.repetitions()));
  message.block_planned(static_cast<std::uint32_t>(block.repetitions));
  message.resting(progress.resting());
  const Feedback& feedback = progress.feedback();
  message.cued_joints(static_cast<std::uint32_t>(feedback.joints.to_ulong()));
  message.cue_band(feedback.band);
  message.yoked(feedback.yoked);
  message.yoked_cues().clear();
  for (const GivenCue& cue : feedback.cues) {
    msg::YokedCue yoked;
    set_name(index(cue.joint), yoked.joint());
    yoked.from(cue.from);
    yoked.to(cue.to);
    set(cue.ask, yoked.ask());
    message.yoked_cues().push_back(yoked);
  }
}

Feedback feedback_of(const msg::SessionState& message) {
  Feedback feedback;
  feedback.joints = JointSet(message.cued_joints());
  feedback.band = message.cue_band();
  feedback.yoked = message.yoked();
  for (const msg::YokedCue& yoked : message.yoked_cues()) {
    const auto joint = find_joint(yoked.joint().to_string());
    if (!joint) continue;
    feedback.cues.push_back({.from = yoked.from(),
                             .to = yoked.to(),
                             .joint = *joint,
                             .ask = {yoked.ask().x(), yoked.ask().y(), yoked.ask().z()}});
  }
  return feedback;
}

Phase phase_of(msg::AlignmentPhase phase) noexcept { return static_cast<Phase>(phase); }

SolverStatus status_of(msg::SolverStatus status) noexcept {
  return static_cast<SolverStatus>(status);
}

static_assert(static_cast<int>(Phase::kLost) == static_cast<int>(msg::PHASE_LOST));
static_assert(static_cast<int>(SolverStatus::kFallback) == static_cast<int>(msg::SOLVER_FALLBACK));

}  // namespace secondskin::coach
