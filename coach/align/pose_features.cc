#include "coach/align/pose_features.h"

#include <algorithm>
#include <cmath>

namespace secondskin::coach {
namespace {

// How much a limb's turn about itself counts, beside its direction.
constexpr float kTurnShare = 0.2F;

// A joint farther off than this counts hardly more: one arm that does something else must not hide
// where the rest of the body is.
constexpr float kSaturation = 0.5F;  // [rad^2], about 40 degrees

// 8 (1 - |cos(angle / 2)|) = angle^2 + O(angle^4) for quaternions, and 2 (1 - cos(angle)) for
// directions: both monotone in the angle, so no arc cosine is needed.
inline float saturated(float square) noexcept { return square / (1.0F + square / kSaturation); }

inline float limb_square(float turn_cosine, float swing_cosine) noexcept {
  return kTurnShare * 8.0F * (1.0F - turn_cosine) +
         (1.0F - kTurnShare) * 2.0F * (1.0F - swing_cosine);
}

inline float joint_square(Kind kind, float cosine, float swing_cosine) noexcept {
  const float square = kind == Kind::kTilt   ? 2.0F * (1.0F - cosine)
                       : kind == Kind::kLimb ? limb_square(std::fabs(cosine), swing_cosine)
                                             : 8.0F * (1.0F - std::fabs(cosine));
  return std::max(square, 0.0F);
}

// Fills the gaps of a joint (confidence 0) by slerp between the frames around them.
// False when more than a tenth of the frames is missing.
bool bridge_gaps(const Motion& motion, std::size_t joint, std::vector<Eigen::Quaterniond>& q) {
  const std::size_t n = motion.poses.size();
  q.resize(n);
  std::vector<std::size_t> known;
  for (std::size_t i = 0; i < n; ++i) {
    q[i] = motion.poses[i].q_PB[joint];
    if (motion.poses[i].confidence[joint] > 0.0F) known.push_back(i);
  }
  if (known.size() * 10 < n * 9) return false;
  for (std::size_t i = 0; i < n; ++i) {
    if (motion.poses[i].confidence[joint] > 0.0F) continue;
    const auto after = std::lower_bound(known.begin(), known.end(), i);
    if (after == known.begin()) {
      q[i] = q[known.front()];
    } else if (after == known.end()) {
      q[i] = q[known.back()];
    } else {
      const std::size_t a = *(after - 1), b = *after;
      q[i] = motion.poses[a].q_PB[joint].slerp(
          static_cast<double>(i - a) / static_cast<double>(b - a), motion.poses[b].q_PB[joint]);
    }
  }
  return true;
}

}  // namespace

JointFeature joint_feature(Joint joint, const Eigen::Quaterniond& q_PB) noexcept {
  if (joint == Joint::kPelvis) {
    const Eigen::Vector3d up = q_PB.conjugate() * Eigen::Vector3d::UnitZ();
    return {0.0F, static_cast<float>(up.x()), static_cast<float>(up.y()),
            static_cast<float>(up.z())};
  }
  return {static_cast<float>(q_PB.w()), static_cast<float>(q_PB.x()), static_cast<float>(q_PB.y()),
          static_cast<float>(q_PB.z())};
}

Kind kind_of(Joint joint) noexcept {
  switch (joint) {
    case Joint::kPelvis:
      return Kind::kTilt;
    case Joint::kSpineLower:
    case Joint::kSpineUpper:
    case Joint::kNeck:
    case Joint::kHead:
    case Joint::kLeftClavicle:
    case Joint::kRightClavicle:
      return Kind::kTrunk;
    default:
      return Kind::kLimb;
  }
}

std::array<float, 3> limb_direction(const JointFeature& q) noexcept {
  const auto [w, x, y, z] = q;
  return {2.0F * (x * z + w * y), 2.0F * (y * z - w * x), 1.0F - 2.0F * (x * x + y * y)};
}

std::array<float, 3> feature_velocity(Joint joint, const JointFeature& from, const JointFeature& to,
                                      float seconds) noexcept {
  const Kind kind = kind_of(joint);
  if (kind == Kind::kLimb) {
    const auto a = limb_direction(from), b = limb_direction(to);
    return {(b[0] - a[0]) / seconds, (b[1] - a[1]) / seconds, (b[2] - a[2]) / seconds};
  }
  if (kind == Kind::kTilt) {
    return {(to[1] - from[1]) / seconds, (to[2] - from[2]) / seconds, (to[3] - from[3]) / seconds};
  }
  // from^-1 * to, of which twice the vector part is the chord of the rotation.
  const auto& [aw, ax, ay, az] = from;
  const auto& [bw, bx, by, bz] = to;
  const float w = aw * bw + ax * bx + ay * by + az * bz;
  const float scale = (w < 0.0F ? -2.0F : 2.0F) / seconds;
  return {scale * (aw * bx - ax * bw - ay * bz + az * by),
          scale * (aw * by + ax * bz - ay * bw - az * bx),
          scale * (aw * bz - ax * by + ay * bx - az * bw)};
}

ReferenceFeatures::ReferenceFeatures(const Reference& reference, std::size_t stride) {
  const Motion& motion = reference.motion;
  const std::size_t n = motion.poses.size();
  size_ = (n + stride - 1) / stride;
  const auto lag = std::max<std::size_t>(
      1, static_cast<std::size_t>(std::lround(kVelocityLag * motion.rate_hz)));
  std::vector<Eigen::Quaterniond> q;
  std::vector<JointFeature> feature(n);
  double total = 0.0;
  for (std::size_t j = 0; j < kJointCount; ++j) {
    if (reference.weight[j] <= 0.0 || !bridge_gaps(motion, j, q)) continue;
    total += reference.weight[j];
    weight_[j] = static_cast<float>(reference.weight[j]);
    for (std::size_t i = 0; i < n; ++i) feature[i] = joint_feature(static_cast<Joint>(j), q[i]);
    Track track{j, kind_of(static_cast<Joint>(j)), {}, {}, {}, {}};
    for (std::size_t i = 0; i < n; i += stride) {
      // Before the first frame the expert is taken to have been still.
      const std::size_t before = i >= lag ? i - lag : 0;
      const auto velocity =
          feature_velocity(static_cast<Joint>(j), feature[before], feature[i],
                           static_cast<float>(static_cast<double>(lag) / motion.rate_hz));
      for (std::size_t c = 0; c < 4; ++c) track.orientation[c].push_back(feature[i][c]);
      for (std::size_t c = 0; c < 3; ++c) track.velocity[c].push_back(velocity[c]);
      if (track.kind == Kind::kLimb) {
        const auto direction = limb_direction(feature[i]);
        for (std::size_t c = 0; c < 3; ++c) track.direction[c].push_back(direction[c]);
      }
      track.speed_square.push_back(velocity[0] * velocity[0] + velocity[1] * velocity[1] +
                                   velocity[2] * velocity[2]);
    }
    tracks_.push_back(std::move(track));
  }
  if (total > 0.0) {
    for (float& w : weight_) w = static_cast<float>(w / total);
  }
}

void ReferenceFeatures::compare(const LearnerFeatures& learner, std::size_t begin,
                                const FrameCosts& costs) const noexcept {
  const std::size_t n = costs.pose.size();
  float* const pose = costs.pose.data();
  float* const cross = costs.cross.data();
  float* const speed = costs.speed.data();
  std::fill_n(pose, n, 0.0F);
  std::fill_n(cross, n, 0.0F);
  std::fill_n(speed, n, 0.0F);
  for (const Track& track : tracks_) {
    const float w = learner.weight[track.joint];
    if (w <= 0.0F) continue;
    const auto [q0, q1, q2, q3] = learner.orientation[track.joint];
    const auto [v0, v1, v2] = learner.velocity[track.joint];
    const float* const r0 = track.orientation[0].data() + begin;
    const float* const r1 = track.orientation[1].data() + begin;
    const float* const r2 = track.orientation[2].data() + begin;
    const float* const r3 = track.orientation[3].data() + begin;
    const float* const u0 = track.velocity[0].data() + begin;
    const float* const u1 = track.velocity[1].data() + begin;
    const float* const u2 = track.velocity[2].data() + begin;
    const float* const s = track.speed_square.data() + begin;
    // The outputs overlap no input; said so, because the compiler will not check so many arrays.
    if (track.kind == Kind::kTilt) {
#pragma GCC ivdep
      for (std::size_t i = 0; i < n; ++i) {
        const float cosine = q1 * r1[i] + q2 * r2[i] + q3 * r3[i];
        pose[i] += w * saturated(2.0F * (1.0F - cosine));
      }
    } else if (track.kind == Kind::kLimb) {
      const auto [d0, d1, d2] = limb_direction(learner.orientation[track.joint]);
      const float* const e0 = track.direction[0].data() + begin;
      const float* const e1 = track.direction[1].data() + begin;
      const float* const e2 = track.direction[2].data() + begin;
#pragma GCC ivdep
      for (std::size_t i = 0; i < n; ++i) {
        const float turn = std::fabs(q0 * r0[i] + q1 * r1[i] + q2 * r2[i] + q3 * r3[i]);
        const float swing = d0 * e0[i] + d1 * e1[i] + d2 * e2[i];
        pose[i] += w * saturated(limb_square(turn, swing));
      }
    } else {
#pragma GCC ivdep
      for (std::size_t i = 0; i < n; ++i) {
        const float cosine = std::fabs(q0 * r0[i] + q1 * r1[i] + q2 * r2[i] + q3 * r3[i]);
        pose[i] += w * saturated(8.0F * (1.0F - cosine));
      }
    }
#pragma GCC ivdep
    for (std::size_t i = 0; i < n; ++i) {
      cross[i] += w * (v0 * u0[i] + v1 * u1[i] + v2 * u2[i]);
      speed[i] += w * s[i];
    }
  }
}

std::vector<JointFeature> ReferenceFeatures::orientations(std::size_t joint) const {
  std::vector<JointFeature> out;
  for (const Track& track : tracks_) {
    if (track.joint != joint) continue;
    for (std::size_t i = 0; i < size_; ++i) {
      out.push_back({track.orientation[0][i], track.orientation[1][i], track.orientation[2][i],
                     track.orientation[3][i]});
    }
  }
  return out;
}

std::array<JointFeature, kJointCount> ReferenceFeatures::orientations_at(
    std::size_t frame) const noexcept {
  std::array<JointFeature, kJointCount> out{};
  for (const Track& track : tracks_) {
    for (std::size_t c = 0; c < 4; ++c) out[track.joint][c] = track.orientation[c][frame];
  }
  return out;
}

float ReferenceFeatures::distance_square(
    const std::array<JointFeature, kJointCount>& first,
    const std::array<float, kJointCount>& weight,
    const std::array<JointFeature, kJointCount>& second) const noexcept {
  float sum = 0.0F;
  for (const Track& track : tracks_) {
    const JointFeature& a = first[track.joint];
    const JointFeature& b = second[track.joint];
    float cosine = 0.0F, swing = 0.0F;
    for (std::size_t c = 0; c < 4; ++c) cosine += a[c] * b[c];
    if (track.kind == Kind::kLimb) {
      const auto d = limb_direction(a), e = limb_direction(b);
      for (std::size_t c = 0; c < 3; ++c) swing += d[c] * e[c];
    }
    sum += weight[track.joint] * saturated(joint_square(track.kind, cosine, swing));
  }
  return sum;
}

float ReferenceFeatures::distance_square(std::size_t a, std::size_t b) const noexcept {
  float sum = 0.0F;
  for (const Track& track : tracks_) {
    float cosine = 0.0F, swing = 0.0F;
    for (const auto& component : track.orientation) cosine += component[a] * component[b];
    if (track.kind == Kind::kLimb) {
      for (const auto& component : track.direction) swing += component[a] * component[b];
    }
    sum += weight_[track.joint] * saturated(joint_square(track.kind, cosine, swing));
  }
  return sum;
}

}  // namespace secondskin::coach
