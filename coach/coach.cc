#include "coach/coach.h"

#include "motion/rotation.h"

namespace secondskin::coach {
namespace {

// First-order low-pass of the differenced joint velocities: quiet enough for a prediction over the
// solver's horizon, late by no more than a frame or two.
constexpr double kVelocityTimeConstant = 0.03;  // [s]
constexpr double kEndless = 1e9;                // [s]
constexpr double kLongestGap = 0.25;            // a longer one says nothing of velocity [s]

double seconds(std::int64_t ns) { return static_cast<double>(ns) * 1e-9; }

}  // namespace

Coach::Coach(std::shared_ptr<const Reference> reference, BodyMap map, const CoachSettings& settings,
             CorrectionSource& solver, TactileSetup tactile)
    : reference_(reference),
      aligner_(reference),
      safe_range_(std::move(tactile.safe_range)),
      mapper_(std::move(map),
              {.max_cues = settings.max_cues,
               .max_hold = tactile.endless ? kEndless : TactileOptions{}.max_hold,
               .pause = tactile.endless ? 0.0 : TactileOptions{}.pause,
               .duration_scaled = tactile.duration_scaled,
               .command_lifetime = kCommandLifetime},
              tactile.exposure),
      scorer_(reference),
      solver_(&solver),
      last_pose_(kJointCount) {
  problem_.learner = Pose(kJointCount);
  problem_.habit = Habit(reference_->motion.duration());
  tolerance_scale_ = settings.tolerance_scale;
  set_tolerance(0.0);
}

void Coach::set_tolerance(double reference_time) noexcept {
  for (std::size_t j = 0; j < kJointCount; ++j) {
    tolerance_[j] = reference_->tolerance_at(reference_time, j) * tolerance_scale_;
  }
}

void Coach::estimate_velocity(const StampedPose& pose) noexcept {
  const double dt = seconds(pose.stamp_ns - last_stamp_ns_);
  if (last_stamp_ns_ == 0 || dt <= 0.0 || dt > kLongestGap) {
    velocity_.fill(Eigen::Vector3d::Zero());
  } else {
    const double gain = dt / (dt + kVelocityTimeConstant);
    for (std::size_t j = 0; j < kJointCount; ++j) {
      const Eigen::Vector3d raw =
          rotation_vector(last_pose_.q_PB[j].conjugate() * pose.pose.q_PB[j]) / dt;
      velocity_[j] += gain * (raw - velocity_[j]);
    }
  }
  if (dt > 0.0 || last_stamp_ns_ == 0) {
    last_pose_ = pose.pose;
    last_stamp_ns_ = pose.stamp_ns;
  }
}

// A joint is cued when two results in a row ask it the same way: one may come of noise.
void Coach::confirm(const CorrectionResult& result) noexcept {
  for (std::size_t j = 0; j < kJointCount; ++j) {
    confirmed_[j] = result.target[j].dot(in_use_.target[j]) > 0.0;
  }
}

void Coach::step(const StampedPose& pose, CoachOutput& out) noexcept {
  out.repetition.reset();
  out.handed_over = false;

  // A result is taken whatever the state, so that the solver is free for the next problem.
  if (auto result = solver_->take(pose.frame)) {
    confirm(*result);
    in_use_ = *result;
    in_use_since_ns_ = pose.stamp_ns;
    out.handed_over = true;
  }
  if (in_use_.status != SolverStatus::kNone &&
      seconds(pose.stamp_ns - in_use_since_ns_) > kLongestUse) {
    in_use_ = CorrectionResult{};
  }

  const bool active = !paused_ && !resting_;
  if (active) alignment_ = aligner_.update(pose.stamp_ns, pose.pose);
  if (!paused_) estimate_velocity(pose);
  out.alignment = alignment_;
  joint_errors(*reference_, alignment_.reference_time, pose.pose, out.error);
  set_tolerance(alignment_.reference_time);
  const bool following =
      active && (alignment_.phase == Phase::kMoving || alignment_.phase == Phase::kPaused);
  if (following && alignment_.phase == Phase::kMoving) {
    problem_.habit.note(alignment_.reference_time, out.error);
  }
  if (active) {
    out.repetition =
        scorer_.update(pose.stamp_ns, pose.pose, alignment_, out.error, mapper_.cues_given());
  }

  if (following && solver_->idle() &&
      seconds(pose.stamp_ns - last_posed_ns_) >= kCorrectionPeriod) {
    problem_.frame = pose.frame;
    problem_.stamp_ns = pose.stamp_ns;
    problem_.learner = pose.pose;
    problem_.velocity = velocity_;
    problem_.reference_time = alignment_.reference_time;
    problem_.tempo = alignment_.tempo;
    // What cannot be told is not asked. Where nothing is cued the correction is still published for
    // whoever looks on.
    problem_.askable = mapper_.served();
    if (feedback_.joints.any()) problem_.askable &= feedback_.joints;
    last_posed_ns_ = pose.stamp_ns;
    to_pose_ = true;
  }

  out.correction = in_use_;
  const SafeRangeAlarm* alarm =
      paused_ || muted_ ? nullptr : &safe_range_.update(pose.pose, velocity_);
  out.tactors = cue(pose.stamp_ns, following, out.error, alarm);
}

wire::BoardState Coach::cue(std::int64_t stamp_ns, bool following, const JointVectors& error,
                            const SafeRangeAlarm* alarm) noexcept {
  CorrectionResult wanted;
  std::array<double, kJointCount> tolerance{};
  if (feedback_.yoked) {
    // As if the other one's error were the own: beyond a dead band of zero.
    const double duration = reference_->motion.duration();
    const double share = duration > 0.0 ? alignment_.reference_time / duration : 0.0;
    JointVectors others = zero_vectors();
    wanted.status = SolverStatus::kConverged;
    for (const GivenCue& cue : feedback_.cues) {
      if (share < cue.from || share > cue.to) continue;
      const std::size_t j = index(cue.joint);
      wanted.target[j] = others[j] = cue.ask;
      wanted.benefit[j] = cue.ask.norm();
    }
    return mapper_.update(stamp_ns, wanted, others, tolerance, following && !muted_, alarm);
  }
  wanted = in_use_;
  JointVectors shown;
  const auto usual = [&](std::size_t j) {
    return problem_.habit.at(alignment_.reference_time + alignment_.tempo * kHorizon, j);
  };
  for (std::size_t j = 0; j < kJointCount; ++j) {
    if (!feedback_.joints[j] || !confirmed_[j]) wanted.target[j].setZero();
    tolerance[j] = tolerance_[j] * feedback_.band;
    // What counts is the error when the cue is answered. A prediction alone is no reason to cue:
    // the error must show already, or be usual there.
    const bool due = error[j].norm() > tolerance[j] || usual(j).norm() > tolerance[j];
    shown[j] = due && !wanted.target[j].isZero() ? wanted.expected[j] : error[j];
  }
  const bool enabled =
      following && !muted_ && feedback_.joints.any() && wanted.status != SolverStatus::kNone;
  return mapper_.update(stamp_ns, wanted, shown, tolerance, enabled, alarm);
}

void Coach::pose_problem() noexcept {
  if (!to_pose_) return;
  to_pose_ = false;
  solver_->post(problem_);
  ++posed_;
}

std::uint64_t fingerprint(const Reference& reference) noexcept {
  std::uint64_t hash = 14695981039346656037ull;  // FNV-1a, 64 bit
  const auto mix = [&hash](const double* values, std::size_t count) {
    const auto* bytes = reinterpret_cast<const unsigned char*>(values);
    for (std::size_t i = 0; i < count * sizeof(double); ++i) {
      hash = (hash ^ bytes[i]) * 1099511628211ull;
    }
  };
  for (const Pose& pose : reference.motion.poses) {
    mix(pose.p_WR.data(), 3);
    for (const auto& q : pose.q_PB) mix(q.coeffs().data(), 4);
  }
  mix(reference.weight.data(), reference.weight.size());
  mix(reference.tolerance.data(), reference.tolerance.size());
  for (const auto& band : reference.band) mix(band.data(), band.size());
  return hash;
}

}  // namespace secondskin::coach
