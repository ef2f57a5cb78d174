#include "clients/study/statistics.h"

#include <algorithm>
#include <cmath>
#include <random>
#include <stdexcept>

namespace secondskin::study {

double mean_error(std::span<const Curve* const> people, Range range) {
  double sum = 0.0;
  std::size_t count = 0;
  for (const Curve* curve : people) {
    for (std::size_t n = range.begin; n < range.end; ++n, ++count) sum += (*curve)[n];
  }
  return sum / static_cast<double>(count);
}

double learning_rate(std::span<const Curve* const> people, Range range) {
  const auto count = static_cast<double>(range.end - range.begin);
  const double middle = 0.5 * (count - 1.0);
  double slope = 0.0, square = 0.0;
  for (std::size_t n = range.begin; n < range.end; ++n) {
    const double x = static_cast<double>(n - range.begin) - middle;
    slope += x * std::log(mean_error(people, {n, n + 1}));
    square += x * x;
  }
  return square > 0.0 ? -slope / square : 0.0;
}

Interval bootstrap(const std::vector<Curve>& a, const std::vector<Curve>& b,
                   const Comparison& compare, std::uint64_t seed, int draws) {
  if (a.size() != b.size() || a.empty()) {
    throw std::invalid_argument("bootstrap: the groups are not of the same people");
  }
  std::vector<const Curve*> drawn_a(a.size()), drawn_b(a.size());
  for (std::size_t i = 0; i < a.size(); ++i) {
    drawn_a[i] = &a[i];
    drawn_b[i] = &b[i];
  }
  Interval interval;
  interval.estimate = compare(drawn_a, drawn_b);
  std::mt19937_64 random(seed);
  std::uniform_int_distribution<std::size_t> person(0, a.size() - 1);
  std::vector<double> figures;
  for (int draw = 0; draw < draws; ++draw) {
    for (std::size_t i = 0; i < a.size(); ++i) {
      const std::size_t who = person(random);
      drawn_a[i] = &a[who];
      drawn_b[i] = &b[who];
    }
    figures.push_back(compare(drawn_a, drawn_b));
  }
  std::sort(figures.begin(), figures.end());
  const auto at = [&](double share) {
    return figures[static_cast<std::size_t>(share * static_cast<double>(figures.size() - 1) + 0.5)];
  };
  interval.low = at(0.025);
  interval.high = at(0.975);
  return interval;
}

}  // namespace secondskin::study
