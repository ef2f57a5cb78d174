#pragma once

#include <cstdint>
#include <functional>
#include <span>
#include <vector>

/// Means over people with their uncertainty. Pure.
namespace secondskin::study {

/// Errors of one person by repetition.
using Curve = std::vector<double>;

/// Which repetitions of a curve.
struct Range {
  std::size_t begin = 0, end = 0;
};

struct Interval {
  double estimate = 0.0;
  double low = 0.0, high = 0.0;  ///< 95 %
};

/// The mean over people and the repetitions of a range.
double mean_error(std::span<const Curve* const> people, Range range);

/// By how much of itself the mean error falls from one repetition to the next: minus the slope of
/// the least-squares line through the logarithm of the people's mean over the range.
double learning_rate(std::span<const Curve* const> people, Range range);

/// A figure of two groups of the same simulated people, a and b in the same order.
using Comparison =
    std::function<double(std::span<const Curve* const> a, std::span<const Curve* const> b)>;

/// The figure, and the middle 95 % of it over `draws` groups of people drawn with replacement
/// (percentile bootstrap: Efron & Tibshirani 1993, chapter 13). The same person is drawn in both.
Interval bootstrap(const std::vector<Curve>& a, const std::vector<Curve>& b,
                   const Comparison& compare, std::uint64_t seed, int draws = 4000);

}  // namespace secondskin::study
