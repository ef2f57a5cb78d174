#pragma once

#include <deque>
#include <optional>
#include <random>
#include <span>

#include "motion/motion.h"
#include "sim/learner/motor_memory.h"
#include "sim/learner/tactile_sense.h"

/// A person who practises a motion: has a wrong idea of it, sees a little of what is wrong, feels
/// tactors, corrects while moving, learns, forgets, and may come to depend on being cued.
/// docs/study.md has the equations.
///
/// The pose of joint j at the share s of the motion is
///   q_j = q_j,reference(s) * exp(b_j(s) + m_j(s) + u_j + noise)
/// with the wrong idea b, the memory of corrections m and the correction under way u, rotation
/// vectors in the joint's frame.
namespace secondskin::sim {

/// What the person knows beforehand.
struct Lesson {
  const Motion* reference = nullptr;  ///< canonical; outlives the learner
  /// How much a joint is known to matter, 0 to 1; 0: it is no part of what is to be learnt, and
  /// there is no wrong idea of it.
  std::array<double, kJointCount> weight{};
  std::vector<WornTactor> tactors;  ///< told
  bool repulsive = true;            ///< told: move away from vibration, or towards it
};

class VirtualLearner {
 public:
  /// Two learners with the same seed have the same body, wrong ideas, and noise.
  VirtualLearner(Lesson lesson, const LearnerParameters& parameters, std::uint64_t seed);

  /// Whether the expert can be seen.
  void see(bool visible) noexcept { sees_ = visible; }
  /// What the board does at a time; between two poses as often as taps need.
  void feel(double time, const std::array<double, wire::kTactorCount>& amplitude);
  /// The pose at a time [s]; repetitions follow one another with a short stand between them.
  const Pose& move(double time);
  /// Leaves off for a while, between two repetitions: the next move() is so much later [s].
  void rest(double seconds) noexcept;

  /// Repetitions done.
  std::size_t repetitions() const noexcept { return repetitions_; }
  /// The true place in the reference [s]; nothing between repetitions.
  std::optional<double> reference_time() const noexcept;
  double dependence() const noexcept { return memory_.dependence(); }
  /// Cues that were acted upon.
  std::uint64_t reactions() const noexcept { return reactions_; }
  /// Of those, how many went the way in which something was missing when they began, and how many
  /// another way; the rest came between repetitions.
  std::uint64_t right() const noexcept { return right_; }
  std::uint64_t wrong() const noexcept { return wrong_; }

 private:
  enum class Part { kReady, kMove, kHold, kReturn };
  struct Sight {
    double due, seen;
    std::size_t joint;
    Eigen::Vector3d needed;
  };
  struct Correction {
    double time;
    std::size_t joint;
    Eigen::Vector3d by;
  };

  void act(const FeltCue& cue);
  void look(double time);
  void correct(std::size_t joint, const Eigen::Vector3d& by);
  /// What is left of a need that showed at a time, after what was begun since.
  Eigen::Vector3d left_of(const Eigen::Vector3d& needed, std::size_t joint,
                          double showed) const noexcept;
  void go_on(double dt);
  double share() const noexcept;
  /// The share of a rotation that the joint can do.
  Eigen::Vector3d possible(std::size_t joint, const Eigen::Vector3d& rotation) const noexcept;
  /// b + m + u: from the reference to the learner, noise left out [rad].
  Eigen::Vector3d offset(std::size_t joint, double share) const noexcept;

  Lesson lesson_;
  LearnerParameters p_;
  std::mt19937_64 body_random_, noise_random_, sight_random_;
  TactileSense sense_;
  MotorMemory memory_;
  std::array<Eigen::Vector3d, kJointCount> bias_;
  std::array<std::array<Eigen::Vector3d, kQuarters>, kJointCount> bias_of_quarter_;
  std::array<Eigen::Vector3d, kJointCount> noise_, aim_, under_way_;
  std::array<double, kJointCount> tremor_phase_{};
  std::deque<Sight> seen_;
  std::deque<Correction> begun_;  ///< of the last seconds
  double next_glance_ = 0.0;
  bool sees_ = true;

  double time_ = 0.0;
  bool began_ = false;
  Part part_ = Part::kReady;
  double in_part_ = 0.0;  ///< [s]
  double tempo_ = 1.0;
  bool cued_ = false, cued_before_ = false;  ///< in this repetition, in the last one
  std::size_t repetitions_ = 0;
  std::uint64_t reactions_ = 0, right_ = 0, wrong_ = 0;
  Pose reference_pose_, pose_, end_pose_;
};

}  // namespace secondskin::sim
