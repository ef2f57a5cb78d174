#pragma once

#include <fmt/format.h>
#include <fmt/ostream.h>

#include <filesystem>
#include <fstream>
#include <stdexcept>
#include <string>

/// Not part of the public interface.
namespace secondskin::coach {

/// Writes a file beside the one that it is to replace, then puts it in its place: a crash leaves
/// the old or the new one whole. Makes the folder. @throws std::runtime_error naming the file
inline void write_whole_file(const std::filesystem::path& file, const std::string& text) {
  std::error_code error;
  if (file.has_parent_path()) std::filesystem::create_directories(file.parent_path(), error);
  std::filesystem::path beside = file;
  beside += ".new";
  std::ofstream out(beside, std::ios::trunc);
  out << text;
  out.close();
  if (out) std::filesystem::rename(beside, file, error);
  if (!out || error) {
    throw std::runtime_error(
        fmt::format("{}: cannot be written{}", file.string(), error ? ": " + error.message() : ""));
  }
}

}  // namespace secondskin::coach
