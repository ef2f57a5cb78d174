#include "server/optical/track/value_filter.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cassert>
#include <cstdlib>
#include <stdexcept>

#include "wire/photo_tag.h"

namespace secondskin::server {

ValueFilter::ValueFilter(std::size_t detectors, std::size_t projectors,
                         const ValueFilterOptions& options)
    : options_(options),
      pairs_(detectors * projectors),
      histories_(pairs_ * options.history, wire::kNoValue) {
  if (options.history < 1 || options.history > 255) {
    throw std::invalid_argument(
        fmt::format("history: expected 1 to 255 values, found {}", options.history));
  }
  if (options.median % 2 == 0 || options.median > options.history) {
    throw std::invalid_argument(
        fmt::format("median: expected an odd number of values up to the history's {}, found {}",
                    options.history, options.median));
  }
  if (options.jump < 0 || options.jumps < 0) {
    throw std::invalid_argument(fmt::format("jump and jumps: expected at least 0, found {} and {}",
                                            options.jump, options.jumps));
  }
}

void ValueFilter::update(std::span<const std::uint8_t> values,
                         std::span<std::uint8_t> filtered) noexcept {
  assert(values.size() == pairs_ && filtered.size() == pairs_);
  const std::size_t m = options_.history;
  newest_ = (newest_ + 1) % m;
  for (std::size_t pair = 0; pair < pairs_; ++pair) {
    std::uint8_t* const ring = &histories_[pair * m];
    ring[newest_] = values[pair];

    filtered[pair] = wire::kNoValue;
    const std::uint8_t value = ring[(newest_ + m - delay_frames()) % m];
    if (value == wire::kNoValue) continue;

    int jumps = 0;
    std::uint8_t before = wire::kNoValue;
    for (std::size_t k = 1; k <= m; ++k) {  // oldest first
      const std::uint8_t now = ring[(newest_ + k) % m];
      if (now == wire::kNoValue) continue;
      if (before != wire::kNoValue && std::abs(now - before) > options_.jump) ++jumps;
      before = now;
    }
    if (jumps > options_.jumps) continue;

    std::array<std::uint8_t, 255> window;
    std::size_t n = 0;
    for (std::size_t k = 0; k < options_.median; ++k) {
      const std::uint8_t near = ring[(newest_ + m - k) % m];
      if (near != wire::kNoValue) window[n++] = near;
    }
    // Of two middle ones take neither: the value itself lies between them or is one of them.
    std::sort(window.begin(), window.begin() + n);
    filtered[pair] =
        n % 2 == 1 ? window[n / 2] : std::clamp(value, window[n / 2 - 1], window[n / 2]);
  }
}

}  // namespace secondskin::server
