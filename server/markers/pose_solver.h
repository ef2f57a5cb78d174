#pragma once

#include <Eigen/Dense>
#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "motion/anatomy.h"

/// The least squares that calibration and tracking share: one pose of a canonical body from the
/// markers of one instant. Frames: W the world, B a segment; see motion/kinematics.h.
///
/// The unknowns are the root's position and one rotation vector w_PB_B a free joint, as in
/// position_jacobian. Minimised is, with r_m = p_WM - X_WB p_BM,
///
///   sum_m rho(|r_m|^2 / sigma_m^2) + sum_j |angles out of joint j's range|^2 / sigma_j^2
///     + (x - x_predicted)^T Lambda (x - x_predicted),
///
/// rho the kernel of Geman & McClure, so that a marker far off pulls at nothing. Nothing here
/// allocates after construction.
namespace secondskin::server {

/// A marker fixed to a segment.
struct Site {
  Joint segment{};
  Eigen::Vector3d p_BM = Eigen::Vector3d::Zero();  ///< [m]
  double sigma = 0.008;                            ///< of each coordinate [m]
};

/// A body's pose with every segment placed.
struct PlacedPose {
  Eigen::Vector3d p_WR = Eigen::Vector3d::Zero();
  std::array<Eigen::Quaterniond, kJointCount> q_PB;
  std::array<Eigen::Isometry3d, kJointCount> X_WB;

  PlacedPose() {
    q_PB.fill(Eigen::Quaterniond::Identity());
    X_WB.fill(Eigen::Isometry3d::Identity());
  }
};

/// How fast a joint's anatomical angles change with its angular velocity: angles' = rates * w_PB_B.
/// A row whose angle is singular there is 0.
Eigen::Matrix3d movement_rates(Joint joint, const Eigen::Quaterniond& q_PB) noexcept;

/// The rigid motion that best lays points a onto points b, weighted (Kabsch 1976).
/// @param X_ba  out; unchanged unless found
/// @returns false for fewer than three points or points on a line.
[[nodiscard]] bool rigid_fit(std::span<const Eigen::Vector3d> a, std::span<const Eigen::Vector3d> b,
                             Eigen::Isometry3d& X_ba) noexcept;

class PoseSolver {
 public:
  static constexpr int kMostDofs = 3 + 3 * static_cast<int>(kJointCount);
  using Vector = Eigen::Matrix<double, Eigen::Dynamic, 1, 0, kMostDofs, 1>;
  using Matrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, 0, kMostDofs, kMostDofs>;

  /// Free are the joints that the sites tell something about; the others stay at rest. Of
  /// midline joints between two segments with markers the lowest bends (motion/retarget.h has it so
  /// too), the others give way a little; so does a clavicle without markers of its own.
  PoseSolver(const Skeleton& skeleton, std::vector<Site> sites);

  int dofs() const noexcept { return dofs_; }
  /// A joint's first column; empty where it is not free.
  std::optional<int> column(Joint joint) const noexcept {
    const int c = columns_[index(joint)];
    return c < 0 ? std::nullopt : std::optional<int>(c);
  }
  const Skeleton& skeleton() const noexcept { return skeleton_; }
  const std::vector<Site>& sites() const noexcept { return sites_; }

  /// What one instant tells.
  struct Observation {
    std::span<const Eigen::Vector3d> p_WM;  ///< one per site [m]
    std::span<const double> sigma;          ///< of each coordinate, one per site [m]; 0: not seen
    double kernel = 4.0;                    ///< where rho lets go [sigma]
    const PlacedPose* predicted = nullptr;  ///< none: no prediction
    const Vector* information = nullptr;    ///< the diagonal of Lambda, with `predicted`
  };

  /// Places the segments of a pose whose p_WR and q_PB are set.
  void place(PlacedPose& pose) const noexcept;

  /// The cost of a placed pose and, if asked for, its Gauss-Newton system H dx = g (only the lower
  /// triangle of H).
  double evaluate(const PlacedPose& pose, const Observation& seen, Matrix* H,
                  Vector* g) const noexcept;

  /// x + dx on the manifold, placed.
  void step(const PlacedPose& from, const Vector& dx, PlacedPose& to) const noexcept;

  struct Result {
    double cost;
    int iterations;
    bool converged;
  };
  /// Levenberg-Marquardt from `pose`. @param H  out: the system at the end, undamped
  Result solve(const Observation& seen, int most_iterations, PlacedPose& pose,
               Matrix& H) const noexcept;

  /// Which markers place the root first. One of them will do where some markers are wrong.
  enum class Root { kPelvis, kPelvisAndTrunk, kTrunk };
  static constexpr std::array kRoots{Root::kPelvis, Root::kPelvisAndTrunk, Root::kTrunk};

  /// A pose from the markers alone, segment by segment from the root, as a start for solve. Joints
  /// whose segment shows nothing stay as they are in `pose`.
  /// @returns false when those that place the root are fewer than three, or on a line.
  [[nodiscard]] bool initialise(const Observation& seen, Root root,
                                PlacedPose& pose) const noexcept;

  /// The same sites on other lengths or places; which joints are free does not change.
  void reshape(const Skeleton& skeleton, std::vector<Site> sites);

 private:
  void add_anatomy(const PlacedPose& pose, double& cost, Matrix* H, Vector* g) const noexcept;

  Skeleton skeleton_;
  std::vector<Site> sites_;
  std::array<int, kJointCount> columns_{};
  std::array<double, kJointCount> ease_{};  // what keeps a joint near rest, 1 sigma [rad]
  struct Path {
    std::array<std::uint8_t, kJointCount> joint{};
    std::uint8_t count = 0;
  };
  std::array<Path, kJointCount> paths_{};  // the free joints that move a segment, root first
  int dofs_ = 3;
};

}  // namespace secondskin::server
