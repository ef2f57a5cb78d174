#pragma once

#include <filesystem>
#include <string>
#include <string_view>

namespace secondskin {

/// Writes a file that appears whole or not at all: beside its place as FILE.partial, then renamed.
/// @throws std::system_error naming the file when it cannot be written; nothing is left behind.
void write_whole_file(const std::filesystem::path& file, std::string_view bytes);

/// @throws std::system_error naming the file when it cannot be read to its end.
std::string read_whole_file(const std::filesystem::path& file);

}  // namespace secondskin
