#pragma once

#include <array>
#include <cstdint>
#include <numbers>
#include <string_view>

#include "motion/skeleton.h"

/// The canonical humanoid: 22 joints with anatomical movements, limits and segment masses.
///
/// In the canonical rest pose the body stands upright, faces +x, arms hanging with the palms to the
/// thighs; every segment's frame is parallel to the world's (x forward, y left, z up). All
/// anatomical angles are 0 there. Every importer retargets to this set (retarget.h), and everything
/// right of the capture server knows only this set.
namespace secondskin {

/// Index of each joint in a canonical skeleton and its poses.
enum class Joint : std::uint8_t {
  kPelvis,
  kSpineLower,
  kSpineMiddle,
  kSpineUpper,
  kNeck,
  kHead,
  kLeftClavicle,
  kLeftShoulder,
  kLeftElbow,
  kLeftWrist,
  kRightClavicle,
  kRightShoulder,
  kRightElbow,
  kRightWrist,
  kLeftHip,
  kLeftKnee,
  kLeftAnkle,
  kLeftToes,
  kRightHip,
  kRightKnee,
  kRightAnkle,
  kRightToes,
};
inline constexpr std::size_t kJointCount = 22;
constexpr std::size_t index(Joint j) noexcept { return static_cast<std::size_t>(j); }

/// A joint's movements in the words of anatomy, positive for flexion (dorsiflexion), abduction and
/// internal rotation. On the midline: flexion forward, "abduction" to the right and rotation to the
/// left, as ISB has them (Wu et al. 2002, J. Biomech. 35:543).
enum class Movement : std::uint8_t { kFlexion, kAbduction, kRotation };
inline constexpr std::array<std::string_view, 3> kMovementNames{"flexion", "abduction", "rotation"};

/// Angles of one joint [rad], indexed by Movement.
using JointAngles = std::array<double, 3>;

/// How a joint's rotation is read as anatomical angles.
enum class AngleConvention : std::uint8_t {
  /// Cardan: flexion about the parent's y, abduction about the floating x, rotation about the own z
  /// (Grood & Suntay 1983; Wu et al. 2002). Singular at 90 degrees of abduction.
  kCardanYXZ,
  /// Cardan from the outside in the reverse order: rotation about the vertical, obliquity about the
  /// floating x, tilt about the own y, so that tilt does not depend on the heading (Baker 2001,
  /// Gait
  /// Posture 13:1). For the pelvis in the world.
  kCardanZXY,
  /// Swing and twist: the rotation vector of the swing gives flexion and abduction, the twist about
  /// the limb's own z gives rotation. The Cartesian form of ISB's elevation plane and elevation
  /// (Wu et al. 2005, J. Biomech. 38:981): regular but for the arm pointing straight up.
  kSwingTwist,
};

struct AngleRange {
  double min;  ///< [rad]
  double max;  ///< [rad]
};

/// What a joint can do. A movement that the joint does not have has min == max == 0.
struct JointAnatomy {
  std::string_view name;  ///< canonical name, e.g. "left_knee"
  Joint parent;           ///< the pelvis names itself
  AngleConvention convention;
  std::array<Eigen::Vector3d, 3> axis;  ///< unit axis of each positive movement in the rest frame
  std::array<AngleRange, 3> range;      ///< by Movement
  std::array<double, 3> max_speed;      ///< fastest voluntary movement [rad/s], by Movement
};

/// The canonical joints in the order of Joint. Sources of the figures stand in anatomy.cc.
const std::array<JointAnatomy, kJointCount>& canonical_anatomy() noexcept;

std::string_view joint_name(Joint joint) noexcept;
std::optional<Joint> find_joint(std::string_view name) noexcept;

/// The joint on the body's other side; midline joints are their own.
Joint mirrored(Joint joint) noexcept;

/// A canonical skeleton of an average adult's proportions and segment masses.
/// @param stature  body height, 0.5 to 2.5 [m]; @throws std::invalid_argument outside
Skeleton canonical_skeleton(double stature = 1.75);

/// Whether a skeleton has exactly the canonical joints in canonical order.
[[nodiscard]] bool is_canonical(const Skeleton& skeleton) noexcept;

/// A joint's rotation in anatomical angles, and back. joint_rotation(j, joint_angles(j, q)) == q
/// but at the convention's singularity.
JointAngles joint_angles(Joint joint, const Eigen::Quaterniond& q_PB) noexcept;
Eigen::Quaterniond joint_rotation(Joint joint, const JointAngles& angles) noexcept;

/// The same pose reflected in the body's median plane (left and right exchanged): the root keeps
/// its height and mirrors y.
Pose mirrored(const Pose& canonical);

}  // namespace secondskin
