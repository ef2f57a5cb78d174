#pragma once

#include <vector>

#include "motion/markers.h"
#include "server/markers/marker_body.h"
#include "server/markers/pose_solver.h"

/// A body's pose, live, from labelled markers: constant bone lengths, joint limits, robust against
/// wrong markers, steady through occlusions.
///
/// Each frame is one robust least squares (pose_solver.h) about a prediction: every free coordinate
/// is a random walk of velocity whose variance grows while nothing is seen of it, so that hidden
/// joints first go on as they went, then rest, and their confidence falls. The filter's covariance
/// is kept for each coordinate by itself (2 x 2: angle and velocity); docs/skeleton.md has the
/// equations. Not safe to share between threads.
namespace secondskin::server {

class BodyFit {
 public:
  /// What became of one frame.
  struct Result {
    bool tracked = false;     ///< the markers agree on a pose; else it is only the prediction
    bool restarted = false;   ///< found anew from this frame alone: the first, or after being lost
    std::size_t visible = 0;  ///< markers of the body seen
    std::size_t used = 0;     ///< of those, markers that lie within kGate of their place
    double residual = 0.0;    ///< RMS distance of the used ones [m]
  };

  /// Farther from its place than this a marker counts as wrong [sigma of a coordinate].
  static constexpr double kGate = 5.0;

  explicit BodyFit(const MarkerBody& body);

  const Skeleton& skeleton() const noexcept { return solver_.skeleton(); }

  /// Takes the next frame. A marker that is not visible, not finite or not in the frame is not
  /// used. Allocates nothing once `out` has the canonical size.
  /// @param dt   time since the frame before [s]; out of range or not finite counts as 0
  /// @param out  the pose. Confidence: 1 / (1 + (sigma / 8 deg)^2) by the joint's own standard
  ///             deviation, 0 for joints that the markers say nothing of.
  Result update(const MarkerFrame& frame, double dt, Pose& out) noexcept;

  /// Standard deviation of a joint's rotation after the last frame, its worst axis [rad]; infinite
  /// where the markers say nothing of it.
  double sigma(Joint joint) const noexcept;

  /// Forgets the pose; the next frame starts anew.
  void reset() noexcept { started_ = false; }

 private:
  void predict(double dt) noexcept;
  void absorb(const PoseSolver::Vector& variance) noexcept;
  std::size_t in_place(const PlacedPose& pose) const noexcept;
  bool restart() noexcept;
  bool marginals(PoseSolver::Matrix& H, PoseSolver::Vector& variance) const noexcept;

  MarkerBody body_;
  PoseSolver solver_;
  // The observation's own arrays, one per attachment.
  std::vector<Eigen::Vector3d> p_WM_;
  std::vector<double> sigma_;  // 0: not seen
  std::vector<double> room_;   // sigma with the prediction's own
  PlacedPose pose_;
  // Of each coordinate: velocity, and the covariance of position and velocity.
  PoseSolver::Vector velocity_, p_, pv_, v_;
  PoseSolver::Vector drive_;  // spectral density of the acceleration
  PoseSolver::Vector information_;
  bool started_ = false;
  int disagreeing_ = 0;  // frames in a row
};

}  // namespace secondskin::server
