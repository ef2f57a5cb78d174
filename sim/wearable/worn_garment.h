#pragma once

#include <Eigen/Geometry>
#include <cstdint>
#include <random>
#include <span>
#include <vector>

#include "motion/garment.h"
#include "motion/kinematics.h"
#include "motion/motion.h"

/// A garment on a body that moves by a real motion: what its sensors truly feel, with soft tissue,
/// mounting and sensor errors. The virtual garment's signals (garment_signal.h) and simulated
/// measurements (simulated_measurements.h) are both made from it.
///
/// Frames: W the world, z up; B a segment; S a board as it is really mounted.
namespace secondskin::sim {

/// How the truth differs from what the filter assumes. Standard deviations; each run draws its own
/// from the seed. The defaults are a real garment's on a real body.
struct WornErrors {
  double mounting_angle = 0.0873;  ///< of a board about each axis, 5 degrees RMS in all [rad]
  double mounting_place = 0.01;    ///< [m]
  double bone = 0.01;              ///< relative error of each segment's length
  double tissue_place = 0.005;     ///< soft tissue moves a board against the bone, RMS [m]
  double tissue_angle = 0.0524;    ///< 3 degrees RMS [rad]
  double tissue_hz = 3.0;          ///< how fast: correlation as of a resonance near gait's
  double gyro_noise = 0.002;       ///< a sample (5.2) [rad/s]
  double accel_noise = 0.02;       ///< a sample (5.2) [m/s^2]
  double gyro_bias = 0.0052;       ///< 0.3 degrees/s, before rest zeroing [rad/s]
  double gyro_bias_walk = 2e-5;    ///< [rad/s per sqrt(s)]
  double accel_bias = 0.05;        ///< [m/s^2]
  double scale = 0.005;            ///< relative
  double distance_noise = 0.0025;  ///< (5.2) [m]
};

/// What a board truly feels, and where it is.
struct BoardTruth {
  Eigen::Isometry3d X_WS = Eigen::Isometry3d::Identity();  ///< soft tissue included
  Eigen::Vector3d gyro = Eigen::Vector3d::Zero();          ///< w_WS_S without sensor errors [rad/s]
  Eigen::Vector3d accel = Eigen::Vector3d::Zero();  ///< specific force in S without sensor errors
};

class WornGarment {
 public:
  /// Smooths the motion so that it has accelerations (cubic B-splines through the poses), scales
  /// nothing. The body begins with `rest` seconds in the canonical rest pose, from which it moves
  /// into the motion's first pose within `blend` seconds.
  /// @throws std::invalid_argument unless the motion is canonical and has poses
  WornGarment(const Motion& canonical, const Garment& garment, const WornErrors& errors,
              std::uint64_t seed, double rest = 3.0, double blend = 1.5);

  const Garment& garment() const noexcept;
  const Skeleton& skeleton() const noexcept;  ///< the true one
  Skeleton assumed_skeleton() const;          ///< with the bone errors: what the filter is given
  double duration() const noexcept;           ///< [s]

  void pose_at(double time, Pose& out) const;  ///< the true pose
  void boards_at(double time, std::span<BoardTruth> boards) const;
  void sources_at(double time, std::span<Eigen::Isometry3d> X_WU) const;
  /// Whether a segment of the body stands between a source and a board, 0 (free) to 1 (blocked
  /// wholly): how much of the direct sound is lost.
  double blocked(double time, std::size_t source, std::size_t board) const;
};

}  // namespace secondskin::sim
