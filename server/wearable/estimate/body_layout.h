#pragma once

#include <Eigen/Geometry>
#include <array>
#include <span>
#include <vector>

#include "motion/garment.h"

/// Which joints a body filter's state holds, in which columns.
///
/// Each joint that has a board at or beyond it is in the state; the others (toes) keep the rotation
/// of the start. Joints in a row whose segments carry no board between them (neck and head;
/// spine_lower and spine_middle) are a chain: boards tell the sum of their rotations, and how it is
/// shared out only by lever arms. The filter moves a chain together and holds its members alike by
/// a soft prior (docs/wearable-filter.md).
///
/// Columns of the error state, with d = 3 * joints + 3 and nb boards:
///   level * d + 3 * joint: rotation (level 0), rate w_PB_B (1) and acceleration (2) of a joint,
///   level * d + 3 * joints: position, velocity and acceleration of the root in W, then
///   gyro bias, accelerometer bias, mounting rotation (three a board each), speed of sound.
namespace secondskin::server {

struct BodyLayout {
  /// @throws std::invalid_argument unless the skeleton is canonical
  BodyLayout(const Skeleton& canonical, const Garment& garment);

  static constexpr int kNoGroup = -1;          ///< not in the state
  std::array<int, kJointCount> group_of{};     ///< of a segment's joint; the root has group 0
  std::array<bool, kJointCount> sensed{};      ///< whether a board sits on the segment
  std::vector<std::vector<std::size_t>> path;  ///< from the root to each segment, both included
  std::vector<std::vector<int>> chains;  ///< joints of the state, the root not; most are alone
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
