#pragma once

#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>

namespace secondskin::bus {

/// Quantiles of latencies without keeping them: 5 % wide bins from 1 us to 10 s. No allocation.
class LatencyHistogram {
 public:
  void add(double seconds) noexcept {
    ++bins_[bin(seconds)];
    ++count_;
    if (seconds > max_) max_ = seconds;
  }
  void clear() noexcept { *this = {}; }

  /// @param q  0 to 1. @returns the upper edge of the bin that holds it, at most the largest value;
  ///           0 when nothing was added [s]
  double quantile(double q) const noexcept {
    if (count_ == 0) return 0.0;
    const auto rank = static_cast<std::uint64_t>(std::ceil(q * static_cast<double>(count_)));
    std::uint64_t seen = 0;
    for (std::size_t i = 0; i < kBins; ++i) {
      seen += bins_[i];
      if (seen >= rank && seen > 0) return std::fmin(kSmallest * std::pow(kRatio, i + 1.0), max_);
    }
    return max_;
  }
  double max() const noexcept { return max_; }
  std::uint64_t count() const noexcept { return count_; }

 private:
  static constexpr double kSmallest = 1e-6;
  static constexpr double kRatio = 1.05;
  static constexpr std::size_t kBins = 332;  // 1e-6 * 1.05^332 > 10 s

  static std::size_t bin(double seconds) noexcept {
    if (!(seconds > kSmallest)) return 0;
    const double i = std::log(seconds / kSmallest) / std::log(kRatio);
    return i >= kBins - 1.0 ? kBins - 1 : static_cast<std::size_t>(i);
  }

  std::array<std::uint32_t, kBins> bins_{};
  std::uint64_t count_ = 0;
  double max_ = 0.0;
};

}  // namespace secondskin::bus
