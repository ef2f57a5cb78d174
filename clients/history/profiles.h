#pragma once

#include <filesystem>
#include <string>
#include <vector>

/// Tactile profiles that are a learner's own, of `calibrate tactors --learner`: LEARNER.toml in one
/// folder, and beside it LEARNER.exposure.toml, what the skin bore that day.
namespace secondskin::history {

/// @throws std::runtime_error when the learner's id is no plain file name
std::filesystem::path profile_of(const std::filesystem::path& folder, const std::string& learner);

/// Removes both, and what was half written of them.
/// @returns the names of what was there; nothing for an id that no profile can have
/// @throws std::filesystem::filesystem_error when one cannot be removed
std::vector<std::string> remove_profile(const std::filesystem::path& folder,
                                        const std::string& learner);

}  // namespace secondskin::history
