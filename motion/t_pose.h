#pragma once

#include <array>
#include <span>

#include "motion/anatomy.h"

/// The canonical body seen from a T-pose, as avatars (VRM, Unity) and inertial suits (Xsens MVN)
/// have it: their segments' frames are parallel to the world's when the arms are held out to the
/// sides, palms down.
///
/// Frames: B a canonical segment, parallel to W in the canonical rest pose (arms hanging); N the
/// same segment's frame of the T-pose. q_NB is constant: the segment's rotation in W in the T-pose,
/// 90 degrees of pure abduction for upper arm, forearm and hand, none for the rest of the body.
///   q_WN = q_WB q_NB^-1,   q_MN = q_MP q_PB q_NB^-1 with M, P the parent's N, B.
/// Derivation in docs/interchange.md.
namespace secondskin {

/// q_NB of a segment.
Eigen::Quaterniond t_pose_rotation(Joint joint) noexcept;

/// The canonical joints' rotations in the T-pose.
Pose t_pose();

/// A segment of the T-pose's convention in the world.
struct TPoseSegment {
  Eigen::Vector3d p_WN = Eigen::Vector3d::Zero();  ///< its proximal joint [m]
  Eigen::Quaterniond q_WN = Eigen::Quaterniond::Identity();
};

/// A canonical pose as segments in the world.
/// @param X_WB  scratch, one per joint; @param segments  out, one per joint. No allocation.
void to_t_pose_segments(const Skeleton& canonical, const Pose& pose,
                        std::span<Eigen::Isometry3d> X_WB,
                        std::span<TPoseSegment> segments) noexcept;

/// The canonical pose that these segments have; of their positions only the pelvis' counts.
/// @param pose  out, sized by the caller; its confidences are left alone
void from_t_pose_segments(std::span<const TPoseSegment> segments, Pose& pose) noexcept;

/// A canonical skeleton with these joint offsets; what they do not tell (masses, the ends of head,
/// hands and toes) is an average body's in proportion.
/// @param p_MN  each joint in its parent's frame of the T-pose [m]; one per joint, the pelvis'
///              ignored
/// @throws std::runtime_error naming the joint when an offset is not finite, or when thigh and
///         shank make no person's leg (0.2 to 1.5 m)
Skeleton skeleton_from_t_pose(std::span<const Eigen::Vector3d> p_MN);

}  // namespace secondskin
