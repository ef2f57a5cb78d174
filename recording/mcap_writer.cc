#include "recording/mcap_writer.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/stat.h>
#include <sys/uio.h>
#include <unistd.h>
#include <zstd.h>

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <cmath>
#include <initializer_list>
#include <limits>
#include <optional>
#include <stdexcept>
#include <system_error>
#include <utility>
#include <vector>

#include "recording/mcap_format.h"

namespace secondskin::recording {
namespace {

using mcap::Bytes;
using mcap::Encoder;
using mcap::Op;
using SteadyClock = std::chrono::steady_clock;

constexpr std::string_view kCompression = "zstd";
constexpr int kZstdLevel = 1;
constexpr auto kSyncPeriod = std::chrono::seconds(1);
/// How far ahead of the end blocks are reserved at a time.
constexpr std::uint64_t kReserveStep = 8 << 20;
/// Statistics without its map, data end, summary offsets, footer and magic are below this.
constexpr std::uint64_t kSummaryFixed = 512;
constexpr std::uint64_t kStatisticsPerChannel = 2 + 8;
/// A channel is declared in the first chunks that could need it, so that one damaged chunk costs no
/// other chunk its meaning when the summary is missing too.
constexpr int kDeclarations = 2;

struct Schema {
  std::string name;
  std::string encoding;
  std::string text;
  std::vector<std::uint8_t> record;
};

struct Channel {
  std::uint16_t schema = 0;
  std::vector<std::uint8_t> record;
  int declared = 0;                 // stored chunks that hold its record
  std::uint64_t messages = 0;       // stored
  std::vector<std::uint8_t> index;  // of the open chunk: pairs of log time and offset, encoded
};

/// Repeated in the summary, one record after another, all of one kind.
struct Group {
  Op op;
  std::vector<std::uint8_t> records;
  std::uint32_t count = 0;
};

std::error_code last_error() { return {errno, std::generic_category()}; }

}  // namespace

struct McapWriter::State {
  State(const std::filesystem::path& path, McapWriterOptions options);
  ~State();
  State(const State&) = delete;
  State& operator=(const State&) = delete;

  std::uint16_t add_channel(std::string_view topic, std::string_view schema_name,
                            std::string_view schema_encoding, std::string_view schema_text,
                            std::string_view message_encoding);
  void write(std::uint16_t id, std::uint32_t sequence, std::int64_t log_time,
             std::int64_t publish_time, Bytes data);
  bool chunk_due(std::int64_t now) const;
  void store_chunk();
  void close();
  void check_open() const;

  std::vector<std::uint8_t> encode_summary() const;
  std::uint64_t summary_bound() const;

  std::error_code reserve(std::uint64_t until);
  std::error_code put(std::uint64_t at, std::span<iovec> parts) const;
  void append(std::initializer_list<Bytes> parts, std::uint64_t summary_growth);
  void sync_if_due();
  [[noreturn]] void fail(std::error_code reason, std::string_view what);
  bool finish_file();

  std::filesystem::path path;
  McapWriterOptions options;
  std::uint64_t chunk_ns = 0;
  int fd = -1;
  std::optional<std::system_error> failure;
  SteadyClock::time_point synced = SteadyClock::now();

  // What the file holds for certain: its end, the CRC up to there, and the summary of it.
  std::uint64_t end = 0;
  std::uint32_t crc = 0;
  std::uint64_t reserved = 0;
  bool can_reserve = true;
  std::uint64_t stored_messages = 0;
  std::uint64_t first_time = 0;
  std::uint64_t last_time = 0;
  Group chunks{Op::kChunkIndex, {}, 0};
  Group attachments{Op::kAttachmentIndex, {}, 0};
  Group metadata{Op::kMetadataIndex, {}, 0};

  std::vector<Schema> schemas;    // id - 1
  std::vector<Channel> channels;  // id - 1
  std::uint64_t declarations_bytes = 0;

  // The open chunk.
  Encoder records;
  std::uint64_t chunk_messages = 0;
  std::uint64_t chunk_first = 0;  // log time of the message that opened it
  std::uint64_t chunk_start = 0;
  std::uint64_t chunk_end = 0;
  SteadyClock::time_point chunk_opened;
  std::vector<std::size_t> undeclared;  // channels whose record the next message brings along
  std::vector<std::size_t> declared;    // channels whose record the open chunk holds

  std::unique_ptr<ZSTD_CCtx, std::size_t (*)(ZSTD_CCtx*)> zstd{ZSTD_createCCtx(), ZSTD_freeCCtx};
  std::vector<std::uint8_t> compressed;
  Encoder head;
  Encoder tail;
};

McapWriter::State::State(const std::filesystem::path& path_in, McapWriterOptions options_in)
    : path(path_in), options(std::move(options_in)) {
  if (!(options.chunk_seconds >= 0 && options.chunk_seconds <= 3600)) {
    throw std::invalid_argument(fmt::format("recording {}: chunk_seconds {}, expected 0 to 3600",
                                            path.string(), options.chunk_seconds));
  }
  if (options.chunk_bytes > mcap::kMostUnpacked / 4) {
    throw std::invalid_argument(fmt::format("recording {}: chunk_bytes {}, expected at most {}",
                                            path.string(), options.chunk_bytes,
                                            mcap::kMostUnpacked / 4));
  }
  chunk_ns = static_cast<std::uint64_t>(std::llround(options.chunk_seconds * 1e9));
  fd = ::open(path.c_str(), O_RDWR | O_CREAT | O_EXCL | O_CLOEXEC, 0644);
  if (fd < 0) {
    throw std::system_error(
        last_error(),
        fmt::format("cannot create recording {} (one that exists is never overwritten)",
                    path.string()));
  }
  head.raw(mcap::kMagic);
  const std::size_t content = head.open_record(Op::kHeader);
  head.string("");  // profile: none of the well-known ones
  head.string(options.library);
  head.close_record(content);
  iovec part{head.out.data(), head.out.size()};
  std::error_code error = reserve(head.out.size() + summary_bound());
  if (!error) error = put(0, {&part, 1});
  if (!error && zstd == nullptr) error = std::make_error_code(std::errc::not_enough_memory);
  if (error) {  // nothing is in the file yet, so it is of no use
    ::unlink(path.c_str());
    ::close(fd);
    throw std::system_error(error, fmt::format("cannot begin recording {}", path.string()));
  }
  ZSTD_CCtx_setParameter(zstd.get(), ZSTD_c_compressionLevel, kZstdLevel);
  end = head.out.size();
  crc = mcap::crc32(0, head.out);
  // The name must outlive a power cut too; a file system that cannot promise that is no obstacle.
  const auto parent = path.parent_path();
  const int folder =
      ::open(parent.empty() ? "." : parent.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  if (folder >= 0) {
    ::fsync(folder);
    ::close(folder);
  }
}

McapWriter::State::~State() {
  try {
    close();
  } catch (...) {  // close() is there for those who want to know
  }
}

void McapWriter::State::check_open() const {
  if (failure) throw *failure;
  if (fd < 0) {
    throw std::system_error(std::make_error_code(std::errc::bad_file_descriptor),
                            fmt::format("recording {} is closed", path.string()));
  }
}

std::uint16_t McapWriter::State::add_channel(std::string_view topic, std::string_view schema_name,
                                             std::string_view schema_encoding,
                                             std::string_view schema_text,
                                             std::string_view message_encoding) {
  check_open();
  if (channels.size() >= std::numeric_limits<std::uint16_t>::max()) {
    throw std::length_error(
        fmt::format("recording {}: no room for topic {}, 65535 is the most", path.string(), topic));
  }
  Channel channel;
  if (!schema_name.empty() || !schema_encoding.empty() || !schema_text.empty()) {
    const auto same = std::find_if(schemas.begin(), schemas.end(), [&](const Schema& schema) {
      return schema.name == schema_name && schema.encoding == schema_encoding &&
             schema.text == schema_text;
    });
    channel.schema = static_cast<std::uint16_t>(same - schemas.begin() + 1);
    if (same == schemas.end()) {
      Encoder record;
      const std::size_t content = record.open_record(Op::kSchema);
      record.number(channel.schema);
      record.string(schema_name);
      record.string(schema_encoding);
      record.string(schema_text);
      record.close_record(content);
      declarations_bytes += record.out.size();
      schemas.push_back({std::string(schema_name), std::string(schema_encoding),
                         std::string(schema_text), std::move(record.out)});
    }
  }
  const auto id = static_cast<std::uint16_t>(channels.size() + 1);
  Encoder record;
  const std::size_t content = record.open_record(Op::kChannel);
  record.number(id);
  record.number(channel.schema);
  record.string(topic);
  record.string(message_encoding);
  record.string("");  // no metadata
  record.close_record(content);
  declarations_bytes += record.out.size();
  channel.record = std::move(record.out);
  channels.push_back(std::move(channel));
  undeclared.push_back(channels.size() - 1);
  return id;
}

void McapWriter::State::write(std::uint16_t id, std::uint32_t sequence, std::int64_t log_time,
                              std::int64_t publish_time, Bytes data) {
  check_open();
  if (id == 0 || id > channels.size()) {
    throw std::invalid_argument(fmt::format("recording {}: channel {}, expected 1 to {}",
                                            path.string(), id, channels.size()));
  }
  if (log_time < 0) {
    throw std::invalid_argument(
        fmt::format("recording {}: log time {}, expected at least 0", path.string(), log_time));
  }
  if (data.size() > mcap::kMostUnpacked / 4) {
    throw std::invalid_argument(
        fmt::format("recording {}: message of {} bytes, expected at most {}", path.string(),
                    data.size(), mcap::kMostUnpacked / 4));
  }
  if (chunk_messages > 0 && chunk_due(log_time)) store_chunk();

  for (const std::size_t index : undeclared) {
    const Channel& channel = channels[index];
    if (channel.schema != 0) records.raw(schemas[channel.schema - 1].record);
    records.raw(channel.record);
    declared.push_back(index);
  }
  undeclared.clear();

  const auto time = static_cast<std::uint64_t>(log_time);
  Encoder entry{std::move(channels[id - 1].index)};
  entry.number(time);
  entry.number(std::uint64_t{records.out.size()});
  channels[id - 1].index = std::move(entry.out);

  const std::size_t content = records.open_record(Op::kMessage);
  records.number(id);
  records.number(sequence);
  records.number(time);
  records.number(publish_time < 0 ? time : static_cast<std::uint64_t>(publish_time));
  records.raw(data);
  records.close_record(content);

  if (chunk_messages == 0) {
    chunk_first = chunk_start = chunk_end = time;
    chunk_opened = SteadyClock::now();
  }
  chunk_start = std::min(chunk_start, time);
  chunk_end = std::max(chunk_end, time);
  ++chunk_messages;
  if (records.out.size() >= options.chunk_bytes) store_chunk();
}

// Two clocks: the messages' own, so that a chunk's span depends on the data alone when it is
// written faster than it happened, and the machine's steady one, so that a wall clock set back
// cannot keep a chunk in memory.
bool McapWriter::State::chunk_due(std::int64_t now) const {
  const bool old_by_log = now >= 0 && static_cast<std::uint64_t>(now) >= chunk_first &&
                          static_cast<std::uint64_t>(now) - chunk_first >= chunk_ns;
  return old_by_log || SteadyClock::now() - chunk_opened >= std::chrono::nanoseconds(chunk_ns);
}

void McapWriter::State::store_chunk() {
  if (chunk_messages == 0) return;
  compressed.resize(std::max(compressed.size(), ZSTD_compressBound(records.out.size())));
  const std::size_t size = ZSTD_compress2(zstd.get(), compressed.data(), compressed.size(),
                                          records.out.data(), records.out.size());
  if (ZSTD_isError(size)) {
    fail(std::make_error_code(std::errc::not_enough_memory), ZSTD_getErrorName(size));
  }

  head.out.clear();
  std::size_t content = head.open_record(Op::kChunk);
  head.number(chunk_start);
  head.number(chunk_end);
  head.number(std::uint64_t{records.out.size()});
  head.number(mcap::crc32(0, records.out));
  head.string(kCompression);
  head.number(std::uint64_t{size});
  // The record's length counts the data, which is handed over from its own buffer.
  const std::uint64_t length = head.out.size() - content + size;
  std::memcpy(head.out.data() + content - 8, &length, sizeof length);
  const std::uint64_t chunk_length = head.out.size() + size;

  tail.out.clear();
  Encoder index;
  content = index.open_record(Op::kChunkIndex);
  index.number(chunk_start);
  index.number(chunk_end);
  index.number(end);
  index.number(chunk_length);
  const std::size_t offsets = index.open_array();
  for (std::size_t i = 0; i < channels.size(); ++i) {
    if (channels[i].index.empty()) continue;
    index.number(static_cast<std::uint16_t>(i + 1));
    index.number(std::uint64_t{end + chunk_length + tail.out.size()});
    const std::size_t record = tail.open_record(Op::kMessageIndex);
    tail.number(static_cast<std::uint16_t>(i + 1));
    const std::size_t array = tail.open_array();
    tail.raw(channels[i].index);
    tail.close_array(array);
    tail.close_record(record);
  }
  index.close_array(offsets);
  index.number(std::uint64_t{tail.out.size()});
  index.string(kCompression);
  index.number(std::uint64_t{size});
  index.number(std::uint64_t{records.out.size()});
  index.close_record(content);

  append({head.out, Bytes(compressed).first(size), tail.out}, index.out.size());

  chunks.records.insert(chunks.records.end(), index.out.begin(), index.out.end());
  ++chunks.count;
  first_time = stored_messages == 0 ? chunk_start : std::min(first_time, chunk_start);
  last_time = std::max(last_time, chunk_end);
  stored_messages += chunk_messages;
  for (Channel& channel : channels) {
    channel.messages += channel.index.size() / 16;
    channel.index.clear();
  }
  for (const std::size_t i : declared) {
    if (++channels[i].declared < kDeclarations) undeclared.push_back(i);
  }
  declared.clear();
  records.out.clear();
  chunk_messages = 0;
  sync_if_due();
}

void McapWriter::State::close() {
  if (failure) throw *failure;
  if (fd < 0) return;
  store_chunk();
  // Channels that never had a message are declared outside of chunks.
  Encoder rest;
  std::vector<std::size_t> declared_now;
  for (std::size_t i = 0; i < channels.size(); ++i) {
    if (channels[i].declared > 0) continue;
    if (channels[i].schema != 0) rest.raw(schemas[channels[i].schema - 1].record);
    rest.raw(channels[i].record);
    declared_now.push_back(i);
  }
  if (!rest.out.empty()) append({rest.out}, 0);
  for (const std::size_t i : declared_now) channels[i].declared = 1;

  errno = 0;
  if (!finish_file()) {
    const std::error_code error = last_error();
    failure.emplace(error, fmt::format("recording {}: its index could not be stored at offset {}, "
                                       "its {} messages are whole",
                                       path.string(), end, stored_messages));
    throw *failure;
  }
}

/// An upper bound on what encode_summary() yields, should every channel be declared.
std::uint64_t McapWriter::State::summary_bound() const {
  return kSummaryFixed + declarations_bytes + channels.size() * kStatisticsPerChannel +
         chunks.records.size() + attachments.records.size() + metadata.records.size();
}

/// Data end, summary, summary offsets, footer and magic for a data section that ends at `end`.
std::vector<std::uint8_t> McapWriter::State::encode_summary() const {
  Encoder out;
  std::size_t content = out.open_record(Op::kDataEnd);
  out.number(crc);
  out.close_record(content);
  const std::size_t summary = out.out.size();

  Group schema_group{Op::kSchema, {}, 0};
  Group channel_group{Op::kChannel, {}, 0};
  std::vector<bool> wanted(schemas.size());
  Encoder counts;
  for (std::size_t i = 0; i < channels.size(); ++i) {
    const Channel& channel = channels[i];
    if (channel.declared == 0) continue;
    if (channel.schema != 0) wanted[channel.schema - 1] = true;
    channel_group.records.insert(channel_group.records.end(), channel.record.begin(),
                                 channel.record.end());
    ++channel_group.count;
    counts.number(static_cast<std::uint16_t>(i + 1));
    counts.number(channel.messages);
  }
  for (std::size_t i = 0; i < schemas.size(); ++i) {
    if (!wanted[i]) continue;
    schema_group.records.insert(schema_group.records.end(), schemas[i].record.begin(),
                                schemas[i].record.end());
    ++schema_group.count;
  }
  Encoder statistics;
  content = statistics.open_record(Op::kStatistics);
  statistics.number(stored_messages);
  statistics.number(static_cast<std::uint16_t>(schema_group.count));
  statistics.number(channel_group.count);
  statistics.number(attachments.count);
  statistics.number(metadata.count);
  statistics.number(chunks.count);
  statistics.number(first_time);
  statistics.number(last_time);
  const std::size_t map = statistics.open_array();
  statistics.raw(counts.out);
  statistics.close_array(map);
  statistics.close_record(content);
  const Group statistics_group{Op::kStatistics, std::move(statistics.out), 1};

  Encoder offsets;
  const std::array<const Group*, 6> groups{&schema_group, &channel_group, &statistics_group,
                                           &chunks,       &attachments,   &metadata};
  for (const Group* group : groups) {
    if (group->records.empty()) continue;
    content = offsets.open_record(Op::kSummaryOffset);
    offsets.number(static_cast<std::uint8_t>(group->op));
    offsets.number(std::uint64_t{end + out.out.size()});
    offsets.number(std::uint64_t{group->records.size()});
    offsets.close_record(content);
    out.raw(group->records);
  }
  const std::uint64_t offsets_at = end + out.out.size();
  out.raw(offsets.out);
  content = out.open_record(Op::kFooter);
  out.number(std::uint64_t{end + summary});
  out.number(offsets_at);
  // The CRC covers the footer's own length, so that is written first.
  constexpr std::uint64_t kLength = mcap::kFooterContent;
  std::memcpy(out.out.data() + content - 8, &kLength, sizeof kLength);
  out.number(mcap::crc32(0, Bytes(out.out).subspan(summary)));
  out.raw(mcap::kMagic);
  return std::move(out.out);
}

/// Makes sure of the blocks up to `until`, so that the summary fits behind whatever was stored; a
/// file system that knows no reservation goes without.
std::error_code McapWriter::State::reserve(std::uint64_t until) {
  if (!can_reserve || until <= reserved) return {};
  const std::uint64_t from = std::max(end, reserved);
  std::error_code error;
  for (const std::uint64_t target : {until + kReserveStep, until}) {
    int result;
    do {
      result = ::fallocate(fd, FALLOC_FL_KEEP_SIZE, static_cast<off_t>(from),
                           static_cast<off_t>(target - from));
    } while (result < 0 && errno == EINTR);
    if (result == 0) {
      reserved = target;
      return {};
    }
    error = last_error();
  }
  if (error == std::errc::no_space_on_device || error == std::errc::file_too_large ||
      error.value() == EDQUOT) {
    return error;
  }
  can_reserve = false;
  return {};
}

std::error_code McapWriter::State::put(std::uint64_t at, std::span<iovec> parts) const {
  while (!parts.empty()) {
    const ssize_t result =
        ::pwritev(fd, parts.data(), static_cast<int>(parts.size()), static_cast<off_t>(at));
    if (result < 0) {
      if (errno == EINTR) continue;
      return last_error();
    }
    auto written = static_cast<std::size_t>(result);
    if (written == 0 && parts.front().iov_len > 0) return std::make_error_code(std::errc::io_error);
    at += written;
    while (!parts.empty() && written >= parts.front().iov_len) {
      written -= parts.front().iov_len;
      parts = parts.subspan(1);
    }
    if (!parts.empty() && written > 0) {
      parts.front().iov_base = static_cast<std::uint8_t*>(parts.front().iov_base) + written;
      parts.front().iov_len -= written;
    }
  }
  return {};
}

/// Stores whole records at the end, in one system call where the kernel takes them in one.
void McapWriter::State::append(std::initializer_list<Bytes> parts, std::uint64_t summary_growth) {
  std::array<iovec, 3> vectors{};
  std::size_t count = 0;
  std::uint64_t size = 0;
  for (const Bytes part : parts) {
    vectors[count++] = {const_cast<std::uint8_t*>(part.data()), part.size()};
    size += part.size();
  }
  std::error_code error = reserve(end + size + summary_bound() + summary_growth);
  if (!error) error = put(end, std::span(vectors).first(count));
  if (error) fail(error, fmt::format("{} bytes could not be stored at offset {}", size, end));
  for (const Bytes part : parts) crc = mcap::crc32(crc, part);
  end += size;
}

void McapWriter::State::sync_if_due() {
  const auto now = SteadyClock::now();
  if (now - synced < kSyncPeriod) return;
  if (::fdatasync(fd) != 0) fail(last_error(), "the disk did not take what was written");
  synced = SteadyClock::now();
}

void McapWriter::State::fail(std::error_code reason, std::string_view what) {
  const bool finished = finish_file();
  failure.emplace(reason,
                  fmt::format("recording {}: {}; the {} messages before are whole{}", path.string(),
                              what, stored_messages, finished ? "" : " but have no index"));
  chunk_messages = 0;
  throw *failure;
}

/// Writes the summary over whatever lies behind `end`, cuts the file there, and closes it.
/// @returns false, with errno set and the file cut to `end`, when the summary could not be stored
bool McapWriter::State::finish_file() {
  std::vector<std::uint8_t> summary = encode_summary();
  iovec part{summary.data(), summary.size()};
  // In this order, because the blocks behind `end` are the reserve: cutting first would give it
  // away.
  std::error_code error = put(end, {&part, 1});
  if (!error && ::ftruncate(fd, static_cast<off_t>(end + summary.size())) != 0)
    error = last_error();
  if (!error && ::fdatasync(fd) != 0) error = last_error();
  if (error) {
    if (::ftruncate(fd, static_cast<off_t>(end)) == 0) ::fdatasync(fd);
  } else {
    end += summary.size();
  }
  ::close(fd);
  fd = -1;
  errno = error.value();
  return !error;
}

McapWriter::McapWriter(const std::filesystem::path& file, McapWriterOptions options)
    : state_(std::make_unique<State>(file, std::move(options))) {}
McapWriter::~McapWriter() = default;
McapWriter::McapWriter(McapWriter&&) noexcept = default;
McapWriter& McapWriter::operator=(McapWriter&&) noexcept = default;

std::uint16_t McapWriter::add_channel(std::string_view topic, std::string_view schema_name,
                                      std::string_view schema_encoding,
                                      std::string_view schema_text,
                                      std::string_view message_encoding) {
  return state_->add_channel(topic, schema_name, schema_encoding, schema_text, message_encoding);
}

void McapWriter::write(std::uint16_t channel, std::uint32_t sequence, std::int64_t log_time_ns,
                       std::int64_t publish_time_ns, std::span<const std::uint8_t> data) {
  state_->write(channel, sequence, log_time_ns, publish_time_ns, data);
}

void McapWriter::flush_if_due(std::int64_t now_ns) {
  state_->check_open();
  if (state_->chunk_messages > 0 && state_->chunk_due(now_ns)) state_->store_chunk();
}

void McapWriter::write_metadata(std::string_view name,
                                const std::map<std::string, std::string>& values) {
  State& state = *state_;
  state.check_open();
  Encoder record;
  std::size_t content = record.open_record(Op::kMetadata);
  record.string(name);
  const std::size_t map = record.open_array();
  for (const auto& [key, value] : values) {
    record.string(key);
    record.string(value);
  }
  record.close_array(map);
  record.close_record(content);

  Encoder index;
  content = index.open_record(Op::kMetadataIndex);
  index.number(state.end);
  index.number(std::uint64_t{record.out.size()});
  index.string(name);
  index.close_record(content);
  state.append({record.out}, index.out.size());
  state.metadata.records.insert(state.metadata.records.end(), index.out.begin(), index.out.end());
  ++state.metadata.count;
}

void McapWriter::write_attachment(std::string_view name, std::string_view media_type,
                                  std::int64_t time_ns, std::span<const std::uint8_t> data) {
  State& state = *state_;
  state.check_open();
  if (time_ns < 0) {
    throw std::invalid_argument(
        fmt::format("recording {}: time {} of attachment {}, expected at least 0",
                    state.path.string(), time_ns, name));
  }
  // An attachment may be large enough to fill the disk: what is already here goes first.
  state.store_chunk();
  const auto time = static_cast<std::uint64_t>(time_ns);
  Encoder head;
  std::size_t content = head.open_record(Op::kAttachment);
  head.number(time);
  head.number(time);
  head.string(name);
  head.string(media_type);
  head.number(std::uint64_t{data.size()});
  const std::uint64_t length = head.out.size() - content + data.size() + 4;
  std::memcpy(head.out.data() + content - 8, &length, sizeof length);
  Encoder tail;
  tail.number(mcap::crc32(mcap::crc32(0, Bytes(head.out).subspan(content)), data));

  Encoder index;
  content = index.open_record(Op::kAttachmentIndex);
  index.number(state.end);
  index.number(std::uint64_t{head.out.size() + data.size() + tail.out.size()});
  index.number(time);
  index.number(time);
  index.number(std::uint64_t{data.size()});
  index.string(name);
  index.string(media_type);
  index.close_record(content);
  state.append({head.out, data, tail.out}, index.out.size());
  state.attachments.records.insert(state.attachments.records.end(), index.out.begin(),
                                   index.out.end());
  ++state.attachments.count;
  state.sync_if_due();
}

void McapWriter::close() { state_->close(); }

std::uint64_t McapWriter::messages() const noexcept {
  return state_->stored_messages + state_->chunk_messages;
}

std::uint64_t McapWriter::stored_bytes() const noexcept { return state_->end; }

}  // namespace secondskin::recording
