#pragma once

#include <atomic>
#include <cstdint>
#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

#include "recording/mcap_reader.h"
#include "recording/mcap_writer.h"

/// Recordings for the tests beside this header, and what they hold.
namespace secondskin::recording::testing {

/// A folder of its own for one test, removed with all it holds.
class TemporaryFolder {
 public:
  TemporaryFolder();
  ~TemporaryFolder();
  TemporaryFolder(const TemporaryFolder&) = delete;
  TemporaryFolder& operator=(const TemporaryFolder&) = delete;
  std::filesystem::path operator/(std::string_view name) const { return path_ / name; }

 private:
  std::filesystem::path path_;
};

/// One message with its own copy of the data.
struct Message {
  std::string topic;
  std::uint32_t sequence = 0;
  std::int64_t log_time_ns = 0;
  std::int64_t publish_time_ns = 0;
  std::vector<std::uint8_t> data;

  bool operator==(const Message&) const = default;
};

inline constexpr std::int64_t kEpoch = 1'700'000'000'000'000'000;

/// Bytes that compress somewhat, different for each `seed`.
std::vector<std::uint8_t> bytes(std::uint64_t seed, std::size_t size);

std::vector<std::uint8_t> contents(const std::filesystem::path& file);
void write_contents(const std::filesystem::path& file, const std::vector<std::uint8_t>& bytes);

/// All that `for_each` yields from `start_ns` on.
std::vector<Message> messages_of(McapReader& reader, std::int64_t start_ns = 0);

/// A small finished recording: topics a and b, metadata "session_settings", attachment "note.txt".
struct Recording {
  std::vector<std::uint8_t> file;
  std::vector<std::vector<Message>> chunks;  ///< by chunk, each in order of log time
  std::vector<std::uint64_t> chunk_ends;     ///< offset behind each chunk record
};
Recording make_recording(const std::filesystem::path& file, std::size_t chunks,
                         std::size_t messages_per_chunk, std::size_t message_bytes);

/// One record of the outermost level, found by walking the file with no knowledge but the lengths.
struct OuterRecord {
  std::uint8_t code;
  std::uint64_t at;
  std::uint64_t end;
};
std::vector<OuterRecord> outer_records(const std::vector<std::uint8_t>& file);

/// The largest piece of memory that operator new was asked for since it was set to 0; counted in
/// the programs that link largest_request.cc.
extern std::atomic<std::size_t> largest_request;

}  // namespace secondskin::recording::testing
