#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <optional>
#include <span>

#include "server/optical/projector.h"

/// Where planes meet: least squares (Second Skin, 2.2.3) and with removal of rows (2.2.5).
///
/// A row of A x = b is a projector's plane (Projector::plane). Its residual is h times the error in
/// counts, and h has no unit and is 1 at the world's origin, so metres instead of the paper's 0.1
/// inch change neither residual nor threshold. No allocation.
namespace secondskin::server {

/// One more than unknowns: three planes meet in a point whether they are right or wrong.
inline constexpr std::size_t kFewestPlanes = 4;

/// The paper's range of thresholds is 10 to 100, for what it calls variance and computes as
/// |A x - b|. But its own figures (valid data: single digits; one or two outliers: thousands) fit
/// the sum of squares only: a value of eight bits cannot be wrong by a thousand counts. So 10 to
/// 100 is read as the sum of squares, and the limit on |A x - b| is its root.
inline constexpr double kPaperVarianceLimit = 100.0;

struct PlanePoint {
  Eigen::Vector3d p_W;
  double residual_norm;  ///< |A x - b| over the rows that were used [counts]
  double sigma;          ///< root of the trace of the least squares covariance, the rows' variance
                         ///< taken from the residuals [m]
  std::size_t rows;      ///< used
};

/// The least squares point of all planes. Empty with less than kFewestPlanes, where the planes
/// leave a direction open, or where a number is not finite.
[[nodiscard]] std::optional<PlanePoint> intersect(std::span<const Plane> planes) noexcept;

/// As intersect(); while |A x - b| is not below the limit, removes the one row that leaves least of
/// it, as long as kFewestPlanes remain. Empty when that does not help (the paper's 9999).
///
/// The residual without row i needs no new solution: |r|^2 - r_i^2 / (1 - l_i) with the row's
/// leverage l_i = a_i' (A'A)^-1 a_i.
/// @param limit  on |A x - b| [counts]
/// @param used   out: 1 for each plane that the point is from; one a plane
[[nodiscard]] std::optional<PlanePoint> intersect_filtered(std::span<const Plane> planes,
                                                           double limit,
                                                           std::span<std::uint8_t> used) noexcept;

}  // namespace secondskin::server
