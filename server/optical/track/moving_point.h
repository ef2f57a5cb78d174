#pragma once

#include <Eigen/Core>

/// A point that moves, as a Kalman filter knows it: position, velocity, acceleration and their
/// covariance, kept as blocks (it is symmetric; whole it is [pp pv pa; pv' vv va; pa' va' aa]).
///
/// Motion is Singer's model (IEEE T-AES 6:473, 1970): the acceleration forgets itself with a time
/// constant and is driven by white jerk: a' = -a / T + w, E[w(t) w(s)'] = jerk^2 delta(t - s) I.
/// Frame: W the world. All free functions: no allocation, no exceptions.
namespace secondskin::server {

struct MovingPoint {
  Eigen::Vector3d p = Eigen::Vector3d::Zero();  ///< [m]
  Eigen::Vector3d v = Eigen::Vector3d::Zero();  ///< [m/s]
  Eigen::Vector3d a = Eigen::Vector3d::Zero();  ///< [m/s^2]
  Eigen::Matrix3d P_pp = Eigen::Matrix3d::Zero(), P_pv = P_pp, P_pa = P_pp, P_vv = P_pp,
                  P_va = P_pp, P_aa = P_pp;

  /// At a place, its motion known by what is usual only: independent of each other.
  static MovingPoint at(const Eigen::Vector3d& p, double sigma_p, double sigma_v,
                        double sigma_a) noexcept;
  Eigen::Matrix<double, 9, 1> state() const noexcept;
  Eigen::Matrix<double, 9, 9> covariance() const noexcept;
};

struct Manoeuvre {
  double jerk;    ///< root of the white jerk's spectral density [m/s^3/sqrt(Hz)]
  double memory;  ///< T, how long an acceleration lasts [s]
};

/// x = F x, P = F P F' + Q over dt >= 0 [s]. F is exact; Q is its first term in dt / T, so a long
/// way is to be gone in steps short against T.
void predict(MovingPoint& point, const Manoeuvre& manoeuvre, double dt) noexcept;

/// A scalar measurement of the position, linearised: z = h(p) + noise.
struct Innovation {
  double nu;          ///< z - h(p)
  double S;           ///< its variance, H P H' + R
  Eigen::Vector3d g;  ///< the gradient of h, transposed: H = [g' 0 0]
};
Innovation innovation(const MovingPoint& point, const Eigen::RowVector3d& gradient, double residual,
                      double variance) noexcept;
/// K = P H' / S, x += K nu, P -= K S K'.
void correct(MovingPoint& point, const Innovation& innovation) noexcept;

/// The weighted mean of two states and its covariance: w a + (1 - w) b, each spread out by how far
/// it is from the mean.
MovingPoint blend(const MovingPoint& a, const MovingPoint& b, double w) noexcept;

}  // namespace secondskin::server
