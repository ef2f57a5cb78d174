#include "server/optical/track/point_smoother.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <stdexcept>

namespace secondskin::server {

PointSmoother::PointSmoother(const PointSmootherOptions& options)
    : options_(options), entries_(options.window), smoothed_(options.window) {
  if (options.window % 2 == 0) {
    throw std::invalid_argument(
        fmt::format("window: expected an odd number of entries, found {}", options.window));
  }
  if (!(options.sigma_time > 0.0 && options.sigma_value > 0.0)) {
    throw std::invalid_argument(
        fmt::format("sigma_time and sigma_value: expected more than 0, found {} s and {} m",
                    options.sigma_time, options.sigma_value));
  }
}

std::optional<Eigen::Vector3d> PointSmoother::update(
    std::int64_t stamp_ns, const std::optional<Eigen::Vector3d>& p_W) noexcept {
  const std::size_t n = entries_.size();
  newest_ = (newest_ + 1) % n;
  entries_[newest_] = {stamp_ns, p_W};
  const Entry& middle = entries_[(newest_ + n - delay_frames()) % n];
  if (!middle.p_W) return std::nullopt;

  Eigen::Vector3d out;
  for (int axis = 0; axis < 3; ++axis) {
    std::size_t count = 0;
    for (const Entry& entry : entries_) {
      if (!entry.p_W) continue;
      const double value = (*entry.p_W)[axis];
      double sum = 0.0, weights = 0.0;
      for (const Entry& other : entries_) {
        if (!other.p_W) continue;
        const double dt =
            1e-9 * static_cast<double>(other.stamp_ns - entry.stamp_ns) / options_.sigma_time;
        const double dx = ((*other.p_W)[axis] - value) / options_.sigma_value;
        const double weight = std::exp(-0.5 * (dt * dt + dx * dx));
        sum += weight * (*other.p_W)[axis];
        weights += weight;
      }
      smoothed_[count++] = sum / weights;
    }
    std::sort(smoothed_.begin(), smoothed_.begin() + static_cast<std::ptrdiff_t>(count));
    out[axis] = 0.5 * (smoothed_[(count - 1) / 2] + smoothed_[count / 2]);
  }
  return out;
}

}  // namespace secondskin::server
