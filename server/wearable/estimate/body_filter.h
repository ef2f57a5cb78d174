#pragma once

#include <Eigen/Geometry>
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "motion/garment.h"
#include "server/wearable/measurement.h"

/// The Extended Kalman Filter of Practical Motion Capture (section 5) over the joints of a body
/// that wears a garment: turns measurements into the pose. Equations, process and measurement
/// noise, and what they were tuned on: docs/wearable-filter.md.
///
/// Frames: W the world, z up; R the root; B a segment, P its parent; S a board, X_BS where it is
/// assumed to be mounted.
namespace secondskin::server {

/// Standard deviations unless said otherwise. The defaults are for a garment on a body, whose soft
/// tissue moves: far above the sensors' own noise (section 5.2).
struct FilterSettings {
  double joint_jerk = 1000.0;  ///< spectral density, root, of a joint's jerk [rad/s^3 / sqrt(Hz)]
  double chain_jerk = 50.0;    ///< of joints that no board tells apart, against each other
  double root_turn_jerk = 1000.0;  ///< the same of the root's rotation
  double root_jerk = 200.0;        ///< of the root's position [m/s^3 / sqrt(Hz)]
  double gyro_noise = 0.2;         ///< a sample [rad/s]
  double rate_error = 2.4;         ///< of the rates that joints turn under (observation.h) [rad/s]
  double accel_noise = 10.0;       ///< a sample [m/s^2]
  double arm_sigma = 0.1;          ///< of lever arms, as felt by accelerometers (observation.h) [m]
  double distance_noise = 0.07;    ///< at confidence 1; divided by the confidence (5.2) [m]
  double gate = 0.999;             ///< probability that a good reading passes
  bool use_gyro = true, use_accel = true, use_distances = true;
  bool limits = true;  ///< joint limits, and bounds on what is not measured, as observations

  // What is unknown at the start, and how fast it may change.
  double pose_sigma = 0.01;       ///< of each joint [rad]
  double mount_sigma = 0.09;      ///< of a board's turn on its segment about the vertical [rad]
  double mount_tilt = 0.01;       ///< of its tilt, which gravity tells at rest [rad]
  double mount_walk = 5e-4;       ///< [rad per sqrt(s)]
  double gyro_bias_walk = 1e-4;   ///< [rad/s per sqrt(s)]
  double accel_bias_walk = 1e-3;  ///< [m/s^2 per sqrt(s)]
  double sound_sigma = 0.01;      ///< relative error of the speed of sound
  double sound_walk = 1e-4;       ///< [per sqrt(s)]
};

/// What is known of a board's offsets when the filter starts.
struct BoardBias {
  Eigen::Vector3d gyro = Eigen::Vector3d::Zero();   ///< [rad/s]
  Eigen::Vector3d accel = Eigen::Vector3d::Zero();  ///< [m/s^2]
  double gyro_sigma = 0.002;                        ///< [rad/s]
  double accel_sigma = 0.1;                         ///< [m/s^2]
};

/// What became of a board's readings of one kind.
struct ReadingCounts {
  std::uint64_t used = 0;
  std::uint64_t gated = 0;    ///< did not fit the estimate
  std::uint64_t missing = 0;  ///< not received, not finite, saturated, or without confidence
};
struct BoardCounts {
  ReadingCounts gyro, accel, distance;
};

/// How well innovations fit their predicted covariance: their normalised squares (NIS) over their
/// degrees of freedom should come to 1. Of readings that were used.
struct InnovationFit {
  double nis = 0.0;
  std::uint64_t rows = 0;
};

struct BodyState;
struct BodyLayout;
class Covariance;

/// One thread. After start() nothing allocates. Readings may come a little out of order: one that
/// is older than the state, by up to kOldest, is compared with the state carried back to its time.
class BodyFilter {
 public:
  static constexpr std::int64_t kOldest = 100'000'000;  ///< [ns]; older ones count as missing

  /// Segments that no board can tell apart share their rotation (body_layout.h).
  /// @param X_BS  where each board of the garment is mounted on its segment
  /// @throws std::invalid_argument unless the skeleton is canonical and each board has its X_BS
  BodyFilter(const Skeleton& canonical, const Garment& garment,
             std::span<const Eigen::Isometry3d> X_BS, const FilterSettings& settings);
  ~BodyFilter();
  BodyFilter(BodyFilter&&) noexcept;
  BodyFilter& operator=(BodyFilter&&) noexcept;

  /// Begins, or begins anew, at rest in a known pose.
  /// @param biases  one per board; empty: zero with the default uncertainty
  void start(const Pose& pose, std::int64_t stamp_ns, std::span<const BoardBias> biases);

  /// Inertial: carries the state to the stamp and uses all boards' gyroscopes, then all
  /// accelerometers. Distances: uses those of one pulse, sent at the stamp.
  void process(const Measurement& measurement) noexcept;

  /// Further observations, of the state at their stamp. A stamp ahead of the state carries it
  /// there. Each @returns false if the observation did not pass its gate or was not finite.
  bool observe_root(std::int64_t stamp_ns, const Eigen::Isometry3d& X_WR, double sigma_p,
                    double sigma_q) noexcept;
  /// Velocity in W of a point p_BQ of a segment, e.g. 0 of a foot on the ground.
  bool observe_point_velocity(std::int64_t stamp_ns, std::size_t segment,
                              const Eigen::Vector3d& p_BQ, const Eigen::Vector3d& v_W,
                              double sigma) noexcept;
  bool observe_point_position(std::int64_t stamp_ns, std::size_t segment,
                              const Eigen::Vector3d& p_BQ, const Eigen::Vector3d& p_WQ,
                              double sigma) noexcept;
  /// Height of a point above z = 0 of W [m].
  bool observe_point_height(std::int64_t stamp_ns, std::size_t segment, const Eigen::Vector3d& p_BQ,
                            double z, double sigma) noexcept;
  /// Direction of a field that is known in W, as a board sees it (a magnetometer's, or gravity's).
  /// Lengths do not count. @param sigma  [rad]
  bool observe_direction(std::int64_t stamp_ns, std::size_t board, const Eigen::Vector3d& field_S,
                         const Eigen::Vector3d& field_W, double sigma) noexcept;
  /// Distance of a board's microphone from a point that is known in W, e.g. another wearer's
  /// source.
  bool observe_distance(std::int64_t stamp_ns, std::size_t board, const Eigen::Vector3d& p_W,
                        double distance, double sigma) noexcept;

  /// The estimate. Confidence is 0 for what no board tells, else falls as sigma grows.
  const Pose& pose() const noexcept;
  std::int64_t stamp_ns() const noexcept;

  /// Standard deviation of a joint's rotation about its own axes [rad]; of the root's in W's.
  Eigen::Vector3d sigma(Joint joint) const noexcept;
  /// Covariance of the root: position in W [m], then rotation about its own axes [rad].
  Eigen::Matrix<double, 6, 6> root_covariance() const noexcept;
  /// Velocity of the root in W [m/s] and angular velocity w_PB_B of a joint [rad/s].
  Eigen::Vector3d root_velocity() const noexcept;
  Eigen::Vector3d joint_rate(Joint joint) const noexcept;
  /// A point of a segment, in W [m], [m/s].
  Eigen::Vector3d point_position(std::size_t segment, const Eigen::Vector3d& p_BQ) const noexcept;
  Eigen::Vector3d point_velocity(std::size_t segment, const Eigen::Vector3d& p_BQ) const noexcept;

  /// What the filter learnt of the boards.
  Eigen::Isometry3d X_BS(std::size_t board) const noexcept;
  BoardBias bias(std::size_t board) const noexcept;
  /// True speed of sound over the assumed one.
  double sound_scale() const noexcept;

  std::span<const BoardCounts> counts() const noexcept;
  std::uint64_t late() const noexcept;  ///< measurements older than kOldest
  InnovationFit gyro_fit() const noexcept;
  InnovationFit accel_fit() const noexcept;
  InnovationFit distance_fit() const noexcept;

  /// The state itself, for tests of consistency and smoothers (body_state.h, covariance.h).
  const BodyState& estimate() const noexcept;
  const BodyLayout& layout() const noexcept;
  const Covariance& covariance() const noexcept;

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace secondskin::server
