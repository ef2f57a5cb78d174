#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <numeric>

/// For how long a learner was how far from the expert. docs/alignment.md, section 4.
namespace secondskin::coach {

class FitRecord {
 public:
  static constexpr double kBestShare = 0.3;  ///< of the time: the best part

  void clear() noexcept { time_.fill(0.0); }

  void fade(double keep) noexcept {
    for (double& t : time_) t *= keep;
  }

  /// @param distance  RMS over the joints [rad]  @param dt  [s]
  void add(double distance, double dt) noexcept {
    time_[std::min(kBins - 1, static_cast<std::size_t>(distance / kBin))] += dt;
  }

  double time() const noexcept { return std::accumulate(time_.begin(), time_.end(), 0.0); }

  /// Whether the best part of the time is all nearer than this; whole degrees below 40.
  bool fits(double distance) const noexcept {
    const auto end = static_cast<std::ptrdiff_t>(std::lround(distance / kBin));
    return std::accumulate(time_.begin(), time_.begin() + end, 0.0) >= kBestShare * time();
  }

 private:
  static constexpr double kBin = std::numbers::pi / 180.0;
  static constexpr std::size_t kBins = 40;
  std::array<double, kBins> time_{};
};

}  // namespace secondskin::coach
