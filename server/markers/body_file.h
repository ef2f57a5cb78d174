#pragma once

#include <filesystem>

#include "server/markers/marker_body.h"

/// A wearer's calibrated body as a text file (TOML), so that it is measured once: lengths of the
/// segments and where each marker sits. Metres.
namespace secondskin::server {

/// The file appears whole or not at all. @throws std::system_error naming the file.
void save_body(const MarkerBody& body, const std::filesystem::path& file);

/// @throws std::runtime_error naming file, line, field and what was expected.
MarkerBody load_body(const std::filesystem::path& file);

}  // namespace secondskin::server
