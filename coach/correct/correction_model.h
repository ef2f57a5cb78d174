#pragma once

#include <array>
#include <memory>
#include <span>
#include <vector>

#include "coach/correct/correction.h"

/// The mathematics of the correction, without Ipopt: what an amount of correction costs, its
/// derivatives and its bounds. docs/correction.md derives it; equation numbers are that document's.
///
/// Frames: H the heading frame (origin in the pelvis, z up, turned with the pelvis about z); B a
/// joint's segment; P its parent, for the pelvis H. Thread rule: one thread at a time.
namespace secondskin::coach {

/// Knots of the horizon: at one, two and three thirds of it.
inline constexpr std::size_t kKnots = 3;

/// A degree of freedom: one anatomical movement of one joint.
struct DegreeOfFreedom {
  Joint joint;
  Movement movement;
};

/// Joint orientations of a whole body, the pelvis' in H.
using JointRotations = std::array<Eigen::Quaterniond, kJointCount>;

/// The minimum-jerk profile: the share of a movement that is done at a share of its time, both 0 to
/// 1 (Flash & Hogan 1985, J. Neurosci. 5:1688).
double minimum_jerk(double share_of_time) noexcept;

/// The reference's orientation of one joint at a time, held at both ends; the pelvis' in the world.
Eigen::Quaterniond reference_rotation(const Reference& reference, double time,
                                      std::size_t joint) noexcept;

/// A problem's cost as a function of delta, the change of each anatomical angle [rad]. Set up once;
/// pose() fixes the problem, then everything else is a function of delta. Sizes never change: a
/// joint that is left alone keeps its place, and delta has no effect on it.
class CorrectionModel {
 public:
  /// @throws std::invalid_argument when the learner or the reference is not canonical.
  CorrectionModel(std::shared_ptr<const Reference> reference, const Skeleton& learner,
                  const CorrectionOptions& options);

  /// The movements in the order of delta; 51 for the canonical body.
  std::span<const DegreeOfFreedom> freedoms() const noexcept { return freedoms_; }
  /// A joint's places in delta, by Movement; -1 for a movement that it does not have.
  const std::array<int, 3>& freedoms_of(std::size_t joint) const noexcept {
    return freedom_of_[joint];
  }
  std::size_t size() const noexcept { return freedoms_.size(); }
  /// Number of balance constraints: 8 when the reference is standing, else 0.
  std::size_t constraints() const noexcept { return constraints_; }
  /// Price of a radian of correction [1/rad], for either sign.
  double price() const noexcept { return price_; }
  /// Price of asking a joint at all: what the price of its movements would leave uncorrected.
  double joint_price() const noexcept { return joint_price_; }

  /// Fixes the problem: predicts the learner, places the reference, opens the joints that may be
  /// asked, computes the bounds. @returns false when the learner's pose has not 22 joints or the
  /// time or tempo is not finite; the model then holds a problem without error.
  bool pose(const CorrectionProblem& problem);

  /// Leaves open only these joints of those that pose() opened; the error of the others counts on.
  void restrict_to(const JointSet& joints) noexcept;

  /// Whether any joint may be asked.
  bool has_error() const noexcept { return open_.any(); }
  /// The joints that may be asked.
  const JointSet& open() const noexcept { return open_; }
  /// Bounds of delta: 0 is always inside (eq. 7, 8). [rad]
  std::span<const double> lower() const noexcept { return lower_; }
  std::span<const double> upper() const noexcept { return upper_; }
  /// Upper bounds of balance(): 0 is always feasible (eq. 9). [m]
  std::span<const double> balance_limit() const noexcept { return balance_limit_; }

  /// The smooth cost (eq. 1 without the price).
  double cost(std::span<const double> delta);
  /// Its exact gradient.
  void gradient(std::span<const double> delta, std::span<double> out);
  /// Its generalised Gauss-Newton matrix, positive semidefinite, row-major size() x size().
  void hessian(std::span<const double> delta, std::span<double> out);
  /// The exact Hessian of the Lagrangian: `factor` times the cost's and the balance constraints'
  /// times their multipliers; not always positive. Row-major size() x size().
  void exact_hessian(std::span<const double> delta, double factor,
                     std::span<const double> multipliers, std::span<double> out);
  /// Whether either matrix can ever have an entry there: both movements are of one joint or one
  /// limb, or move the same hand, foot or head.
  bool coupled(std::size_t a, std::size_t b) const noexcept;
  /// The centre of mass over the support in eight directions [m].
  void balance(std::span<const double> delta, std::span<double> out);
  /// Its Jacobian, row-major constraints() x size().
  void balance_jacobian(std::span<const double> delta, std::span<double> out);

  /// The cost without the effort term: the weighted error that a correction is to remove.
  double error(std::span<const double> delta);
  /// Of it, the task-space error of hands, feet and head.
  double task_error(std::span<const double> delta);

  /// The correction as a rotation vector of each joint at the learner's present pose; a correction
  /// that would leave the joint's limits there is shortened to its last part inside.
  void targets(std::span<const double> delta, JointVectors& target) const;
  /// Error of a joint at the last knot without a correction [rad].
  Eigen::Vector3d expected_error(std::size_t joint) const noexcept;
  /// The closed form: up to `count` joints, the largest weighted error beyond the dead band first,
  /// each corrected to the edge of its dead band inside the bounds; one that would make the whole
  /// worse, or carry the centre of mass beyond the support, is passed over.
  void closed_form(std::size_t count, std::span<double> delta);

  /// Pose error beyond which a joint counts, at the problem's reference time [rad].
  double dead_band(std::size_t joint) const noexcept { return dead_band_[joint]; }

 private:
  static constexpr std::size_t kTips = 5;
  static constexpr std::size_t kDirections = 8;

  struct Tip {
    Joint segment, fallback;  ///< the second where the first is not measured
    Joint limb_first;         ///< first joint of the limb; it and its limb give the weight
  };
  struct Knot {
    double share = 0.0;                             ///< of the correction that is done by then, s_k
    double weight = 0.0;                            ///< eq. 2
    std::array<JointAngles, kJointCount> angles{};  ///< the learner's, predicted
    JointRotations reference{};
    std::array<double, kJointCount> dead_band{};  ///< [rad]
    std::array<Eigen::Vector3d, kTips> tip{};     ///< the reference's, in H
  };
  struct Placement {  ///< of one knot at the present delta
    std::array<Eigen::Matrix3d, kJointCount> R_HB;
    std::array<Eigen::Vector3d, kJointCount> p_HB;
    std::array<Eigen::Matrix3d, kJointCount> rate;  ///< w_PB_B = rate * d(angles)/dt
    std::array<JointAngles, kJointCount> angles;
    /// Its derivative by each movement; only where exact_hessian needed it.
    std::array<std::array<Eigen::Matrix3d, 3>, kJointCount> rate_change;
    std::array<Eigen::Vector3d, kJointCount> error;  ///< log(q_PB^-1 q_PB_reference)
    std::array<Eigen::Vector3d, kTips> tip_error;    ///< learner - reference
  };

  struct MovedMass {
    double share;            ///< of the body's
    Eigen::Vector3d centre;  ///< in H [m]
  };

  bool balanced(std::span<const double> delta);
  void predict(const CorrectionProblem& problem);
  void open_joints(const JointSet& askable);
  void bound();
  void place(std::span<const double> delta);
  void place_segments(std::span<const double> delta, std::size_t knot);
  void add_task_hessian(std::size_t knot, std::span<double> out) const;
  Eigen::Vector3d acceleration(std::size_t proximal, std::size_t distal, std::size_t knot,
                               const Eigen::Vector3d& p) const;
  double tip_weight(std::size_t tip) const noexcept;
  Eigen::Vector3d lever(std::size_t freedom, std::size_t knot, const Eigen::Vector3d& p) const;
  Eigen::Vector3d mass_centre(std::size_t knot) const;
  MovedMass moved_mass(std::size_t joint, std::size_t knot) const;
  void support(std::size_t knot, std::array<Eigen::Vector3d, 4>& points) const;

  std::shared_ptr<const Reference> reference_;
  Skeleton skeleton_;
  CorrectionOptions options_;
  std::vector<DegreeOfFreedom> freedoms_;
  std::array<std::array<int, 3>, kJointCount> freedom_of_{};        ///< -1 where there is none
  std::array<std::array<bool, kJointCount>, kJointCount> moves_{};  ///< [joint][segment]
  std::array<double, kJointCount> dead_band_{};
  std::size_t constraints_ = 0;
  double price_ = 0.0, joint_price_ = 0.0;

  std::array<double, kJointCount> weight_{};  ///< of this problem; 0 where not compared
  std::array<bool, kJointCount> measured_{};
  JointSet compared_;  ///< outside the dead band: their error counts
  JointSet candidate_, open_;
  std::array<JointAngles, kJointCount> present_angles_{};
  JointRotations present_{};
  JointVectors present_error_{};
  std::array<Joint, kTips> tip_segment_{};
  std::array<double, kTips> tip_weight_{};
  std::array<Knot, kKnots> knots_{};
  std::vector<double> lower_, upper_, balance_limit_;
  std::vector<double> room_below_, room_above_;  ///< the bounds with every candidate open
  std::vector<double> placed_;                   ///< the delta that placement_ is of
  std::array<Placement, kKnots> placement_{};
};

}  // namespace secondskin::coach
