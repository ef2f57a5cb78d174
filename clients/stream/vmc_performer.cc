#include "clients/stream/vmc_performer.h"

namespace secondskin::stream {
namespace {

// Of the OK message (VMC protocol 2.5): bones are being sent, calibrated, normal mode.
constexpr std::int32_t kLoaded = 1, kCalibrated = 3, kNormalMode = 0;

wire::OscMessage transform(std::string_view address, std::string_view name,
                           const UnityTransform& at) {
  wire::OscMessage message(address);
  message.add(name);
  for (const float value : at.position) message.add(value);
  for (const float value : at.rotation) message.add(value);
  return message;
}

}  // namespace

UnityTransform to_unity(const Eigen::Vector3d& p, const Eigen::Quaterniond& q) noexcept {
  const Eigen::Vector3f a = p.cast<float>();
  const Eigen::Quaternionf r = q.normalized().cast<float>();
  return {{-a.y(), a.z(), a.x()}, {r.y(), -r.z(), -r.x(), r.w()}};
}

std::array<UnityTransform, kJointCount> unity_bones(const Skeleton& body,
                                                    const Pose& pose) noexcept {
  std::array<UnityTransform, kJointCount> bones;
  for (std::size_t j = 0; j < kJointCount; ++j) {
    const Eigen::Quaterniond q_BN = t_pose_rotation(static_cast<Joint>(j)).conjugate();
    if (j == 0) {
      bones[j] = to_unity(pose.p_WR, pose.q_PB[j] * q_BN);
      continue;
    }
    const Eigen::Quaterniond q_MP = t_pose_rotation(canonical_anatomy()[j].parent);
    bones[j] = to_unity(q_MP * body[j].p_PB, q_MP * pose.q_PB[j] * q_BN);
  }
  return bones;
}

std::vector<wire::Datagram> VmcPerformer::encode(const StampedPose& pose) {
  if (!body_) return {};
  if (!start_ns_) start_ns_ = pose.stamp_ns;
  std::vector<wire::OscMessage> messages;
  messages.reserve(3 + kJointCount);
  messages.emplace_back("/VMC/Ext/OK").add(kLoaded).add(kCalibrated).add(kNormalMode);
  messages.emplace_back("/VMC/Ext/T")
      .add(static_cast<float>(1e-9 * static_cast<double>(pose.stamp_ns - *start_ns_)));
  const UnityTransform origin{{0, 0, 0}, {0, 0, 0, 1}};
  messages.push_back(transform("/VMC/Ext/Root/Pos", "root", origin));
  const auto bones = unity_bones(*body_, pose.pose);
  for (std::size_t j = 0; j < kJointCount; ++j) {
    messages.push_back(transform("/VMC/Ext/Bone/Pos", kUnityBones[j], bones[j]));
  }
  return wire::osc_bundles(messages, kMostBytes);
}

}  // namespace secondskin::stream
