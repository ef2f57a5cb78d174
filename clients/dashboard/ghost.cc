#include "clients/dashboard/ghost.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "motion/kinematics.h"
#include "motion/rotation.h"

namespace secondskin::dashboard {
namespace {

// The floor is the lowest that the learner was; an outlier is forgotten at this rate, slow enough
// that a jump is none [m a pose].
constexpr double kFloorRise = 0.0005;

double leg_length(const Skeleton& canonical) {
  return canonical[index(Joint::kLeftKnee)].p_PB.norm() +
         canonical[index(Joint::kLeftAnkle)].p_PB.norm();
}

}  // namespace

Ghost::Ghost(std::shared_ptr<const coach::Reference> reference, const Skeleton& learner)
    : reference_(std::move(reference)),
      learner_(learner),
      X_WB_(kJointCount),
      floor_(std::numeric_limits<double>::infinity()) {
  const Motion& motion = reference_->motion;
  const double expert_legs = leg_length(motion.skeleton);
  if (expert_legs > 0.0) scale_ = leg_length(learner_) / expert_legs;
  clearance_.reserve(motion.poses.size());
  for (const Pose& pose : motion.poses) clearance_.push_back(lowest(motion.skeleton, pose));
  const double floor = *std::min_element(clearance_.begin(), clearance_.end());
  for (double& height : clearance_) height -= floor;
}

double Ghost::lowest(const Skeleton& skeleton, const Pose& pose) {
  forward_kinematics(skeleton, pose.p_WR, pose.q_PB, X_WB_);
  double z = std::numeric_limits<double>::infinity();
  for (std::size_t j = 0; j < skeleton.size(); ++j) {
    z = std::min({z, X_WB_[j].translation().z(), (X_WB_[j] * skeleton[j].p_BE).z()});
  }
  return z;
}

void Ghost::place(double reference_time, const Pose& learner, Pose& ghost) {
  floor_ = std::min(floor_ + kFloorRise, lowest(learner_, learner));

  const Motion& motion = reference_->motion;
  const double time =
      std::isfinite(reference_time) ? std::clamp(reference_time, 0.0, motion.duration()) : 0.0;
  if (ghost.q_PB.size() != kJointCount) ghost = Pose(kJointCount);
  sample(motion, time, ghost);

  // About the vertical as near to the learner's pelvis as it can be: the turn that joint_errors()
  // does not count.
  const Eigen::Vector3d up = Eigen::Vector3d::UnitZ();
  const double heading = twist_angle(learner.q_PB[0] * ghost.q_PB[0].conjugate(), up);
  ghost.q_PB[0] = (Eigen::AngleAxisd(heading, up) * ghost.q_PB[0]).normalized();

  ghost.p_WR = {learner.p_WR.x(), learner.p_WR.y(), 0.0};
  const auto frame = static_cast<std::size_t>(std::lround(time * motion.rate_hz));
  const double clearance = scale_ * clearance_[std::min(frame, clearance_.size() - 1)];
  ghost.p_WR.z() = floor_ + clearance - lowest(learner_, ghost);
}

}  // namespace secondskin::dashboard
