#pragma once

#include <memory>
#include <span>
#include <vector>

#include "server/wearable/estimate/observation.h"

/// The covariance P of the state's error: Eq. 6 and 7 to 9 for sets of observations.
///
/// P is kept whole and symmetric in panels (symmetric_kernel.h). An update subtracts A A^T with
/// A = P H^T L^-T, L L^T = H P H^T + R: symmetric by construction, at a third of the Joseph form's
/// cost. After the constructor nothing allocates.
namespace secondskin::server {

/// Spectral densities of the noise that drives the state (docs/wearable-filter.md).
struct ProcessNoise {
  double joint_jerk, root_turn_jerk, root_jerk;  ///< [(unit/s^3)^2 / Hz]
  double chain_jerk;                             ///< of a chain's members against each other
  double gyro_bias, accel_bias, mount, sound;    ///< variance a second
};

/// What an update did.
struct UpdateResult {
  double nis = 0.0;  ///< normalised innovation squared of what was used, together
  int rows = 0;      ///< its degrees of freedom
};

class Covariance {
 public:
  /// @throws std::invalid_argument for more than 256 rows: those of 85 boards
  Covariance(const BodyLayout& layout, int most_rows);

  /// All zero.
  void clear() noexcept;
  double at(int row, int column) const noexcept;
  /// Sets a variance and forgets all correlations of that column.
  void reset(int column, double variance) noexcept;
  /// Sets the covariance of three columns in a row; they must be without correlations.
  void reset_block(int column, const Eigen::Matrix3d& covariance) noexcept;
  /// Adds to a variance.
  void add(int column, double variance) noexcept;

  /// Eq. 6: P = F P F^T + Q over a time > 0; `state` is the one before it.
  void predict(const BodyState& state, double time, const ProcessNoise& noise) noexcept;

  /// Eq. 7 to 9 with gates.
  /// @param gates    largest d^2 = y^T S^-1 y that passes, for sets of 1, 2, 3 rows
  /// @param relax    one per SparseRows of the set: true takes it with its variance enlarged until
  ///                 it passes
  /// @param passed   out, one per SparseRows: whether it was used as it is
  /// @param error    out: K y, one per column, padded to 8; all of it is written
  UpdateResult update(const ObservationSet& set, const std::array<double, 3>& gates,
                      std::span<const char> relax, std::span<char> passed,
                      std::span<double> error) noexcept;

  int padded_size() const noexcept { return kPanel * panels_; }

 private:
  using Buffer = std::unique_ptr<double[], void (*)(double*)>;
  static Buffer allocate(std::size_t count);
  double& element(int row, int column) noexcept;
  void gate(const ObservationSet& set, const std::array<double, 3>& gates,
            std::span<const char> relax, std::span<char> passed) noexcept;
  bool factorise(int k) noexcept;

  const BodyLayout* layout_;
  int panels_;
  int most_rows_;
  Buffer P_, B_, A_, Lp_;
  std::vector<double> Bt_, S_, y_;
  std::vector<ColumnTransition> F_;
};

}  // namespace secondskin::server
