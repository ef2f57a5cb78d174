#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <vector>

/// A bilateral and a median filter on each coordinate of a point (Second Skin, 2.2.6).
///
/// The bilateral part replaces each entry of the window by the mean of all, weighted by
/// exp(-dt^2 / 2 sigma_time^2 - dx^2 / 2 sigma_value^2); the output is the median of the replaced
/// entries, and belongs to the entry in the middle. The paper says that entries "far away in value"
/// weigh most, which would prefer outliers: here near ones do, as in every bilateral filter.
namespace secondskin::server {

struct PointSmootherOptions {
  std::size_t window = 7;      ///< entries, odd; half of them are future data
  double sigma_time = 0.016;   ///< [s]
  double sigma_value = 0.015;  ///< [m]
};

/// For one point. One thread.
class PointSmoother {
 public:
  /// @throws std::invalid_argument naming the option that is out of range
  explicit PointSmoother(const PointSmootherOptions& = {});

  /// Takes the newest point, if there is one, and gives the smoothed one of delay_frames() before,
  /// if there was one then.
  std::optional<Eigen::Vector3d> update(std::int64_t stamp_ns,
                                        const std::optional<Eigen::Vector3d>& p_W) noexcept;

  std::size_t delay_frames() const noexcept { return entries_.size() / 2; }

 private:
  struct Entry {
    std::int64_t stamp_ns = 0;
    std::optional<Eigen::Vector3d> p_W;
  };

  PointSmootherOptions options_;
  std::vector<Entry> entries_;  ///< a ring
  std::vector<double> smoothed_;
  std::size_t newest_ = 0;
};

}  // namespace secondskin::server
