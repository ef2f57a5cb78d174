#pragma once

#include <filesystem>
#include <fstream>
#include <optional>
#include <string>
#include <vector>

#include "server/optical/optical_receiver.h"

namespace secondskin::server {

/// Writes frames as the tags' bytes, a file a tag, which OpticalReceiver reads back as the very
/// same frames: a cycle of which nothing came is a start byte alone. What was written before a disk
/// was full stays readable.
class ByteRecorder {
 public:
  /// Makes PREFIX0.tag, PREFIX1.tag, …
  /// @throws std::system_error naming the file that cannot be made
  ByteRecorder(const std::string& prefix, const OpticalFormat& format);

  void write(const ProjectorFrame& frame);

  const std::vector<std::string>& files() const noexcept { return names_; }
  /// What went wrong, naming the file; empty when nothing did. Nothing is written after it.
  const std::string& error() const noexcept { return error_; }

 private:
  OpticalFormat format_;
  std::vector<std::string> names_;
  std::vector<std::ofstream> files_;
  std::optional<std::uint64_t> last_cycle_;
  std::vector<std::uint8_t> bytes_;
  std::string error_;
};

}  // namespace secondskin::server
