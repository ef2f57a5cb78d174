#pragma once

#include <CLI/CLI.hpp>
#include <filesystem>

#include "coach/coach.h"

/// Options of every command that cues: what concerns the learner's skin and body.
namespace secondskin::cli {

struct TactileOptions {
  std::filesystem::path profile;     ///< of `calibrate tactors`; empty: the map as it is
  std::filesystem::path safe_range;  ///< empty: none
  bool duration_scaled = false;

  /// Shapes the map to the learner and reads the rest. Says on the log what the map cannot alarm.
  /// @throws std::runtime_error naming file, line, field and what was expected.
  coach::TactileSetup prepare(coach::BodyMap& map) const;
  /// Writes down what the learner's skin has borne, beside the profile; nothing without one.
  void keep(const coach::BodyMap& map, const coach::ExposureState& exposure) const;

 private:
  std::filesystem::path exposure_file() const;
};

void add_tactile_options(CLI::App& command, TactileOptions& options);

}  // namespace secondskin::cli
