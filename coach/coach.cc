#include "coach/coach.h"

#include "motion/rotation.h"

namespace secondskin::coach {
namespace {

// First-order low-pass of the differenced joint velocities: quiet enough for a prediction over the
// solver's horizon, late by no more than a frame or two.
constexpr double kVelocityTimeConstant = 0.03;  // [s]
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
               .duration_scaled = tactile.duration_scaled,
               .command_lifetime = kCommandLifetime},
              tactile.exposure),
      scorer_(reference),
      solver_(&solver),
      last_pose_(kJointCount) {
  problem_.learner = Pose(kJointCount);
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

void Coach::step(const StampedPose& pose, CoachOutput& out) noexcept {
  out.repetition.reset();
  out.handed_over = false;

  // A result is taken whatever the state, so that the solver is free for the next problem.
  if (auto result = solver_->take(pose.frame)) {
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
  for (std::size_t j = 0; j < kJointCount; ++j) {
    if (!feedback_.joints[j]) wanted.target[j].setZero();
    tolerance[j] = tolerance_[j] * feedback_.band;
  }
  const bool enabled =
      following && !muted_ && feedback_.joints.any() && wanted.status != SolverStatus::kNone;
  return mapper_.update(stamp_ns, wanted, error, tolerance, enabled, alarm);
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
