#pragma once

#include <Eigen/Core>
#include <array>

#include "motion/anatomy.h"
#include "sim/learner/learner_parameters.h"

/// What a learner remembers of corrections: for each joint and quarter of the motion a fast and a
/// slow state after Smith, Ghazizadeh & Shadmehr 2006 (PLoS Biol. 4(6):e179),
///   x_f(n+1) = A_f x_f(n) + B_f e(n),  x_s(n+1) = A_s x_s(n) + B_s e(n),
/// with e the correction that repetition n was found to need [rad]; and the same once more for the
/// part that is bound to being cued.
namespace secondskin::sim {

inline constexpr std::size_t kQuarters = 4;

/// How much each quarter has to say at a share of the motion, 0 to 1: hats about the middle of
/// each, which sum to 1.
std::array<double, kQuarters> quarters_at(double share) noexcept;

class MotorMemory {
 public:
  explicit MotorMemory(const LearnerParameters& parameters) noexcept;

  /// The correction that is added to the movement at a share of the motion [rad].
  /// @param cued  whether the bound part is to be had
  Eigen::Vector3d correction(std::size_t joint, double share, bool cued) const noexcept;

  /// Notes during a repetition that a correction was found to be needed.
  void note(std::size_t joint, double share, const Eigen::Vector3d& needed, bool by_touch) noexcept;
  /// Ends the repetition: learns and forgets.
  /// @param cued  whether any cue was felt in it
  void learn(bool cued) noexcept;
  /// Time without practice [s].
  void rest(double seconds) noexcept;

  /// 0 not at all, to 1.
  double dependence() const noexcept { return dependence_; }

 private:
  struct State {
    Eigen::Vector3d fast = Eigen::Vector3d::Zero(), slow = Eigen::Vector3d::Zero();
    Eigen::Vector3d bound_fast = Eigen::Vector3d::Zero(), bound_slow = Eigen::Vector3d::Zero();
    Eigen::Vector3d noted = Eigen::Vector3d::Zero();
    double weight = 0.0, by_touch = 0.0;
  };
  LearnerParameters p_;
  std::array<std::array<State, kQuarters>, kJointCount> states_{};
  double dependence_ = 0.0;
};

}  // namespace secondskin::sim
