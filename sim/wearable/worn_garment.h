#pragma once

#include <Eigen/Geometry>
#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "motion/motion.h"
#include "sim/wearable/garment_scene.h"
#include "sim/wearable/smooth_motion.h"

/// A garment on a body that moves by a real motion: what its sensors truly feel, with soft tissue,
/// mounting and sensor errors. The virtual garment's signals (garment_signal.h) and simulated
/// measurements (simulated_measurements.h) are both made from it.
///
/// Frames: W the world, z up; B a segment; S a board as it is really mounted.
namespace secondskin::sim {

/// Immutable; one serves many threads. Two of the same arguments are the same.
class WornGarment final : public GarmentScene {
 public:
  /// Smooths the motion so that it has accelerations and puts the rest pose before it
  /// (smooth_motion.h); scales nothing. Soft tissue moves as lively as the body does: not at all
  /// while it stands still, by the given RMS over the time in which it moves.
  /// @throws std::invalid_argument unless the motion is canonical and has poses
  WornGarment(const Motion& canonical, const Garment& garment, const WornErrors& errors,
              std::uint64_t seed, double rest = 3.0, double blend = 1.5);

  const Garment& garment() const noexcept override { return garment_; }
  const WornErrors& errors() const noexcept override { return errors_; }
  const Skeleton& skeleton() const noexcept { return motion_.skeleton(); }  ///< the true one
  const Skeleton& assumed_skeleton() const noexcept { return assumed_; }    ///< what is measured
  double duration() const noexcept override { return motion_.duration(); }  ///< [s]
  double rest() const noexcept { return rest_; }             ///< how long it stands at first [s]
  double floor() const noexcept { return motion_.floor(); }  ///< height of the floor [m]

  /// X_BS of a board as it is truly mounted, soft tissue at rest.
  const Eigen::Isometry3d& mounted(std::size_t board) const noexcept { return X_BS_[board]; }

  void pose_at(double time, Pose& out) const { motion_.pose_at(time, out); }  ///< the true pose
  /// @param boards  one per board of the garment. No allocation, nor below.
  void boards_at(double time, std::span<BoardTruth> boards) const noexcept override;
  void sources_at(double time, std::span<Eigen::Isometry3d> X_WU) const noexcept;
  /// How much of the direct sound is lost to the body, 0 (free) to 1 (all of it).
  double blocked(double time, std::size_t source, std::size_t board) const;

  void at(double time, GarmentInstant& out) const override;
  /// The floor, and two walls that the body does not come nearer to than about a metre.
  std::span<const Reflector> reflectors() const noexcept override { return reflectors_; }

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
  void build_room();

  Garment garment_;
  WornErrors errors_;
  SmoothMotion motion_;
  double rest_;
  Skeleton assumed_;
  std::vector<Eigen::Isometry3d> X_BS_, X_BU_;
  std::vector<Wobble> board_place_, board_angle_, source_place_;
  std::array<Capsule, kJointCount> capsules_;  ///< that hide sound
  std::vector<Reflector> reflectors_;
  std::vector<double> lively_;  ///< control points of a cubic B-spline
};

}  // namespace secondskin::sim
