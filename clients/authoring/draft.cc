#include "clients/authoring/draft.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <sstream>
#include <stdexcept>

#include "coach/align/expert_average.h"
#include "motion/bvh.h"
#include "motion/kinematics.h"
#include "motion/rotation.h"

namespace secondskin::authoring {
namespace {

constexpr double kDegree = std::numbers::pi / 180.0;
constexpr std::size_t kRoot = index(Joint::kPelvis);

// Tolerances: what is measured no better, and no tighter or wider than makes sense.
constexpr double kFloor = 6.0 * kDegree, kEndFloor = 15.0 * kDegree;
constexpr double kWidest = 40.0 * kDegree;
constexpr double kEndDefault = 20.0 * kDegree;
constexpr double kStep = 1.0 * kDegree;

// Weights: a joint that stays still may matter too, as the back in a squat.
constexpr double kLeastWeight = 0.3, kEndShare = 0.3;
constexpr double kWhole = 40.0 * kDegree;  // of range weighs fully
constexpr double kFootMoves = 0.12;        // an ankle that leaves its place by more [m]

bool at_the_end(std::size_t j) {
  const auto joint = static_cast<Joint>(j);
  return joint == Joint::kLeftWrist || joint == Joint::kRightWrist || joint == Joint::kLeftToes ||
         joint == Joint::kRightToes;
}

double apart(std::size_t j, const Eigen::Quaterniond& a, const Eigen::Quaterniond& b) {
  if (j != kRoot) return geodesic_distance(a, b);
  const Eigen::Vector3d up = Eigen::Vector3d::UnitZ();
  return std::acos(std::clamp((a.conjugate() * up).dot(b.conjugate() * up), -1.0, 1.0));
}

double range_of(const Motion& motion, std::size_t j) {
  const std::size_t step = std::max<std::size_t>(1, motion.poses.size() / 60);
  double most = 0.0;
  for (std::size_t a = 0; a < motion.poses.size(); a += step) {
    for (std::size_t b = 0; b < a; b += step) {
      most = std::max(most, apart(j, motion.poses[a].q_PB[j], motion.poses[b].q_PB[j]));
    }
  }
  return most;
}

bool measured(std::span<const Motion> parts, std::size_t j) {
  return std::any_of(parts.begin(), parts.end(), [j](const Motion& part) {
    return std::any_of(part.poses.begin(), part.poses.end(),
                       [j](const Pose& pose) { return pose.confidence[j] > 0.0F; });
  });
}

// docs/references.md, equations 4 to 6.
JointProposal propose(std::span<const Motion> parts, const coach::ExpertAverage& average,
                      std::size_t j) {
  JointProposal joint;
  joint.measured = measured(parts, j);
  joint.range = range_of(average.motion, j);
  double squares = 0.0;
  for (const auto& frame : average.spread) squares += frame[j] * frame[j];
  joint.spread = std::sqrt(squares / static_cast<double>(average.spread.size()));

  const auto n = static_cast<double>(parts.size());
  const double allowed =
      parts.size() > 1 ? coach::kBandSpreads * (1.0 + 0.5 / (n - 1.0)) * joint.spread : 0.0;
  const double base = parts.size() > 1
                          ? std::hypot(at_the_end(j) ? kEndFloor : kFloor, allowed)
                          : (at_the_end(j) ? kEndDefault : coach::kDefaultTolerance_deg * kDegree);
  joint.tolerance = std::min(kWidest, kStep * std::ceil(base / kStep - 1e-6));

  const double signal = joint.range * joint.range;
  const double noise = allowed * allowed;
  const double repeatable = signal + noise > 0.0 ? signal / (signal + noise) : 1.0;
  const double weight =
      (kLeastWeight + (1.0 - kLeastWeight) * std::min(1.0, joint.range / kWhole) * repeatable) *
      (at_the_end(j) ? kEndShare : 1.0);
  joint.weight = joint.measured ? std::round(10.0 * weight) / 10.0 : 0.0;
  return joint;
}

bool stands(const Motion& motion) {
  std::vector<Eigen::Isometry3d> X_WB(kJointCount), first;
  for (const Pose& pose : motion.poses) {
    forward_kinematics(motion.skeleton, pose.p_WR, pose.q_PB, X_WB);
    if (first.empty()) first = X_WB;
    for (const Joint ankle : {Joint::kLeftAnkle, Joint::kRightAnkle}) {
      const std::size_t j = index(ankle);
      if ((X_WB[j].translation() - first[j].translation()).norm() > kFootMoves) return false;
    }
  }
  return true;
}

}  // namespace

JointMap canonical_names(const std::filesystem::path& joint_maps) {
  return JointMap::choose(joint_maps, canonical_skeleton());
}

Motion as_saved(const Motion& canonical, const JointMap& map) {
  std::stringstream file;
  write_bvh(canonical, file);
  Motion motion = to_canonical(read_bvh(file, "part").motion, map).motion;
  return motion;
}

Draft make_draft(std::span<const Motion> parts, const std::optional<ByJoint>& weights,
                 const JointMap& map) {
  if (parts.empty()) throw std::invalid_argument("parts: expected at least one");
  Draft draft{.parts = {},
              .mean = {canonical_skeleton(), coach::kReferenceRate, {}},
              .spread = {},
              .when = {},
              .joints = {}};
  for (const Motion& part : parts) {
    if (!is_canonical(part.skeleton)) {
      throw std::invalid_argument("parts: expected motions on the canonical skeleton");
    }
    draft.parts.push_back(as_saved(part, map));
  }
  ByJoint all;
  all.fill(1.0);
  const auto propose_from = [&](const coach::ExpertAverage& average) {
    // `parts`: a file does not say what was not measured.
    for (std::size_t j = 0; j < kJointCount; ++j) draft.joints[j] = propose(parts, average, j);
  };
  if (!weights) propose_from(coach::average_experts(draft.parts, all, coach::kReferenceRate));
  ByJoint used = all;
  for (std::size_t j = 0; j < kJointCount; ++j) {
    used[j] = weights ? (*weights)[j] : draft.joints[j].weight;
  }
  auto average = coach::average_experts(draft.parts, used, coach::kReferenceRate);
  const auto proposed = draft.joints;
  propose_from(average);
  if (!weights) {
    // What is proposed is what was used.
    for (std::size_t j = 0; j < kJointCount; ++j) draft.joints[j].weight = proposed[j].weight;
  }
  draft.mean = std::move(average.motion);
  draft.spread = std::move(average.spread);
  draft.standing = stands(draft.mean);
  for (const Motion& part : draft.parts) {
    const Motion at_rate = resample(part, coach::kReferenceRate);
    auto frames = coach::warp_onto(draft.mean, at_rate, used);
    for (double& frame : frames) frame /= coach::kReferenceRate;
    draft.when.push_back(std::move(frames));
  }
  return draft;
}

}  // namespace secondskin::authoring
