#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <span>
#include <stdexcept>
#include <string>
#include <vector>

/// Reads MCAP files, finished or not: by the index where there is one, else by scanning every
/// record up to the last whole one. Chunks may be zstd, lz4 or uncompressed. Every length is
/// checked against the file before it is believed, and no compressed chunk may unpack to more than
/// 256 MiB. One thread at a time.
namespace secondskin::recording {

class McapError : public std::runtime_error {  ///< "FILE: offset N: found X, expected Y"
 public:
  using std::runtime_error::runtime_error;
};

struct McapChannel {
  std::uint16_t id;
  std::string topic;
  std::string message_encoding;
  std::string schema_name;
  std::string schema_encoding;
  std::string schema_text;
  std::uint64_t messages = 0;
};

struct McapAttachment {
  std::string name;
  std::string media_type;
  std::int64_t log_time_ns;
  std::vector<std::uint8_t> data;
};

struct McapMessage {
  std::uint16_t channel;
  std::uint32_t sequence;
  std::int64_t log_time_ns;
  std::int64_t publish_time_ns;
  std::span<const std::uint8_t> data;  ///< valid until the next call
};

class McapReader {
 public:
  /// @throws McapError when it is no MCAP file or holds no readable record.
  explicit McapReader(const std::filesystem::path& file);
  ~McapReader();
  McapReader(McapReader&&) noexcept;

  /// Whether the file was closed by its writer; false after a crash.
  bool finished() const noexcept;
  /// What had to be left out, in words with the offset; empty when nothing. By index, a chunk is
  /// looked at (and noted here) only when for_each or attachments() comes to it.
  const std::vector<std::string>& damage() const noexcept;

  const std::vector<McapChannel>& channels() const noexcept;
  std::optional<McapChannel> find(std::string_view topic_suffix) const;  ///< topic ends with it
  std::int64_t start_ns() const noexcept;
  std::int64_t end_ns() const noexcept;
  std::uint64_t messages() const noexcept;
  const std::map<std::string, std::map<std::string, std::string>>& metadata() const noexcept;
  std::vector<McapAttachment> attachments() const;

  /// Calls `visit` for each message in order of log time (of file position at equal times) from
  /// start_ns on; it returns false to end. A chunk whose CRC is wrong is left out and noted in
  /// damage(). Holds only a few chunks in memory.
  void for_each(const std::function<bool(const McapMessage&)>& visit, std::int64_t start_ns = 0);

 private:
  struct State;
  std::unique_ptr<State> state_;
};

/// Writes the whole messages, metadata and attachments of a damaged file into a finished new one.
/// @returns how many messages it saved
std::uint64_t repair(const std::filesystem::path& damaged, const std::filesystem::path& repaired);

}  // namespace secondskin::recording
