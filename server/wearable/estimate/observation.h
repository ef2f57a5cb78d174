#pragma once

#include <vector>

#include "server/wearable/estimate/body_motion.h"
#include "server/wearable/estimate/symmetric_kernel.h"

/// The observation models h(x) of section 5.2 with their analytic Jacobians H, as sparse rows for
/// the covariance. Each takes the state carried to the time of the observation, so H includes how
/// the state at that time follows from the state now.
namespace secondskin::server {

/// Observations that are used together: rows of H, innovations y = z - h(x), variances R
/// (diagonal). Fixed capacity; what does not fit is not added.
class ObservationSet {
 public:
  ObservationSet(const BodyLayout& layout, int most_rows);

  void clear() noexcept;
  bool has_room(int rows) const noexcept { return size() + rows <= most_rows_; }
  int size() const noexcept { return static_cast<int>(y.size()); }

  std::vector<SparseRows> rows;
  std::vector<SparseEntry> entries;
  std::vector<double> y, variance;  ///< one a row
  std::vector<std::size_t> tag;     ///< one per SparseRows: what the caller likes

 private:
  int most_rows_;
};

/// What the models need of the body. Outlives its users.
struct BodyModel {
  Skeleton skeleton;
  BodyLayout layout;
  std::vector<std::size_t> segment_of;                     ///< of each board
  std::vector<Eigen::Vector3d> p_BS;                       ///< of each board [m]
  std::vector<std::optional<std::size_t>> source_segment;  ///< empty: fixed in the world
  std::vector<Eigen::Isometry3d> X_BU;                     ///< X_WU of a fixed source
  std::vector<Eigen::Quaterniond> fixed;                   ///< joints that are not in the state

  BodyModel(const Skeleton& canonical, const Garment& garment,
            std::span<const Eigen::Isometry3d> X_BS);
};

/// Standard gravity, up being positive [m/s^2].
inline const Eigen::Vector3d kGravity(0.0, 0.0, kStandardGravity);

// Each adds rows to `set` for the measured value z and its variance. `time` is that of the
// observation after the state's [s]; it may be negative.

/// Eq. 3: R_WS^T w_WS + bias.
/// @param rate_error  how wrong the estimated rate w of what a joint turns under may be [rad/s].
///        What the reading says of the joint's and the board's rotation counts w^2 / (w^2 +
///        rate_error^2): used as if exact, an erroneous rate turns them for good (errors in
///        variables). 0: the plain derivative.
void observe_gyro(const BodyModel& body, const BodyState& state, std::size_t board, double time,
                  const Eigen::Vector3d& z, double variance, double rate_error,
                  ObservationSet& set) noexcept;
/// Eq. 2: R_WS^T (J ddtheta + dJ dtheta + g) + bias.
/// @param arm_sigma  how wrong lever arms may be [m]: the variance grows by that times the angular
///                   acceleration and the squared rate of the liveliest segment on the way
void observe_accel(const BodyModel& body, const BodyState& state, std::size_t board, double time,
                   const Eigen::Vector3d& z, double variance, double arm_sigma,
                   ObservationSet& set) noexcept;
/// A world vector as the board sees it: R_WS^T f_W. Rows across f_W alone carry information.
void observe_field(const BodyModel& body, const BodyState& state, std::size_t board, double time,
                   const Eigen::Vector3d& z, const Eigen::Vector3d& f_W, double variance,
                   ObservationSet& set) noexcept;

/// Eq. 4: distance between a source at emission, `time`, and a board's microphone at arrival,
/// `flight` later, times the assumed over the true speed of sound.
/// @returns false if nothing was added: the board is behind the source (w_a = 0)
bool observe_distance(const BodyModel& body, const BodyState& state, std::size_t source,
                      std::size_t board, double time, double flight, double z, double variance,
                      ObservationSet& set) noexcept;
/// The same from a point that is known in W.
void observe_distance_from(const BodyModel& body, const BodyState& state,
                           const Eigen::Vector3d& p_W, std::size_t board, double time, double z,
                           double variance, ObservationSet& set) noexcept;

enum class PointQuantity { kPosition, kVelocity };
/// A segment's point in W; `axis` empty: all three coordinates, else one of them.
void observe_point(const BodyModel& body, const BodyState& state, PointQuantity quantity,
                   std::size_t segment, const Eigen::Vector3d& p_BQ, double time,
                   const Eigen::Vector3d& z, double variance, std::optional<int> axis,
                   ObservationSet& set) noexcept;

/// The root's orientation: innovation is the rotation vector from the estimate to z.
void observe_root_rotation(const BodyModel& body, const BodyState& state, double time,
                           const Eigen::Quaterniond& z, double variance,
                           ObservationSet& set) noexcept;
/// Where a group's rotation ought to be, along the way there only (one row): joint limits.
void observe_rotation_along(const BodyModel& body, const BodyState& state, int group,
                            const Eigen::Quaterniond& goal, double variance,
                            ObservationSet& set) noexcept;
/// Three columns of the state in a row, as themselves.
void observe_columns(int column, const Eigen::Vector3d& innovation, double variance,
                     ObservationSet& set) noexcept;

/// That two times three columns of the state are alike; innovation is the second's less the
/// first's.
void observe_likeness(int first, int second, const Eigen::Vector3d& innovation, double variance,
                      ObservationSet& set) noexcept;

}  // namespace secondskin::server
