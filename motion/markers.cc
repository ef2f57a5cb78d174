#include "motion/markers.h"

namespace secondskin {

std::optional<std::size_t> MarkerMotion::find(std::string_view name) const noexcept {
  for (std::size_t i = 0; i < names.size(); ++i) {
    if (names[i] == name) return i;
  }
  for (std::size_t i = 0; i < names.size(); ++i) {
    const std::string_view full = names[i];
    const std::size_t colon = full.rfind(':');
    if (colon != std::string_view::npos && full.substr(colon + 1) == name) return i;
  }
  return std::nullopt;
}

}  // namespace secondskin
