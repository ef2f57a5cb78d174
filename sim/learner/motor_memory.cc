#include "sim/learner/motor_memory.h"

#include <algorithm>
#include <cmath>

namespace secondskin::sim {

std::array<double, kQuarters> quarters_at(double share) noexcept {
  std::array<double, kQuarters> hats{};
  const double at = std::clamp(share * kQuarters - 0.5, 0.0, static_cast<double>(kQuarters - 1));
  const auto below = std::min<std::size_t>(static_cast<std::size_t>(at), kQuarters - 2);
  hats[below + 1] = at - static_cast<double>(below);
  hats[below] = 1.0 - hats[below + 1];
  return hats;
}

MotorMemory::MotorMemory(const LearnerParameters& parameters) noexcept : p_(parameters) {}

Eigen::Vector3d MotorMemory::correction(std::size_t joint, double share, bool cued) const noexcept {
  const auto hats = quarters_at(share);
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  for (std::size_t q = 0; q < kQuarters; ++q) {
    const State& s = states_[joint][q];
    sum += hats[q] * (s.fast + s.slow);
    if (cued) sum += hats[q] * (s.bound_fast + s.bound_slow);
  }
  return sum;
}

void MotorMemory::note(std::size_t joint, double share, const Eigen::Vector3d& needed,
                       bool by_touch) noexcept {
  const auto hats = quarters_at(share);
  for (std::size_t q = 0; q < kQuarters; ++q) {
    State& s = states_[joint][q];
    s.noted += hats[q] * needed;
    s.weight += hats[q];
    if (by_touch) s.by_touch += hats[q];
  }
}

void MotorMemory::learn(bool cued) noexcept {
  for (auto& joint : states_) {
    for (State& s : joint) {
      // Less than a whole look says as much less.
      const Eigen::Vector3d e = s.noted / std::max(1.0, s.weight);
      const double bound = s.weight > 0.0 ? p_.bound * dependence_ * s.by_touch / s.weight : 0.0;
      s.fast = p_.fast_retention * s.fast + p_.fast_rate * (1.0 - bound) * e;
      s.slow = p_.slow_retention * s.slow + p_.slow_rate * (1.0 - bound) * e;
      s.bound_fast = p_.fast_retention * s.bound_fast + p_.fast_rate * bound * e;
      s.bound_slow = p_.slow_retention * s.bound_slow + p_.slow_rate * bound * e;
      s.noted.setZero();
      s.weight = s.by_touch = 0.0;
    }
  }
  dependence_ += p_.dependence_rate * ((cued ? 1.0 : 0.0) - dependence_);
}

void MotorMemory::rest(double seconds) noexcept {
  const double fast = std::exp(-seconds / p_.fast_forgetting);
  const double slow = std::exp(-seconds / p_.slow_forgetting);
  for (auto& joint : states_) {
    for (State& s : joint) {
      s.fast *= fast;
      s.bound_fast *= fast;
      s.slow *= slow;
      s.bound_slow *= slow;
    }
  }
}

}  // namespace secondskin::sim
