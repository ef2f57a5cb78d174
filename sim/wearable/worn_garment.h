#pragma once

#include <Eigen/Geometry>
#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "motion/garment.h"
#include "motion/motion.h"
#include "sim/wearable/acoustic_shadow.h"
#include "sim/wearable/smooth_motion.h"

/// A garment on a body that moves by a real motion: what its sensors truly feel, with soft tissue,
/// mounting and sensor errors. The virtual garment's signals (garment_signal.h) and simulated
/// measurements (simulated_measurements.h) are both made from it.
///
/// Frames: W the world, z up; B a segment; S a board as it is really mounted.
namespace secondskin::sim {

/// How the truth differs from what the filter assumes. RMS, of a vector over its three axes
/// together unless it says otherwise; each run draws its own from the seed. The defaults are a real
/// garment's on a real body.
struct WornErrors {
  double mounting_angle = 0.0873;  ///< of a board: 5 degrees [rad]
  double mounting_place = 0.01;    ///< of a board [m]
  double source_place = 0.005;     ///< of a source: less, as they sit on plates on the trunk [m]
  double bone = 0.01;              ///< relative error of each segment's length
  double tissue_place = 0.005;     ///< soft tissue moves boards and sources against the bone [m]
  double tissue_angle = 0.0524;    ///< the same, of boards: 3 degrees [rad]
  double tissue_hz = 3.0;          ///< its spectrum is even from 0.2 Hz up to here
  double gyro_noise = 0.002;       ///< of a sample and axis (5.2) [rad/s]
  double accel_noise = 0.02;       ///< of a sample and axis (5.2) [m/s^2]
  double gyro_bias = 0.0052;       ///< of an axis: 0.3 degrees/s, before rest zeroing [rad/s]
  double gyro_bias_walk = 2e-5;    ///< of an axis [rad/s per sqrt(s)]
  double accel_bias = 0.05;        ///< of an axis [m/s^2]
  double scale = 0.005;            ///< relative, of an axis
  double distance_noise = 0.0025;  ///< of a strong signal (5.2) [m]

  /// Sensors and body as the filter assumes them.
  static WornErrors none();
};

inline constexpr double kGravity = 9.80665;  ///< [m/s^2]

/// What a board truly feels, and where it is.
struct BoardTruth {
  Eigen::Isometry3d X_WS = Eigen::Isometry3d::Identity();  ///< soft tissue included
  Eigen::Vector3d v = Eigen::Vector3d::Zero();             ///< of S's origin in W [m/s]
  Eigen::Vector3d a = Eigen::Vector3d::Zero();             ///< of S's origin in W [m/s^2]
  Eigen::Vector3d gyro = Eigen::Vector3d::Zero();          ///< w_WS_S without sensor errors [rad/s]
  Eigen::Vector3d accel =
      Eigen::Vector3d::Zero();  ///< specific force in S without sensor errors [m/s^2]
};

/// Immutable; one serves many threads. Two of the same arguments are the same.
class WornGarment {
 public:
  /// Smooths the motion so that it has accelerations and puts the rest pose before it
  /// (smooth_motion.h); scales nothing. Soft tissue moves as lively as the body does: not at all
  /// while it stands still, by the given RMS over the time in which it moves.
  /// @throws std::invalid_argument unless the motion is canonical and has poses
  WornGarment(const Motion& canonical, const Garment& garment, const WornErrors& errors,
              std::uint64_t seed, double rest = 3.0, double blend = 1.5);

  const Garment& garment() const noexcept { return garment_; }
  const WornErrors& errors() const noexcept { return errors_; }
  const Skeleton& skeleton() const noexcept { return motion_.skeleton(); }  ///< the true one
  const Skeleton& assumed_skeleton() const noexcept { return assumed_; }    ///< what is measured
  double duration() const noexcept { return motion_.duration(); }           ///< [s]
  double rest() const noexcept { return rest_; }             ///< how long it stands at first [s]
  double floor() const noexcept { return motion_.floor(); }  ///< height of the floor [m]

  /// X_BS of a board as it is truly mounted, soft tissue at rest.
  const Eigen::Isometry3d& mounted(std::size_t board) const noexcept { return X_BS_[board]; }

  void pose_at(double time, Pose& out) const { motion_.pose_at(time, out); }  ///< the true pose
  /// @param boards  one per board of the garment. No allocation, nor below.
  void boards_at(double time, std::span<BoardTruth> boards) const noexcept;
  void sources_at(double time, std::span<Eigen::Isometry3d> X_WU) const noexcept;
  /// How much of the direct sound is lost to the body, 0 (free) to 1 (all of it).
  double blocked(double time, std::size_t source, std::size_t board) const;

  /// All that the signals of one slot are made of.
  struct Instant {
    std::vector<BoardTruth> boards;
    std::vector<Eigen::Isometry3d> sources;  ///< X_WU
    std::vector<Limb> limbs;
  };
  /// @param out  reused; allocates the first time only
  void at(double time, Instant& out) const;
  /// What is left of a source's sound at each board at that instant. @param wavelength [m]
  void shadows(const Instant& instant, std::size_t source, double wavelength,
               std::span<Shadow> out) const noexcept;

 private:
  /// A band-limited random process of three axes with unit RMS over them together.
  struct Wobble {
    static constexpr std::size_t kTones = 8;
    Eigen::Array<double, 3, kTones> omega, phase;
  };
  struct Moved {
    Eigen::Vector3d value, first, second;
  };
  struct Liveliness {
    double value, first, second;
  };

  Liveliness liveliness(double time) const noexcept;
  static Moved moved(const Wobble& wobble, const Liveliness& g, double rms, double time) noexcept;
  void boards_at(double time, const BodyMotion& body, std::span<BoardTruth> boards) const noexcept;
  void sources_at(double time, const BodyMotion& body,
                  std::span<Eigen::Isometry3d> X_WU) const noexcept;
  void limbs_at(const BodyMotion& body, std::span<Limb> limbs) const noexcept;
  void find_liveliness();

  Garment garment_;
  WornErrors errors_;
  SmoothMotion motion_;
  double rest_;
  Skeleton assumed_;
  std::vector<Eigen::Isometry3d> X_BS_, X_BU_;
  std::vector<Wobble> board_place_, board_angle_, source_place_;
  std::array<Capsule, kJointCount> capsules_;  ///< that hide sound
  std::vector<double> lively_;                 ///< control points of a cubic B-spline
};

}  // namespace secondskin::sim
