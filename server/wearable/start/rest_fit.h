#pragma once

#include <Eigen/Geometry>
#include <array>
#include <span>
#include <vector>

#include "motion/garment.h"
#include "server/wearable/start/rest_finder.h"
#include "server/wearable/start/wearer.h"

/// Fits pose, board placement and bone lengths to what was felt at rest (section 5.4): the
/// accelerometers show where up is, the distances how far the boards are from the sources.
///
/// A small least squares problem with priors, by Gauss-Newton:
///   sum_b |R_WS^T z - a_b / |a_b||^2 / s_g^2 + sum_ij rho((|p_Ui - p_Sj| - d_ij)^2 / s_d^2)
///   + sum_j |theta_j|^2 / s_pose^2 + sum_b |phi_b|^2 / s_mount^2 + |r_b|^2 / s_place^2
///   + sum_k (log l_k)^2 / s_bone,k^2
/// over joint rotations theta, mounting rotations phi and places r of the boards, and bone scales
/// l; rho(u) = log(1 + u): an echo does not pull. Heading cannot be seen and stays as it was.
namespace secondskin::server {

struct RestFitSettings {
  double pose =
      0.02;  ///< how near to the asked pose a person stands, which defines the joints' zero [rad]
  double mounting = 0.06;   ///< of a board whose rotation is known [rad]
  double place = 0.01;      ///< of a board on its segment [m]
  double gravity = 0.01;    ///< of the accelerometers' mean direction: their offsets [rad]
  double distance = 0.012;  ///< of a distance: the sources' places, offsets [m]
};

struct RestFit {
  Skeleton skeleton;
  Pose pose;
  std::vector<Eigen::Isometry3d> X_BS;
  std::array<double, kBones> bone_scale, bone_sigma;  ///< relative to the skeleton given
  double gravity_before = 0.0, gravity = 0.0;    ///< RMS angle between accelerometers and up [rad]
  double distance_before = 0.0, distance = 0.0;  ///< median error; 0 without distances [m]
  std::size_t distances = 0;
};

/// Where the boards of a garment are supposed to be: board_place of each.
std::vector<Eigen::Isometry3d> nominal_places(const Skeleton& canonical, const Garment& garment);

/// @param pose   the pose that the wearer was asked to take
/// @param X_BS   where the boards are supposed to be
/// @param known  per board: whether its rotation is known; one that is not is turned by the least
///               rotation so that gravity agrees, and its heading waits for functional_alignment.h
RestFit fit_rest(const Skeleton& canonical, const std::array<double, kBones>& bone_sigma,
                 const Garment& garment, const Pose& pose, std::span<const Eigen::Isometry3d> X_BS,
                 const std::vector<bool>& known, const Rest& rest,
                 const RestFitSettings& settings = {});

/// A left and a right board that carry each other's readings.
struct Swap {
  std::size_t left, right;  ///< boards of the garment
  double evidence;          ///< -1: wholly as if swapped; +1: as worn rightly
};

/// The pairs of left and right boards whose gravity, distances and hearing fit each other's place:
/// a board hears the sources on its own side, the other ones the body hides. A pair that looks
/// alike either way (both boards hang alike and hear only what is in the middle) is not named;
/// movement may still show it (functional_alignment.h).
std::vector<Swap> swapped_at_rest(const Skeleton& canonical, const Garment& garment,
                                  const Pose& pose, std::span<const Eigen::Isometry3d> X_BS,
                                  const Rest& rest);

/// The pairs of boards that sit on mirrored segments, the left one first.
std::vector<std::pair<std::size_t, std::size_t>> mirrored_boards(const Garment& garment);

}  // namespace secondskin::server
