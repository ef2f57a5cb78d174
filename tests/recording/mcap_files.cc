#include "tests/recording/mcap_files.h"

#include <stdlib.h>

#include <cstring>
#include <fstream>
#include <iterator>
#include <map>
#include <stdexcept>

namespace secondskin::recording::testing {

TemporaryFolder::TemporaryFolder() {
  std::string name = (std::filesystem::temp_directory_path() / "recording_test.XXXXXX").string();
  if (::mkdtemp(name.data()) == nullptr) throw std::runtime_error("cannot make " + name);
  path_ = name;
}

TemporaryFolder::~TemporaryFolder() {
  std::error_code ignored;
  std::filesystem::remove_all(path_, ignored);
}

std::vector<std::uint8_t> bytes(std::uint64_t seed, std::size_t size) {
  std::vector<std::uint8_t> out(size);
  std::uint64_t state = seed * 2 + 1;
  for (std::size_t i = 0; i < size; ++i) {
    state = state * 6364136223846793005u + 1442695040888963407u;
    out[i] = static_cast<std::uint8_t>(i % 4 == 0 ? state >> 56 : i);
  }
  return out;
}

std::vector<std::uint8_t> contents(const std::filesystem::path& file) {
  std::ifstream in(file, std::ios::binary);
  return {std::istreambuf_iterator<char>(in), {}};
}

void write_contents(const std::filesystem::path& file, const std::vector<std::uint8_t>& bytes) {
  // A new file each time: some file systems go to the disk at once when one is overwritten.
  std::filesystem::remove(file);
  std::ofstream out(file, std::ios::binary | std::ios::trunc);
  out.write(reinterpret_cast<const char*>(bytes.data()),
            static_cast<std::streamsize>(bytes.size()));
}

std::vector<Message> messages_of(McapReader& reader, std::int64_t start_ns) {
  std::map<std::uint16_t, std::string> topics;
  for (const McapChannel& channel : reader.channels()) topics[channel.id] = channel.topic;
  std::vector<Message> found;
  reader.for_each(
      [&](const McapMessage& message) {
        found.push_back({topics[message.channel],
                         message.sequence,
                         message.log_time_ns,
                         message.publish_time_ns,
                         {message.data.begin(), message.data.end()}});
        return true;
      },
      start_ns);
  return found;
}

Recording make_recording(const std::filesystem::path& file, std::size_t chunks,
                         std::size_t messages_per_chunk, std::size_t message_bytes) {
  Recording recording;
  McapWriter writer(file);
  const auto a =
      writer.add_channel("rt/secondskin/anna/a", "test::A", "omgidl", "struct A { long x; };");
  const auto b =
      writer.add_channel("rt/secondskin/anna/b", "test::B", "omgidl", "struct B { long y; };");
  writer.write_metadata("session_settings", {{"subject", "anna"}, {"rate_hz", "62.5"}});
  std::uint32_t number = 0;
  for (std::size_t chunk = 0; chunk < chunks; ++chunk) {
    auto& messages = recording.chunks.emplace_back();
    for (std::size_t i = 0; i < messages_per_chunk; ++i) {
      const bool first = number % 3 != 0;
      Message message{first ? "rt/secondskin/anna/a" : "rt/secondskin/anna/b", number,
                      kEpoch + number * 1'000'000LL, kEpoch + number * 1'000'000LL - 1234,
                      bytes(number, message_bytes)};
      writer.write(first ? a : b, message.sequence, message.log_time_ns, message.publish_time_ns,
                   message.data);
      messages.push_back(std::move(message));
      ++number;
    }
    writer.flush_if_due(kEpoch + 1'000'000'000'000);
    if (chunk == 0) {
      const std::string_view note = "a note";
      writer.write_attachment("note.txt", "text/plain", kEpoch,
                              {reinterpret_cast<const std::uint8_t*>(note.data()), note.size()});
    }
  }
  writer.close();
  recording.file = contents(file);
  for (const OuterRecord& record : outer_records(recording.file)) {
    if (record.code == 0x06) recording.chunk_ends.push_back(record.end);
  }
  return recording;
}

std::vector<OuterRecord> outer_records(const std::vector<std::uint8_t>& file) {
  std::vector<OuterRecord> records;
  for (std::uint64_t at = 8; at + 9 <= file.size() - 8;) {
    std::uint64_t length;
    std::memcpy(&length, file.data() + at + 1, sizeof length);
    records.push_back({file[at], at, at + 9 + length});
    at += 9 + length;
  }
  return records;
}

}  // namespace secondskin::recording::testing
