#pragma once

#include <array>

#include "motion/anatomy.h"

/// What a learner usually gets wrong, and where in the motion: the mean error of each joint over
/// the repetitions so far. People repeat their errors, so the habit tells the error that is about
/// to come before it shows; a cue needs a reaction time to be answered.
namespace secondskin::coach {

/// Rotation vectors by joint, each in the joint's own frame B: q_PB * exp(v). [rad]
using JointVectors = std::array<Eigen::Vector3d, kJointCount>;

/// Zero for every joint. JointVectors{} would not do: Eigen leaves its vectors unset.
inline JointVectors zero_vectors() noexcept {
  JointVectors zero;
  for (Eigen::Vector3d& v : zero) v.setZero();
  return zero;
}

/// A value; copied with the problem that it belongs to. Nothing here allocates or throws.
class Habit {
 public:
  /// @param duration  of the reference [s]
  explicit Habit(double duration) noexcept;

  /// Takes the errors of one instant. Time counts as progress in the reference: standing still
  /// teaches nothing, and after a jump it begins anew.
  void note(double reference_time, const JointVectors& error) noexcept;

  /// The usual error of one joint at a time, drawn to zero as far as it is not known [rad].
  Eigen::Vector3d at(double reference_time, std::size_t joint) const noexcept;
  /// How well it is known there: 0 never seen, 1 seen in many repetitions.
  double known(double reference_time) const noexcept;

 private:
  static constexpr std::size_t kPlaces = 32;  ///< along the reference, linear between

  struct Between {
    std::size_t place;  ///< and the next one
    double share;       ///< of the next one
  };
  Between between(double reference_time) const noexcept;

  double step_;  ///< between two places [s]
  double last_;  ///< of note(); NaN before the first [s]
  std::array<JointVectors, kPlaces> mean_;
  std::array<double, kPlaces> known_{};
};

}  // namespace secondskin::coach
