#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "motion/body_shape.h"

/// A motion capture suit: which photodetector sits where on the body (Second Skin, 2.1.4).
namespace secondskin {

/// One photodetector of a suit.
struct SuitDetector {
  std::string name;       ///< unique, e.g. "left_wrist_2"
  std::size_t tag = 0;    ///< the tag board that it is plugged into, from 0
  std::size_t input = 0;  ///< the board's input, 0 to 17
  Joint segment{};        ///< the segment that it is sewn over
  double along = 0.5;     ///< as skin_place
  double angle = 0.0;     ///< as skin_place [rad]
};

/// Detectors in the order of tags and inputs; a tag's inputs are used from 0 without a gap.
struct Suit {
  std::string name;
  std::vector<SuitDetector> detectors;

  /// Reads suits/NAME.toml: name, [[detector]] name, tag, input, segment, along, angle_deg.
  /// @throws std::runtime_error naming file, line, field and what was expected (doubled name or
  ///         input, unknown segment, more than eighteen a tag, a gap in the inputs).
  static Suit load(const std::filesystem::path& file);

  std::size_t tags() const noexcept;
  std::size_t detectors_of(std::size_t tag) const noexcept;
};

}  // namespace secondskin
