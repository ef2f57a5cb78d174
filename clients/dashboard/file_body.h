#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

/// A file as the body of an HTTP answer, whole or one range of it (RFC 9110, section 14), read in
/// blocks. One thread.
namespace secondskin::dashboard {

enum class Range : std::uint8_t { kWhole, kPart, kUnsatisfiable };

class FileBody {
 public:
  /// @returns nothing when it is no regular file that can be read
  static std::optional<FileBody> open(const std::filesystem::path& file);
  ~FileBody();
  FileBody(FileBody&& other) noexcept;
  FileBody& operator=(FileBody&& other) noexcept;

  std::string etag() const;  ///< changes with size and time of writing
  std::uint64_t left() const noexcept { return end_ - at_; }  ///< to be sent [bytes]

  /// Takes a Range header's value. Several ranges, and what is no range of bytes, mean the whole.
  Range seek(std::string_view range);
  std::string content_range(Range range) const;

  /// The next block; empty at the end, or when the file has become shorter.
  std::span<const char> next();

 private:
  FileBody() = default;

  int fd_ = -1;
  std::uint64_t size_ = 0, at_ = 0, end_ = 0;
  std::int64_t written_ns_ = 0;
  std::vector<char> block_;
};

}  // namespace secondskin::dashboard
