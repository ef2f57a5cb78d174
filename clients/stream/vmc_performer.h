#pragma once

#include <array>
#include <optional>
#include <string_view>

#include "clients/stream/pose_encoder.h"
#include "motion/t_pose.h"

/// Poses in the Virtual Motion Capture protocol (protocol.vmc.info, "performer" to "marionette"),
/// as avatars in Unity, Unreal, Blender and Godot take them: OSC over UDP.
///
/// Frames: U is Unity's world, left-handed, x right, y up, z forward; W ours (x forward, y left,
/// z up). C takes W to U: (x, y, z) -> (-y, z, x), a reflection, so a rotation with the quaternion
/// (w, v) becomes (w, -C v). Bones turn against the T-pose, each in its parent's frame N of
/// motion/t_pose.h. docs/interchange.md has the equations.
namespace secondskin::stream {

/// A place and an orientation in Unity's convention.
struct UnityTransform {
  std::array<float, 3> position;  ///< x right, y up, z forward [m]
  std::array<float, 4> rotation;  ///< unit quaternion, x y z w
};
UnityTransform to_unity(const Eigen::Vector3d& p, const Eigen::Quaterniond& q) noexcept;

/// The canonical joints as Unity's HumanBodyBones names them.
inline constexpr std::array<std::string_view, kJointCount> kUnityBones{
    "Hips",          "Spine",         "Chest",         "UpperChest",    "Neck",
    "Head",          "LeftShoulder",  "LeftUpperArm",  "LeftLowerArm",  "LeftHand",
    "RightShoulder", "RightUpperArm", "RightLowerArm", "RightHand",     "LeftUpperLeg",
    "LeftLowerLeg",  "LeftFoot",      "LeftToes",      "RightUpperLeg", "RightLowerLeg",
    "RightFoot",     "RightToes"};

/// Each bone's place and rotation in its parent bone, against the T-pose; the hips' in the world.
std::array<UnityTransform, kJointCount> unity_bones(const Skeleton& body,
                                                    const Pose& pose) noexcept;

class VmcPerformer final : public PoseEncoder {
 public:
  void set_body(const Skeleton& body) override { body_ = body; }
  /// /VMC/Ext/OK, /VMC/Ext/T, /VMC/Ext/Root/Pos and a /VMC/Ext/Bone/Pos for each bone.
  std::vector<wire::Datagram> encode(const StampedPose& pose) override;

 private:
  std::optional<Skeleton> body_;
  std::optional<std::int64_t> start_ns_;
};

}  // namespace secondskin::stream
