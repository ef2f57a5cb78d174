#pragma once

#include <cstdint>
#include <filesystem>
#include <map>
#include <optional>
#include <string>

#include "bus/topics.h"
#include "recording/mcap_reader.h"
#include "recording/mcap_writer.h"

/// Recordings by topic: which channel carries which message, and messages into a new recording.
namespace secondskin::players {

/// The places in bus::kTopics of a recording's channels.
std::map<std::uint16_t, std::size_t> topics_of(const recording::McapReader& reader);

/// The subject in the names of a recording's topics; "recording" where they have none.
std::string subject_of(const recording::McapReader& reader);

/// Writes messages under names as the live topics have. One thread.
class TopicFile {
 public:
  /// @param idl  the schemas' file
  /// @throws std::system_error as recording::McapWriter
  TopicFile(const std::filesystem::path& file, const std::filesystem::path& idl,
            std::string subject);

  /// @param name  of the channel; empty: the topic's own
  template <bus::TopicMessage Message>
  void write(std::int64_t time_ns, const Message& message, std::string_view name = {}) {
    write_bytes(bus::kTopicOf<Message>, name, time_ns, bus::encode(message));
  }
  void write_bytes(std::size_t topic, std::string_view name, std::int64_t time_ns,
                   std::span<const std::uint8_t> bytes);
  void write_metadata(std::string_view name, const std::map<std::string, std::string>& values) {
    writer_.write_metadata(name, values);
  }
  void close() { writer_.close(); }

 private:
  struct Channel {
    std::uint16_t id;
    std::uint32_t count;
  };
  recording::McapWriter writer_;
  std::string idl_, subject_;
  std::map<std::string, Channel, std::less<>> channels_;
};

}  // namespace secondskin::players
