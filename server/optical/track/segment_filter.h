#pragma once

#include <Eigen/Geometry>
#include <cmath>
#include <cstdint>
#include <vector>

#include "server/optical/track/moving_point.h"

/// The detectors of one limb as an extended Kalman filter knows them: how the limb moves, and where
/// on it each detector sits. It learns the places while it tracks.
///
/// Frames: W the world; B the limb: nobody prescribes its origin and axes, they are where the
/// filter put them when it began. Error state: p_WB, v, a, theta (q_WB_true = exp(theta) q_WB), w,
/// dw/dt (all in W), then p_BD of every detector. Motion as moving_point.h, for the rotation alike.
/// docs/optical-tracking.md has the equations. One thread; after construction nothing allocates.
namespace secondskin::server {

struct SegmentMotion {
  Manoeuvre translation;  ///< jerk in [m/s^3/sqrt(Hz)]
  Manoeuvre rotation;     ///< jerk in [rad/s^3/sqrt(Hz)]
};

/// What is the same however the limb moves. The sigmas are of a limb that is first seen.
struct SegmentPrior {
  double drift = 0.002;         ///< how far skin and cloth carry a place on the limb [m/sqrt(s)]
  double velocity_sigma = 1.0;  ///< [m/s]
  double acceleration_sigma = 10.0;       ///< [m/s^2]
  double turn_sigma = 5.0;                ///< [rad/s]
  double turn_acceleration_sigma = 50.0;  ///< [rad/s^2]
};

class SegmentFilter {
 public:
  SegmentFilter(std::size_t detectors, const SegmentMotion& motion, const SegmentPrior& prior);

  bool active() const noexcept { return active_; }
  bool placed(std::size_t detector) const noexcept { return placed_[detector] != 0; }

  /// Forgets everything.
  void reset() noexcept;
  /// Begins where the state is held; no detector is placed.
  void begin(const Eigen::Vector3d& p_WB, const Eigen::Vector3d& v_WB) noexcept;
  /// Puts a detector on the limb where it is seen.
  /// @param lead  how much later than the state it is seen there [s]
  void place(std::size_t detector, const Eigen::Vector3d& p_WD, const Eigen::Matrix3d& covariance,
             double lead) noexcept;
  void forget(std::size_t detector) noexcept;

  void predict(double dt) noexcept;

  struct Point {
    Eigen::Vector3d p_WD;    ///< [m]
    Eigen::Vector3d p_BD_W;  ///< from the limb's origin, written in W [m]
    Eigen::Matrix3d R_WB;    ///< of the limb then
    Eigen::Matrix3d turn;    ///< what it turned from the state's time to then
    double lead;             ///< [s]
  };
  /// A placed detector `lead` after the state's time, or before it [s].
  Point point(std::size_t detector, double lead) const noexcept;
  /// Where on the limb something is that is seen at p_WD `lead` after the state's time: p_BD [m].
  Eigen::Vector3d on_limb(const Eigen::Vector3d& p_WD, double lead) const noexcept;
  /// The root of the trace of a point's covariance [m].
  double sigma(std::size_t detector, const Point& point) const noexcept;

  /// S = H P H' + variance of a value that is measured at a point; keeps P H' for correct().
  double innovation_variance(std::size_t detector, const Point& point,
                             const Eigen::RowVector3d& gradient, double variance) noexcept;
  /// x += K nu, P -= K S K', with the H of the last innovation_variance().
  void correct(double nu, double S) noexcept;

  /// Mixes two filters of the same segment as an interacting multiple model does: each becomes the
  /// weighted mean of both. @param w_a, w_b  how much of `a` goes into `a` and into `b`
  static void mix(SegmentFilter& a, SegmentFilter& b, double w_a, double w_b) noexcept;

  /// The roots of the traces of the origin's and the orientation's covariance [m], [rad].
  double origin_sigma() const noexcept { return std::sqrt(P_.diagonal().segment<3>(0).sum()); }
  double turn_sigma() const noexcept { return std::sqrt(P_.diagonal().segment<3>(9).sum()); }
  const Eigen::MatrixXd& covariance() const noexcept { return P_; }

 private:
  static constexpr Eigen::Index kPose = 18;
  using PoseRow = Eigen::Matrix<double, kPose, 1>;

  static PoseRow pose_row(const Point& point, const Eigen::Vector3d& g) noexcept;
  Eigen::Index place_at(std::size_t detector) const noexcept {
    return kPose + 3 * static_cast<Eigen::Index>(detector);
  }
  void spread_drift() noexcept;

  SegmentMotion motion_;
  SegmentPrior prior_;
  bool active_ = false;
  std::vector<std::uint8_t> placed_;
  Eigen::Vector3d p_, v_, a_, w_, dw_;
  Eigen::Quaterniond q_;
  Eigen::Matrix3Xd r_;               ///< p_BD
  Eigen::MatrixXd P_;                ///< zero for detectors that are not placed
  Eigen::VectorXd PHt_, K_, apart_;  ///< working space
  Eigen::MatrixXd drift_;            ///< the places' covariance that comes in a second
  double undrifted_ = 0.0;           ///< time since it was added [s]
};

}  // namespace secondskin::server
