#pragma once

#include <Eigen/Geometry>
#include <array>
#include <span>
#include <vector>

#include "motion/garment.h"

/// Which rotations of a body the filter's state holds, and in which columns.
///
/// A group is one or more joints in a row that share one rotation: those whose segments carry no
/// board turn with the next segment towards one (of spine_lower and spine_middle only the sum is
/// known, each is given half of it; so with neck and head). Joints that have no board beyond them
/// (toes) are not in the state; they keep the pose of the start.
///
/// Columns of the error state, with d = 3 * groups + 3 and nb boards:
///   level * d + 3 * group: rotation (level 0), rate w_PB_B (1) and acceleration (2) of a group,
///   level * d + 3 * groups: position, velocity and acceleration of the root in W, then
///   gyro bias, accelerometer bias, mounting rotation (three a board each), speed of sound.
namespace secondskin::server {

struct BodyLayout {
  /// @throws std::invalid_argument unless the skeleton is canonical
  BodyLayout(const Skeleton& canonical, const Garment& garment);

  static constexpr int kNoGroup = -1;
  std::array<int, kJointCount> group_of{};     ///< of a segment's joint; the root has group 0
  std::array<bool, kJointCount> sensed{};      ///< whether a board sits on the segment
  std::vector<std::vector<std::size_t>> path;  ///< from the root to each segment, both included
  int groups = 0;
  int boards = 0;

  int level_size() const noexcept { return 3 * groups + 3; }
  int rotation(int group, int level) const noexcept { return level * level_size() + 3 * group; }
  int root(int level) const noexcept { return level * level_size() + 3 * groups; }
  int moving() const noexcept { return 3 * level_size(); }  ///< columns that time changes
  int gyro_bias(std::size_t board) const noexcept { return moving() + 3 * static_cast<int>(board); }
  int accel_bias(std::size_t board) const noexcept { return gyro_bias(board) + 3 * boards; }
  int mount(std::size_t board) const noexcept { return gyro_bias(board) + 6 * boards; }
  int sound() const noexcept { return moving() + 9 * boards; }
  int size() const noexcept { return sound() + 1; }
};

}  // namespace secondskin::server
