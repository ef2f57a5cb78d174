#pragma once

#include <cmath>
#include <numbers>

#include "motion/anatomy.h"

/// What a virtual learner is like. Every figure stands with its source in docs/study.md; those
/// marked (N) have none that could be read as text: neutral values, chosen before the first study
/// was run and not changed since.
namespace secondskin::sim {

struct LearnerParameters {
  static constexpr double kDegree = std::numbers::pi / 180.0;

  // ---- the body
  /// Wrong idea of the motion: of each movement of each joint over all of it, and besides that of
  /// each quarter of it; standard deviations over people [rad]. Together as large as the errors of
  /// the real learners that come with six references: root mean squares of 5.9 to 9.2 degrees over
  /// the movements of the joints that matter (docs/study.md).
  double bias = 6.0 * kDegree;
  double bias_of_quarter = 3.0 * kDegree;
  /// Variability from moment to moment, with its correlation time [rad, s]. (N)
  double noise = 1.5 * kDegree;
  double noise_time = 0.3;
  /// Physiological tremor is at 8 to 12 Hz; its amplitude (N) [rad, Hz].
  double tremor = 0.1 * kDegree;
  double tremor_hz = 10.0;
  /// Tempo of a repetition, relative standard deviation. Weber fraction of produced intervals. (N)
  double tempo = 0.05;

  // ---- seeing
  /// One joint is looked at for so long; a fixation [s]. (N)
  double glance = 0.3;
  /// From what is seen to the movement that follows [s]. The refractory period of a zero-order
  /// task: van de Kamp et al. 2013, PLoS Comput. Biol. 9(1):e1002843.
  double visual_delay = 0.25;
  /// Estimates of an elbow's angle: 70.8 % within 5 degrees, which is 1.054 standard deviations
  /// (Abu-Rajab et al. 2010, Eur. J. Orthop. Surg. Traumatol. 20:463) [rad].
  double visual_noise = 5.0 / 1.054 * kDegree;
  /// Less is not acted upon; the same study's unit of agreement [rad].
  double visual_dead_zone = 5.0 * kDegree;

  // ---- feeling
  /// Faintest vibration that is felt, as a share of the actuator's strongest: 2 to 6 % on the arm
  /// (Front. Neurosci. 2022, 16:958415); the upper end.
  double threshold = 0.06;
  /// Weber fraction of the vibration's strength, the same study.
  double weber = 0.20;
  /// To a vibration at the wrist with nothing else to do, mean and deviation [s]. (N)
  double reaction_time = 0.25;
  double reaction_deviation = 0.05;
  /// A second task costs more than 130 ms (Bao et al. 2019, PLoS ONE 14(8):e0219737) [s].
  double second_task = 0.13;
  /// A cue that is felt is not noticed: distraction costs 5 to 20 % of recognition (Oakley & Park
  /// 2008, "Did you feel something?"); the middle, a little rounded down.
  double missed = 0.10;
  /// One site of four around the arm is told in more than 95 % (vibrations of the forearm, six
  /// experiments, KU AXIS lab 2026); the rest is taken for its neighbour.
  double misread = 0.05;
  /// Each further cue at the same time: all of three are told in 27.8 % (Wang et al. 2018, IEEE
  /// Trans. Haptics 11(1):97), falling linearly with their number: (0.95 - 0.278) / 2.
  double misread_with_each = 0.336;

  // ---- moving
  /// From one correction to the next: refractory period, as above [s].
  double refractory = 0.25;
  /// Share of the way that one correction goes. (N)
  double share = 0.5;
  /// What the faintest and the strongest vibration are told to mean [rad]: docs/tactile.md.
  double faintest_means = 3.0 * kDegree;
  double strongest_means = 27.0 * kDegree;
  /// Time constant of a correction's movement, and of the drift back to what is usual [s]. (N)
  double movement_time = 0.1;
  double drift_time = 1.0;
  /// Whether corrections that were begun since something was felt or seen are taken off what it
  /// seemed to need (a Smith predictor: Miall et al. 1993, J. Mot. Behav. 25:203). Added after the
  /// first study, whose learner had none, and off: docs/study.md has both.
  bool predicts = false;

  // ---- learning
  /// Retention and learning rate of a repetition, fast and slow: Smith, Ghazizadeh & Shadmehr 2006,
  /// PLoS Biol. 4(6):e179.
  double fast_retention = 0.59, fast_rate = 0.21;
  double slow_retention = 0.992, slow_rate = 0.02;
  /// Time constants of forgetting without practice [s]. Within minutes the fast memory is gone or
  /// has become slow, over a day the slow one declines slowly (Criscimagna-Hemminger & Shadmehr
  /// 2008, J. Neurosci. 28:9610, who give no such constants). (N)
  double fast_forgetting = 120.0, slow_forgetting = 86'400.0;
  /// Guidance: how much of what is learnt by touch is bound to being touched, for someone who has
  /// come to depend on it wholly; and the rate per repetition at which that comes and goes. The
  /// effect is known (feedback +0.87 while on, -0.74 when removed), its rates are not. (N)
  double bound = 0.5;
  double dependence_rate = 0.1;
};

/// Reaction is later away from the hand: 20 to 120 ms by location (Bao et al. 2019). Which place
/// has how much of it is ours.
inline double location_delay(Joint segment) noexcept {
  switch (segment) {
    case Joint::kLeftElbow:  // the forearm
    case Joint::kRightElbow:
    case Joint::kLeftWrist:
    case Joint::kRightWrist:
      return 0.0;
    case Joint::kLeftShoulder:  // the upper arm
    case Joint::kRightShoulder:
      return 0.020;
    case Joint::kLeftHip:  // the leg
    case Joint::kRightHip:
    case Joint::kLeftKnee:
    case Joint::kRightKnee:
    case Joint::kLeftAnkle:
    case Joint::kRightAnkle:
      return 0.120;
    default:
      return 0.070;
  }
}

}  // namespace secondskin::sim
