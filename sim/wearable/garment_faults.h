#pragma once

#include <cstddef>
#include <limits>
#include <utility>
#include <vector>

/// What goes wrong with a virtual garment, as data. Times on the garment's clock, 0 its start.
namespace secondskin::sim {

/// A board or a source from one time to another [s].
struct Outage {
  std::size_t which = 0;
  double from = 0.0;
  double to = std::numeric_limits<double>::infinity();

  bool holds(std::size_t i, double time) const noexcept {
    return i == which && time >= from && time < to;
  }
};

struct GarmentFaults {
  std::vector<Outage> silent;      ///< boards whose wire carries nothing
  std::vector<Outage> blocked;     ///< sources with a hand before them
  std::vector<Outage> bit_errors;  ///< boards with a noise burst in the digital stream's band
  std::vector<Outage> gain;        ///< boards whose amplifier drives the converter to its limits
  std::vector<std::pair<std::size_t, std::size_t>> swapped;  ///< boards plugged into each other's
                                                             ///< channel
  double temperature_error = 0.0;                            ///< true less assumed [K]
};

inline bool any_holds(const std::vector<Outage>& outages, std::size_t i, double time) noexcept {
  for (const Outage& outage : outages) {
    if (outage.holds(i, time)) return true;
  }
  return false;
}

}  // namespace secondskin::sim
