#include "coach/align/posture_offset.h"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace secondskin::coach {
namespace {

constexpr std::size_t kPelvisIndex = index(Joint::kPelvis);

constexpr float kDegree = std::numbers::pi_v<float> / 180.0F;

// An offset of this size is as likely noise as posture: one much smaller is left alone.
constexpr float kNoise = 6.0F * kDegree;
constexpr float kMost = 30.0F * kDegree;  // no more is believed to be posture

using Vector = std::array<float, 3>;

JointFeature product(const JointFeature& a, const JointFeature& b) noexcept {
  return {a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
          a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
          a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
          a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0]};
}

JointFeature inverse(const JointFeature& q) noexcept { return {q[0], -q[1], -q[2], -q[3]}; }

// Of a rotation vector up to half a turn.
JointFeature quaternion(const Vector& v) noexcept {
  const float angle = std::sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
  const float scale = angle > 1e-6F ? std::sin(0.5F * angle) / angle : 0.5F;
  return {std::cos(0.5F * angle), scale * v[0], scale * v[1], scale * v[2]};
}

Vector rotation_vector(const JointFeature& q) noexcept {
  const float sine = std::sqrt(q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
  const float sign = q[0] < 0.0F ? -1.0F : 1.0F;
  const float scale =
      sine > 1e-6F ? sign * 2.0F * std::atan2(sine, std::fabs(q[0])) / sine : sign * 2.0F;
  return {scale * q[1], scale * q[2], scale * q[3]};
}

}  // namespace

void PostureOffset::clear() noexcept {
  offset_.fill({});
  applied_.fill({1.0F, 0.0F, 0.0F, 0.0F});
}

void PostureOffset::learn(const LearnerFeatures& learner,
                          const std::array<JointFeature, kJointCount>& expert,
                          float share) noexcept {
  for (std::size_t j = 0; j < kJointCount; ++j) {
    const JointFeature& e = expert[j];
    if (learner.weight[j] <= 0.0F || e == JointFeature{}) continue;
    const JointFeature& l = learner.measured[j];
    Vector seen;
    if (j == kPelvisIndex) {  // the turn that takes the learner's direction to the expert's, undone
      const Vector axis{e[2] * l[3] - e[3] * l[2], e[3] * l[1] - e[1] * l[3],
                        e[1] * l[2] - e[2] * l[1]};
      const float sine = std::sqrt(axis[0] * axis[0] + axis[1] * axis[1] + axis[2] * axis[2]);
      const float cosine = e[1] * l[1] + e[2] * l[2] + e[3] * l[3];
      const float scale = sine > 1e-6F ? std::atan2(sine, cosine) / sine : 1.0F;
      seen = {scale * axis[0], scale * axis[1], scale * axis[2]};
    } else {
      seen = rotation_vector(product(inverse(e), l));
    }
    const float size = std::sqrt(seen[0] * seen[0] + seen[1] * seen[1] + seen[2] * seen[2]);
    const float bound = size > kMost ? kMost / size : 1.0F;
    for (std::size_t c = 0; c < 3; ++c) {
      offset_[j][c] += share * (bound * seen[c] - offset_[j][c]);
    }
    apply(j);
  }
}

void PostureOffset::forget(float share) noexcept {
  for (std::size_t j = 0; j < kJointCount; ++j) {
    for (float& c : offset_[j]) c *= 1.0F - share;
    apply(j);
  }
}

void PostureOffset::apply(std::size_t joint) noexcept {
  const Vector& v = offset_[joint];
  const float square = v[0] * v[0] + v[1] * v[1] + v[2] * v[2];
  const float scale = square > kNoise * kNoise ? 1.0F - kNoise * kNoise / square : 0.0F;
  applied_[joint] = inverse(quaternion({scale * v[0], scale * v[1], scale * v[2]}));
}

JointFeature PostureOffset::turned(std::size_t joint, const JointFeature& by,
                                   const JointFeature& feature) noexcept {
  // A direction turns as (0, g); an orientation takes the offset on its own side.
  if (joint == kPelvisIndex) return product(product(by, feature), inverse(by));
  return product(feature, by);
}

}  // namespace secondskin::coach
