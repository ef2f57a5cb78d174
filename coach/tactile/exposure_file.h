#pragma once

#include <filesystem>
#include <string>

#include "coach/tactile/exposure.h"

/// A learner's exposure from one session of a day to the next. Start and end of a session only.
namespace secondskin::coach {

/// Sites are told by their place on the body, not by their channel: another body map finds the
/// same skin. Within a quarter of the segment and 60 degrees around it is the same site.
/// @param today  date; another day's doses are forgotten, and a missing file is an empty day
/// @throws std::runtime_error naming file, line, field and what was expected.
ExposureState load_exposure(const std::filesystem::path& file, const BodyMap& map,
                            const std::string& today);

/// Sites of the same day that this map does not have are kept. @throws std::runtime_error
void save_exposure(const std::filesystem::path& file, const BodyMap& map,
                   const ExposureState& state, const std::string& today);

}  // namespace secondskin::coach
