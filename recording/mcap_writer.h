#pragma once

#include <cstdint>
#include <filesystem>
#include <map>
#include <memory>
#include <span>
#include <string>
#include <string_view>

/// Writes recordings as MCAP files (mcap.dev): chunked, zstd, CRCs, indexed.
///
/// What is written is safe early: a chunk goes to the file as soon as it holds `chunk_bytes` or its
/// oldest message is `chunk_seconds` old, so a process killed at any moment loses at most that, and
/// the reader opens the file all the same. One thread at a time.
namespace secondskin::recording {

struct McapWriterOptions {
  std::size_t chunk_bytes = 512 * 1024;
  double chunk_seconds = 0.5;
  std::string library = "secondskin";
};

class McapWriter {
 public:
  /// Creates the file; refuses to overwrite one.
  /// @throws std::system_error naming the file and what stands in the way.
  explicit McapWriter(const std::filesystem::path& file, McapWriterOptions options = {});
  ~McapWriter();  ///< closes; errors are lost, so call close()
  McapWriter(McapWriter&&) noexcept;
  McapWriter& operator=(McapWriter&&) noexcept;

  /// Adds a channel with its schema (text of one encoding, e.g. "omgidl"); returns its id.
  std::uint16_t add_channel(std::string_view topic, std::string_view schema_name,
                            std::string_view schema_encoding, std::string_view schema_text,
                            std::string_view message_encoding = "cdr");

  /// @param log_time_ns      when it was received, since the Unix epoch
  /// @param publish_time_ns  when its writer published it; negative when that is not known
  /// @throws std::invalid_argument for an unknown channel, a negative log time, or more than 64 MiB
  /// @throws std::system_error (e.g. ENOSPC) when a full chunk cannot be stored. What was stored
  ///         before stays whole and readable; the file is cut back to its last whole chunk and
  ///         closed with its index where the disk allows; later calls throw too.
  void write(std::uint16_t channel, std::uint32_t sequence, std::int64_t log_time_ns,
             std::int64_t publish_time_ns, std::span<const std::uint8_t> data);

  /// Stores the open chunk if it is old enough at this time; call it when nothing arrives.
  void flush_if_due(std::int64_t now_ns);

  void write_metadata(std::string_view name, const std::map<std::string, std::string>& values);
  void write_attachment(std::string_view name, std::string_view media_type, std::int64_t time_ns,
                        std::span<const std::uint8_t> data);

  /// Stores what is open, writes summary, index and footer, and syncs to the disk.
  void close();

  std::uint64_t messages() const noexcept;      ///< written; after a failure, those in the file
  std::uint64_t stored_bytes() const noexcept;  ///< handed to the kernel: whole records only

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace secondskin::recording
