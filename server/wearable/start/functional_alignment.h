#pragma once

#include <Eigen/Geometry>
#include <cstdint>
#include <span>
#include <vector>

#include "motion/garment.h"
#include "server/wearable/measurement.h"
#include "server/wearable/start/rest_finder.h"
#include "server/wearable/start/rest_fit.h"

/// How a board is turned about the vertical, from a few movements: gravity at rest tells all of its
/// rotation but that.
///
/// Boards of neighbouring segments share a joint, whose acceleration both tell: carried to the
/// joint and kept upright by the gyroscopes, the two horizontal accelerations differ only by how
/// the boards are turned against each other. That takes any lively movement. How all of them are
/// turned against the body, bending and swinging to the front tells: it turns segments about the
/// body's left-right axis, so that is the direction in which rates spread most, and towards which
/// side it points, the movements' lopsidedness shows (a knee bends one way only, an arm is raised
/// further to the front).
///
/// Frames: B a segment in the pose of rest, y left; S a board; V a board once gravity has been put
/// upright, so that q_BV is a turn about z.
namespace secondskin::server {

/// What the boards felt from a rest on. Grows; at most 60 s are kept.
class Movement {
 public:
  Movement(const Garment& garment, const Rest& rest);

  /// Distances are passed over; a missing reading is taken as the one before.
  void add(const Measurement& measurement);

  /// Board b's readings are those that came as channel[b]; once, when nothing is added any more.
  void reorder(std::span<const std::size_t> channel);

  double duration() const noexcept { return 1e-9 * static_cast<double>(last_ns_ - begin_ns_); }
  std::size_t size() const noexcept { return steps_.size(); }
  double step(std::size_t i) const noexcept { return steps_[i]; }  ///< [s] since the one before
  /// w_WS_S, less the offset at rest [rad/s].
  const Eigen::Vector3d& rate(std::size_t board, std::size_t i) const noexcept {
    return rates_[board][i];
  }
  /// Specific force in S [m/s^2].
  const Eigen::Vector3d& force(std::size_t board, std::size_t i) const noexcept {
    return forces_[board][i];
  }
  bool felt(std::size_t board) const noexcept { return felt_[board] > 0; }

 private:
  std::vector<Eigen::Vector3d> offset_, accel_;  // at rest
  std::vector<double> steps_;
  std::vector<std::vector<Eigen::Vector3d>> rates_, forces_;
  std::vector<std::size_t> felt_;
  std::int64_t begin_ns_, last_ns_;
};

/// What movement told of one board.
struct BoardHeading {
  bool found = false;      ///< it is known well enough to be used
  double turn = 0.0;       ///< to be applied to the board about the vertical [rad]
  double sigma = 3.14;     ///< [rad]
  double moved = 0.0;      ///< RMS rate about horizontal axes [rad/s]
  double clarity = 0.0;    ///< 0: all horizontal axes alike, to 1: one axis only
  double excursion = 0.0;  ///< mean turn about that axis, in its expected direction [rad]
};

/// By each board's own axis of bending.
/// @param X_BS  mountings that put gravity upright (fit_rest); q_WB at rest from `pose`
std::vector<BoardHeading> bending_headings(const Skeleton& canonical, const Garment& garment,
                                           const Pose& pose,
                                           std::span<const Eigen::Isometry3d> X_BS,
                                           const Movement& movement);

/// Two boards' headings against each other.
struct HeadingLink {
  std::size_t parent, child;  ///< boards of the garment
  double turn;                ///< of the child's less the parent's [rad]
  double sigma;               ///< [rad]
  double likeness;            ///< correlation of the joint's acceleration by both, once turned
};

/// By the acceleration of the joint between neighbours; links that tell nothing are left out.
std::vector<HeadingLink> joint_headings(const Skeleton& canonical, const Garment& garment,
                                        const Pose& pose, std::span<const Eigen::Isometry3d> X_BS,
                                        const Movement& movement);

/// Both together, by least squares. @param known  how surely each board's heading is known before
/// [rad]; infinite where it is not
std::vector<BoardHeading> functional_headings(const Skeleton& canonical, const Garment& garment,
                                              const Pose& pose,
                                              std::span<const Eigen::Isometry3d> X_BS,
                                              const Movement& movement,
                                              std::span<const double> known);

/// Turns a board's mounting about the vertical of the rest pose.
void turn_about_vertical(const Skeleton& canonical, const SensorBoard& board, const Pose& pose,
                         double turn, Eigen::Isometry3d& X_BS);

/// Boards of neighbouring segments of one limb turn at the same times. Where each goes with the
/// other side's neighbour, names the pair that is swapped; of a limb with two boards it cannot be
/// told which of the two pairs, and both are named. Mountings do not matter. A whole limb that is
/// swapped looks like a right one.
std::vector<Swap> swapped_by_movement(const Garment& garment, const Movement& movement);

}  // namespace secondskin::server
