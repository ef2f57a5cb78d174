#include "coach/align/learner_stream.h"

#include <algorithm>
#include <cmath>

namespace secondskin::coach {

bool LearnerStream::take(double time, const Pose& learner,
                         const std::array<float, kJointCount>& weight, const PostureOffset& posture,
                         LearnerFeatures& out) noexcept {
  const Past* before = nullptr;
  double nearest = 0.5 * kVelocityLag;
  for (std::size_t i = 0; i < size_; ++i) {
    const double off = std::fabs(time - history_[i].time - kVelocityLag);
    if (off < nearest) {
      nearest = off;
      before = &history_[i];
    }
  }
  Past now;
  now.time = time;
  double total = 0.0;
  for (std::size_t j = 0; j < kJointCount; ++j) {
    const auto joint = static_cast<Joint>(j);
    out.weight[j] = 0.0F;
    now.known[j] = learner.confidence[j] > 0.0F;
    now.measured[j] = out.measured[j] = joint_feature(joint, learner.q_PB[j]);
    out.orientation[j] = posture.without(j, now.measured[j]);
    out.velocity[j] = {};
    if (!now.known[j] || weight[j] <= 0.0F) continue;
    if (before != nullptr) {
      if (!before->known[j]) continue;  // back since less than the lag
      out.velocity[j] =
          feature_velocity(joint, posture.without(j, before->measured[j]), out.orientation[j],
                           static_cast<float>(time - before->time));
    }
    out.weight[j] = weight[j] * std::min(learner.confidence[j], 1.0F);
    total += out.weight[j];
  }
  out.has_velocity = before != nullptr;
  if (size_ == 0 || time - history_[last_].time >= kHistoryStep) {
    last_ = size_ == 0 ? 0 : (last_ + 1) % kHistory;
    size_ = std::min(size_ + 1, kHistory);
    history_[last_] = now;
  }
  if (total <= 0.0) return false;
  double squares = 0.0;
  out.speed_square = 0.0F;
  for (std::size_t j = 0; j < kJointCount; ++j) {
    const auto w = static_cast<float>(out.weight[j] / total);
    out.weight[j] = w;
    squares += static_cast<double>(w) * w;
    const auto& v = out.velocity[j];
    out.speed_square += w * (v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
  }
  out.joints = static_cast<float>(1.0 / squares);
  return true;
}

}  // namespace secondskin::coach
