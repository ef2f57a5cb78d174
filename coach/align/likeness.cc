#include "coach/align/likeness.h"

#include <algorithm>
#include <cmath>

namespace secondskin::coach {
namespace {

// From one feature to another: a direction's change, or the chord of the rotation between.
std::array<float, 3> way_between(std::size_t joint, const JointFeature& from,
                                 const JointFeature& to) noexcept {
  return feature_velocity(static_cast<Joint>(joint), from, to, 1.0F);
}

JointFeature mean_of(std::size_t joint, const std::vector<JointFeature>& features) {
  JointFeature sum{};
  for (const JointFeature& f : features) {
    float dot = 0.0F;
    for (std::size_t c = 0; c < 4; ++c) dot += f[c] * features.front()[c];
    const float sign = dot < 0.0F && static_cast<Joint>(joint) != Joint::kPelvis ? -1.0F : 1.0F;
    for (std::size_t c = 0; c < 4; ++c) sum[c] += sign * f[c];
  }
  float square = 0.0F;
  for (const float c : sum) square += c * c;
  for (float& c : sum) c /= std::sqrt(std::max(square, 1e-12F));
  return sum;
}

constexpr std::size_t kLimbs = 5;
constexpr double kLimbShare = 0.15;  // of the expert's way: a limb that matters here

std::size_t limb_of(Joint joint) noexcept {
  if (joint >= Joint::kLeftClavicle && joint <= Joint::kLeftWrist) return 1;
  if (joint >= Joint::kRightClavicle && joint <= Joint::kRightWrist) return 2;
  if (joint >= Joint::kLeftHip && joint <= Joint::kLeftToes) return 3;
  if (joint >= Joint::kRightHip && joint <= Joint::kRightToes) return 4;
  return 0;
}

}  // namespace

Likeness::Likeness(const Reference& reference) {
  const ReferenceFeatures features(reference, 1);
  for (std::size_t j = 0; j < kJointCount; ++j) {
    if (features.weight()[j] <= 0.0F) continue;
    Track track{j, features.weight()[j], {}, {}};
    const std::vector<JointFeature> expert = features.orientations(j);
    track.mean = mean_of(j, expert);
    for (const JointFeature& f : expert) track.way.push_back(way_between(j, track.mean, f));
    tracks_.push_back(std::move(track));
  }
  sums_.resize(tracks_.size());
}

void Likeness::clear() noexcept {
  std::fill(sums_.begin(), sums_.end(), Sums{});
  time_ = 0.0;
}

void Likeness::fade(double keep) noexcept {
  for (Sums& s : sums_) {
    s.time *= keep;
    for (std::size_t c = 0; c < 3; ++c) s.learner[c] *= keep, s.expert[c] *= keep;
    s.learner_square *= keep;
    s.expert_square *= keep;
    s.product *= keep;
  }
  time_ *= keep;
}

void Likeness::add(const LearnerFeatures& learner, double position, double dt) noexcept {
  time_ += dt;
  for (std::size_t k = 0; k < tracks_.size(); ++k) {
    const Track& track = tracks_[k];
    if (learner.weight[track.joint] <= 0.0F) continue;
    const auto last = static_cast<double>(track.way.size() - 1);
    const Way& e = track.way[static_cast<std::size_t>(std::clamp(position + 0.5, 0.0, last))];
    const Way l = way_between(track.joint, track.mean, learner.measured[track.joint]);
    Sums& s = sums_[k];
    s.time += dt;
    for (std::size_t c = 0; c < 3; ++c) {
      s.learner[c] += dt * l[c];
      s.expert[c] += dt * e[c];
      s.learner_square += dt * l[c] * l[c];
      s.expert_square += dt * e[c] * e[c];
      s.product += dt * l[c] * e[c];
    }
  }
}

Likeness::Value Likeness::value() const noexcept {
  std::array<std::array<double, 3>, kLimbs> limbs{};
  double weight = 0.0, learner = 0.0, expert = 0.0, product = 0.0;
  for (std::size_t k = 0; k < tracks_.size(); ++k) {
    const Sums& s = sums_[k];
    if (s.time <= 0.0) continue;
    double ll = s.learner_square, ee = s.expert_square, le = s.product;
    for (std::size_t c = 0; c < 3; ++c) {
      ll -= s.learner[c] * s.learner[c] / s.time;
      ee -= s.expert[c] * s.expert[c] / s.time;
      le -= s.learner[c] * s.expert[c] / s.time;
    }
    weight += tracks_[k].weight;
    learner += tracks_[k].weight * std::max(ll, 0.0) / s.time;
    expert += tracks_[k].weight * std::max(ee, 0.0) / s.time;
    product += tracks_[k].weight * le / s.time;
    auto& limb = limbs[limb_of(static_cast<Joint>(tracks_[k].joint))];
    limb[0] += tracks_[k].weight * std::max(ll, 0.0) / s.time;
    limb[1] += tracks_[k].weight * std::max(ee, 0.0) / s.time;
    limb[2] += tracks_[k].weight * le / s.time;
  }
  if (weight <= 0.0) return {};
  double least = 1.0;
  for (const auto& [l, e, le] : limbs) {
    if (e > kLimbShare * expert) least = std::min(least, le / std::max(std::sqrt(l * e), 1e-12));
  }
  return {product / std::max(std::sqrt(learner * expert), 1e-12), std::sqrt(learner / weight),
          std::sqrt(expert / weight), least};
}

}  // namespace secondskin::coach
