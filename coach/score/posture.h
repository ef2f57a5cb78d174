#pragma once

#include <array>
#include <bitset>
#include <cstdint>
#include <span>
#include <string_view>
#include <vector>

#include "motion/anatomy.h"
#include "motion/motion.h"

/// What a physiotherapist sees of a pose: how deep, how upright, where knees and arms point,
/// whether left is as right. Numbers that depend on joint rotations only, so neither on body size
/// nor on place and heading. docs/scoring.md, section 2.
namespace secondskin::coach {

inline constexpr std::size_t kPostureCount = 37;

/// Values by feature; angles in rad, the depth in leg lengths; NaN where not measured.
using Posture = std::array<double, kPostureCount>;

/// What features are judged together; the clinical criteria of Williams et al. 2019, table 4.
enum class Criterion : std::uint8_t { kDepth, kTrunk, kHead, kLegs, kArms, kSymmetry };
inline constexpr std::size_t kCriterionCount = 6;

/// Some of the joints.
using JointSet = std::bitset<kJointCount>;

struct PostureFeature {
  std::string_view name;  ///< e.g. "left_thigh_forward"
  Criterion criterion{};
  std::array<JointSet, 2> own;  ///< what it shows; the second is the other side, empty for none
  JointSet chain;               ///< every joint that it depends on
  std::size_t mirrored = 0;     ///< the feature that it becomes in a mirror,
  double mirrored_sign = 1.0;   ///< times this
};

const std::array<PostureFeature, kPostureCount>& posture_features() noexcept;

/// The features of a canonical pose.
/// @param needed  joints without which a feature is NaN; another joint that the pose does not have
///                (confidence 0, or not finite) counts as straight
Posture posture_of(const Pose& pose, const JointSet& needed) noexcept;

/// Joints with confidence above 0 in at least half of a motion's poses.
JointSet measured_joints(const Motion& motion);

/// Several experts' posture along their mean motion, and how much they differ.
struct PostureModel {
  JointSet needed;                         ///< joints that the experts show
  std::vector<Posture> mean;               ///< by frame of the mean motion
  std::vector<Posture> spread;             ///< standard deviation of the experts from it
  std::vector<Posture> spread_from_start;  ///< the same of what changed since the start
  Posture range{};                         ///< greatest less least value over a repetition
  Posture range_spread{};

  bool empty() const noexcept { return mean.empty(); }
};

/// The start posture is the mean over this long [s].
inline constexpr double kStartTime = 0.2;

/// Experts' spreads are pooled with the tolerances, which count as this many experts.
inline constexpr double kPriorExperts = 4.0;

/// @param mean       the experts' mean motion (average_experts)
/// @param experts    the performances at any rate; with fewer than two the spread is from the
///                   tolerances alone
/// @param weight     how much a joint counts when a performance is warped onto the mean
/// @param tolerance  of each joint [rad]: two standard deviations of what is right
PostureModel posture_model(const Motion& mean, std::span<const Motion> experts,
                           const std::array<double, kJointCount>& weight,
                           const std::array<double, kJointCount>& tolerance);

/// The same along a motion of so many frames (at least one) that is done faster or slower.
PostureModel stretched(const PostureModel& model, std::size_t frames);

/// Left and right exchanged.
PostureModel mirrored(const PostureModel& model);

}  // namespace secondskin::coach
