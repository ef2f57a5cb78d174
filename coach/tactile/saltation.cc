#include "coach/tactile/saltation.h"

#include <algorithm>

namespace secondskin::coach {

double felt_distance_ratio(double interval, double lambda) noexcept {
  const double lt = lambda * interval;
  // Of 1 / (1 + 2 / lt^2), finite at 0.
  return lt * lt / (lt * lt + 2.0);
}

void felt_positions(std::span<const double> position, double interval, double lambda,
                    std::span<double> felt) noexcept {
  const std::size_t count = std::min({position.size(), felt.size(), kMostTaps});
  if (count == 0) return;
  // Normal equations times (lambda t)^2: (lt^2 + neighbours) x_i - x_{i-1} - x_{i+1} = lt^2 p_i.
  // Tridiagonal and diagonally dominant: elimination without pivots (Thomas).
  const double lt2 = lambda * interval * lambda * interval;
  std::array<double, kMostTaps> diagonal;
  for (std::size_t i = 0; i < count; ++i) {
    const double neighbours = (i > 0 ? 1.0 : 0.0) + (i + 1 < count ? 1.0 : 0.0);
    diagonal[i] = lt2 + neighbours;
    felt[i] = lt2 * position[i];
    if (i > 0) {
      diagonal[i] -= 1.0 / diagonal[i - 1];
      felt[i] += felt[i - 1] / diagonal[i - 1];
    }
  }
  felt[count - 1] /= diagonal[count - 1];
  for (std::size_t i = count - 1; i-- > 0;) felt[i] = (felt[i] + felt[i + 1]) / diagonal[i];
}

}  // namespace secondskin::coach
