#include "recording/mcap_reader.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <lz4frame.h>
#include <sys/stat.h>
#include <unistd.h>
#include <zstd.h>

#include <algorithm>
#include <cerrno>
#include <limits>
#include <queue>
#include <utility>

#include "recording/mcap_format.h"
#include "recording/mcap_writer.h"

namespace secondskin::recording {
namespace {

using mcap::Bytes;
using mcap::Decoder;
using mcap::kMostUnpacked;
using mcap::kRecordPrefix;
using mcap::Op;

/// How much is read from the file at a time when records are looked at one by one.
constexpr std::uint64_t kWindow = 256 << 10;
/// Messages outside of chunks are gathered into pieces of about this size.
constexpr std::uint64_t kLoosePiece = 1 << 20;

struct Record {
  Op op;
  std::uint64_t at;       // of the record's code
  std::uint64_t content;  // offset of its content
  std::uint64_t length;   // of its content
  std::uint64_t end() const { return content + length; }
};

enum class Compression { kNone, kZstd, kLz4, kUnknown };

Compression compression_named(std::string_view name) {
  if (name.empty()) return Compression::kNone;
  if (name == "zstd") return Compression::kZstd;
  if (name == "lz4") return Compression::kLz4;
  return Compression::kUnknown;
}

/// A chunk, or a run of messages outside of chunks ("loose": no CRC, not compressed).
struct Piece {
  std::uint64_t at = 0;      // of the chunk record, or of the first message
  std::uint64_t data = 0;    // offset of its (compressed) records
  std::uint64_t stored = 0;  // their size in the file
  std::uint64_t size = 0;    // their size unpacked
  std::string compression;
  bool loose = false;
  std::uint64_t start = 0;  // of its log times
  std::uint64_t end = 0;
  bool noted = false;  // as damaged
};

struct Entry {
  std::uint64_t time;
  std::size_t offset;  // of the message's content in the unpacked records
  std::size_t length;
};

struct Unpacked {
  std::unique_ptr<std::uint8_t[]> bytes;
  std::size_t size = 0;
  Bytes view() const { return {bytes.get(), size}; }
};

struct Schema {
  std::string name;
  std::string encoding;
  std::string text;
};

struct AttachmentHead {
  std::string name;
  std::string media_type;
  std::uint64_t log_time;
  std::uint64_t data;  // offset
  std::uint64_t size;
};

std::int64_t to_time(std::uint64_t time) {
  return static_cast<std::int64_t>(
      std::min<std::uint64_t>(time, std::numeric_limits<std::int64_t>::max()));
}

/// An open file of known size, read through a window.
class File {
 public:
  explicit File(const std::filesystem::path& path) : name_(path.string()) {
    fd_ = ::open(path.c_str(), O_RDONLY | O_CLOEXEC);
    struct stat status {};
    if (fd_ < 0 || ::fstat(fd_, &status) != 0) {
      const int error = errno;
      if (fd_ >= 0) ::close(fd_);
      throw McapError(fmt::format("{}: cannot be opened: {}", name_, std::strerror(error)));
    }
    if (!S_ISREG(status.st_mode)) {
      ::close(fd_);
      throw McapError(fmt::format("{}: found a folder or device, expected a file", name_));
    }
    size_ = static_cast<std::uint64_t>(status.st_size);
  }
  ~File() { ::close(fd_); }
  File(const File&) = delete;
  File& operator=(const File&) = delete;

  const std::string& name() const { return name_; }
  std::uint64_t size() const { return size_; }

  /// Fills `out` from `offset`; false when the file does not have or give all of it.
  bool read_into(std::uint64_t offset, std::uint8_t* out, std::uint64_t count) const {
    if (offset > size_ || count > size_ - offset) return false;
    while (count > 0) {
      const ssize_t got = ::pread(fd_, out, count, static_cast<off_t>(offset));
      if (got < 0 && errno == EINTR) continue;
      if (got <= 0) return false;
      out += got;
      offset += static_cast<std::uint64_t>(got);
      count -= static_cast<std::uint64_t>(got);
    }
    return true;
  }

  /// `count` bytes from `offset`, valid until the next call; nothing when they cannot be had.
  std::optional<Bytes> read(std::uint64_t offset, std::uint64_t count) {
    if (offset > size_ || count > size_ - offset) return std::nullopt;
    if (offset < window_at_ || offset + count > window_at_ + window_.size()) {
      const std::uint64_t wanted = std::min(std::max(count, kWindow), size_ - offset);
      window_.resize(wanted);
      window_at_ = offset;
      if (!read_into(offset, window_.data(), wanted)) {
        window_.clear();
        return std::nullopt;
      }
    }
    return Bytes(window_).subspan(offset - window_at_, count);
  }

 private:
  std::string name_;
  int fd_ = -1;
  std::uint64_t size_ = 0;
  std::vector<std::uint8_t> window_;
  std::uint64_t window_at_ = 0;
};

/// @returns what is wrong with the data; empty when `out` is full of it
std::string unpack_zstd(ZSTD_DCtx* context, Bytes packed, std::span<std::uint8_t> out) {
  const std::size_t got =
      ZSTD_decompressDCtx(context, out.data(), out.size(), packed.data(), packed.size());
  if (ZSTD_isError(got)) return fmt::format("zstd: {}", ZSTD_getErrorName(got));
  if (got != out.size()) return fmt::format("found {} bytes, expected {}", got, out.size());
  return {};
}

std::string unpack_lz4(Bytes packed, std::span<std::uint8_t> out) {
  LZ4F_dctx* context = nullptr;
  if (LZ4F_isError(LZ4F_createDecompressionContext(&context, LZ4F_VERSION)))
    return "lz4: no memory";
  const std::unique_ptr<LZ4F_dctx, LZ4F_errorCode_t (*)(LZ4F_dctx*)> owner(
      context, LZ4F_freeDecompressionContext);
  std::size_t read = 0;
  std::size_t written = 0;
  for (;;) {
    std::size_t in = packed.size() - read;
    std::size_t space = out.size() - written;
    const std::size_t hint =
        LZ4F_decompress(context, out.data() + written, &space, packed.data() + read, &in, nullptr);
    if (LZ4F_isError(hint)) return fmt::format("lz4: {}", LZ4F_getErrorName(hint));
    read += in;
    written += space;
    if (hint == 0) break;
    if (in == 0 && space == 0) return "lz4: the data end early or hold too much";
  }
  if (written != out.size()) return fmt::format("found {} bytes, expected {}", written, out.size());
  return {};
}

}  // namespace

struct McapReader::State {
  explicit State(const std::filesystem::path& path) : file(path) {
    if (zstd == nullptr) throw std::bad_alloc();
    open();
  }

  void open();
  void note(std::uint64_t offset, std::string_view what) {
    damage.push_back(fmt::format("offset {}: {}", offset, what));
  }

  std::optional<Record> record_at(std::uint64_t offset);
  bool plausible(std::uint64_t offset);
  std::optional<Bytes> content(const Record& record) {
    return file.read(record.content, record.length);
  }

  bool read_footer();
  bool read_index();
  bool take_summary(const Record& record);
  void forget_index();

  void scan();
  bool scan_record(const Record& record, bool& ended);
  std::optional<std::uint64_t> next_chunk(std::uint64_t from);
  std::optional<Piece> chunk_at(const Record& record, bool exact);
  void scan_piece(Piece piece);
  void close_loose_piece();

  bool take_schema(Bytes bytes);
  bool take_channel(Bytes bytes);
  bool take_metadata(Bytes bytes);
  std::optional<AttachmentHead> attachment_head(const Record& record);
  void name_channels();

  std::optional<Unpacked> load(Piece& piece);
  std::vector<Entry> entries(Piece& piece, Bytes records, bool learn);
  void note_once(Piece& piece, std::string_view what) {
    if (!std::exchange(piece.noted, true)) note(piece.at, what);
  }

  File file;
  std::unique_ptr<ZSTD_DCtx, std::size_t (*)(ZSTD_DCtx*)> zstd{ZSTD_createDCtx(), ZSTD_freeDCtx};
  std::vector<std::uint8_t> packed;

  bool finished = false;
  std::uint64_t footer_at = 0;
  std::uint64_t summary_at = 0;
  std::uint32_t summary_crc = 0;
  bool has_statistics = false;
  std::uint64_t chunks_promised = 0;
  std::uint64_t attachments_promised = 0;
  std::uint64_t metadata_promised = 0;

  bool any_record = false;
  bool any_chunk = false;
  std::map<std::uint16_t, Schema> schemas;
  std::map<std::uint16_t, std::uint16_t> schema_of;  // by channel id
  std::map<std::uint16_t, McapChannel> by_id;
  std::map<std::uint16_t, std::uint64_t> counts;
  std::vector<McapChannel> channels;
  std::vector<Piece> pieces;
  std::optional<Piece> loose;
  std::vector<Record> attachment_records;
  std::vector<Record> metadata_records;
  std::map<std::string, std::map<std::string, std::string>> metadata;
  std::uint64_t messages = 0;
  std::uint64_t start = 0;
  std::uint64_t end = 0;
  std::vector<std::string> damage;
};

void McapReader::State::open() {
  const auto magic = file.read(0, mcap::kMagic.size());
  if (!magic || !std::equal(magic->begin(), magic->end(), mcap::kMagic.begin())) {
    std::string found = "a file of fewer than 8 bytes";
    if (magic) {
      found.clear();
      for (const std::uint8_t byte : *magic) found += fmt::format("{:02x} ", byte);
      found.pop_back();
    }
    throw McapError(
        fmt::format("{}: offset 0: found {}, expected the MCAP magic 89 4d 43 41 50 30 0d 0a",
                    file.name(), found));
  }
  finished = read_footer();
  if (!finished || !read_index()) {
    forget_index();
    scan();
  }
  name_channels();
  std::sort(pieces.begin(), pieces.end(), [](const Piece& a, const Piece& b) {
    return std::pair(a.start, a.at) < std::pair(b.start, b.at);
  });
}

std::optional<Record> McapReader::State::record_at(std::uint64_t offset) {
  const auto prefix = file.read(offset, kRecordPrefix);
  if (!prefix) return std::nullopt;
  Decoder decoder(*prefix);
  Record record{};
  record.op = static_cast<Op>(decoder.number<std::uint8_t>());
  record.at = offset;
  record.content = offset + kRecordPrefix;
  record.length = decoder.number<std::uint64_t>();
  if (record.length > file.size() - record.content) return std::nullopt;
  return record;
}

/// Whether a record may begin here; tells a true length before it from a flipped one.
bool McapReader::State::plausible(std::uint64_t offset) {
  const auto prefix =
      file.read(offset, std::min<std::uint64_t>(kRecordPrefix, file.size() - offset));
  if (!prefix) return false;
  if (prefix->empty()) return true;
  if (prefix->front() == 0) return false;
  // No record is 2^48 bytes long.
  return prefix->size() < kRecordPrefix || ((*prefix)[7] == 0 && (*prefix)[8] == 0);
}

bool McapReader::State::read_footer() {
  constexpr std::uint64_t kEnd = kRecordPrefix + mcap::kFooterContent + mcap::kMagic.size();
  if (file.size() < mcap::kMagic.size() + kEnd) return false;
  footer_at = file.size() - kEnd;
  const auto bytes = file.read(footer_at, kEnd);
  if (!bytes) return false;
  Decoder decoder(*bytes);
  const auto op = static_cast<Op>(decoder.number<std::uint8_t>());
  const auto length = decoder.number<std::uint64_t>();
  summary_at = decoder.number<std::uint64_t>();
  decoder.number<std::uint64_t>();  // summary offsets: the summary is read whole
  summary_crc = decoder.number<std::uint32_t>();
  const Bytes magic = decoder.rest();
  return op == Op::kFooter && length == mcap::kFooterContent &&
         std::equal(magic.begin(), magic.end(), mcap::kMagic.begin());
}

/// Takes everything from the summary. False when it cannot stand for the file.
bool McapReader::State::read_index() {
  if (summary_at == 0) return false;  // the file has none, which is allowed
  if (summary_at < mcap::kMagic.size() || summary_at >= footer_at) {
    note(footer_at, fmt::format("found a summary at {}, expected one before; the file was scanned",
                                summary_at));
    return false;
  }
  if (summary_crc != 0) {
    const std::uint64_t until = footer_at + kRecordPrefix + mcap::kFooterContent - 4;
    std::uint32_t crc = 0;
    for (std::uint64_t at = summary_at; at < until;) {
      const auto bytes = file.read(at, std::min(kWindow, until - at));
      if (!bytes) return false;
      crc = mcap::crc32(crc, *bytes);
      at += bytes->size();
    }
    if (crc != summary_crc) {
      note(summary_at,
           fmt::format("found a summary of CRC {:08x}, expected {:08x}; the file was scanned", crc,
                       summary_crc));
      return false;
    }
  }
  for (std::uint64_t at = summary_at; at < footer_at;) {
    const auto record = record_at(at);
    if (!record || record->end() > footer_at || !take_summary(*record)) {
      note(at, "the summary contradicts the file; the file was scanned");
      return false;
    }
    at = record->end();
  }
  // A summary need not be complete. Where it is not, the whole file tells.
  if (!has_statistics || chunks_promised != pieces.size() ||
      attachments_promised != attachment_records.size() ||
      metadata_promised != metadata_records.size() ||
      (messages > 0 && (pieces.empty() || by_id.empty() || counts.empty()))) {
    return false;
  }
  for (const Record& record : metadata_records) {
    const auto found = record_at(record.at);
    std::optional<Bytes> bytes;
    if (found && found->op == Op::kMetadata && found->length == record.length)
      bytes = content(record);
    if (!bytes || !take_metadata(*bytes)) {
      note(record.at, "metadata left out: found no whole record where the index has one");
    }
  }
  any_record = true;
  return true;
}

bool McapReader::State::take_summary(const Record& record) {
  // Only records of bounded fields are read here; chunks and the like have no place in a summary.
  const auto bytes = content(record);
  if (!bytes) return false;
  Decoder decoder(*bytes);
  // Where a record that the index names must lie.
  const auto inside = [&](std::uint64_t at, std::uint64_t length) {
    return at >= mcap::kMagic.size() && length >= kRecordPrefix && at <= summary_at &&
           length <= summary_at - at;
  };
  switch (record.op) {
    case Op::kSchema:
      return take_schema(*bytes);
    case Op::kChannel:
      return take_channel(*bytes);
    case Op::kStatistics: {
      has_statistics = true;
      messages = decoder.number<std::uint64_t>();
      decoder.number<std::uint16_t>();
      decoder.number<std::uint32_t>();
      attachments_promised = decoder.number<std::uint32_t>();
      metadata_promised = decoder.number<std::uint32_t>();
      chunks_promised = decoder.number<std::uint32_t>();
      start = decoder.number<std::uint64_t>();
      end = decoder.number<std::uint64_t>();
      Decoder map(decoder.block());
      while (map.ok() && !map.at_end()) {
        const auto id = map.number<std::uint16_t>();
        counts[id] = map.number<std::uint64_t>();
      }
      return decoder.ok() && map.ok();
    }
    case Op::kChunkIndex: {
      Piece piece;
      piece.start = decoder.number<std::uint64_t>();
      piece.end = decoder.number<std::uint64_t>();
      piece.at = decoder.number<std::uint64_t>();
      const auto length = decoder.number<std::uint64_t>();
      decoder.block();  // message index offsets: whole chunks are read
      decoder.number<std::uint64_t>();
      piece.compression = decoder.string();
      piece.stored = decoder.number<std::uint64_t>();
      piece.size = decoder.number<std::uint64_t>();
      const std::uint64_t before = kRecordPrefix + mcap::kChunkFields + piece.compression.size();
      piece.data = piece.at + before;
      if (!decoder.ok() || !inside(piece.at, length) || length < before ||
          piece.stored > length - before) {
        return false;
      }
      pieces.push_back(std::move(piece));
      return true;
    }
    case Op::kAttachmentIndex:
    case Op::kMetadataIndex: {
      const auto at = decoder.number<std::uint64_t>();
      const auto length = decoder.number<std::uint64_t>();
      if (!decoder.ok() || !inside(at, length)) return false;
      auto& list = record.op == Op::kMetadataIndex ? metadata_records : attachment_records;
      list.push_back({record.op == Op::kMetadataIndex ? Op::kMetadata : Op::kAttachment, at,
                      at + kRecordPrefix, length - kRecordPrefix});
      return true;
    }
    case Op::kSummaryOffset:
      return true;
    default:  // later additions may be passed over, known records of the data section not
      return static_cast<std::uint8_t>(record.op) > static_cast<std::uint8_t>(Op::kDataEnd);
  }
}

void McapReader::State::forget_index() {
  schemas.clear();
  schema_of.clear();
  by_id.clear();
  counts.clear();
  pieces.clear();
  attachment_records.clear();
  metadata_records.clear();
  metadata.clear();
  messages = start = end = 0;
}

void McapReader::State::scan() {
  std::uint64_t at = mcap::kMagic.size();
  bool ended = false;
  while (at < file.size() && !ended) {
    const auto record = record_at(at);
    if (record && scan_record(*record, ended)) {
      any_record = true;
      at = record->end();
      continue;
    }
    close_loose_piece();
    if (const auto next = next_chunk(at + 1)) {
      note(at,
           fmt::format("found {} bytes that are no sound record, expected one; they were left out",
                       *next - at));
      at = *next;
    } else {
      note(at, fmt::format("the last {} bytes are no whole record and were left out",
                           file.size() - at));
      at = file.size();
    }
  }
  close_loose_piece();
  if (!any_record) {
    throw McapError(
        fmt::format("{}: offset 8: found no readable record, expected a header", file.name()));
  }
  for (const auto& [id, channel_count] : counts) messages += channel_count;
}

/// Takes in one record of the data section; false when it is not sound.
bool McapReader::State::scan_record(const Record& record, bool& ended) {
  const bool loose_kind =
      record.op == Op::kMessage || record.op == Op::kSchema || record.op == Op::kChannel;
  if (!loose_kind) close_loose_piece();
  switch (record.op) {
    case Op::kHeader: {
      if (record.at != mcap::kMagic.size()) return false;
      const auto bytes = content(record);
      if (!bytes) return false;
      Decoder decoder(*bytes);
      decoder.block();
      decoder.block();
      return decoder.ok() && plausible(record.end());
    }
    case Op::kSchema:
    case Op::kChannel: {
      if (!plausible(record.end())) return false;
      const auto bytes = content(record);
      if (!bytes) return false;
      return record.op == Op::kSchema ? take_schema(*bytes) : take_channel(*bytes);
    }
    case Op::kMessage: {
      if (record.length < mcap::kMessageFields || !plausible(record.end())) return false;
      const auto fields = file.read(record.content, mcap::kMessageFields);
      if (!fields) return false;
      Decoder decoder(*fields);
      decoder.number<std::uint16_t>();
      // A message index whose code was flipped has its own length where a message has its number.
      const auto sequence = decoder.number<std::uint32_t>();
      if (any_chunk && sequence == record.length - 6 && sequence % 16 == 0) return false;
      if (!loose) {
        loose.emplace();
        loose->at = loose->data = record.at;
        loose->loose = true;
      }
      loose->stored = loose->size = record.end() - loose->at;
      if (loose->stored >= kLoosePiece) close_loose_piece();
      return true;
    }
    case Op::kChunk: {
      auto piece = chunk_at(record, false);
      if (!piece || !plausible(record.end())) return false;
      any_chunk = true;
      scan_piece(std::move(*piece));
      return true;
    }
    case Op::kMessageIndex: {
      const auto fields = file.read(record.content, std::min<std::uint64_t>(record.length, 6));
      if (!fields) return false;
      Decoder decoder(*fields);
      decoder.number<std::uint16_t>();
      const auto size = decoder.number<std::uint32_t>();
      return decoder.ok() && size == record.length - 6 && size % 16 == 0;
    }
    case Op::kAttachment:
      if (!plausible(record.end()) || !attachment_head(record)) return false;
      attachment_records.push_back(record);
      return true;
    case Op::kMetadata: {
      if (!plausible(record.end())) return false;
      const auto bytes = content(record);
      return bytes && take_metadata(*bytes);
    }
    case Op::kDataEnd:
      ended = record.length == mcap::kDataEndContent;
      return ended;
    case Op::kFooter:
      ended = finished && record.at == footer_at;
      return ended;
    case Op::kChunkIndex:
    case Op::kAttachmentIndex:
    case Op::kStatistics:
    case Op::kMetadataIndex:
    case Op::kSummaryOffset:
      return false;  // no place before the end of the data
  }
  return static_cast<std::uint8_t>(record.op) != 0 && plausible(record.end());
}

/// The chunk that this record holds, when its fields agree with its length.
std::optional<Piece> McapReader::State::chunk_at(const Record& record, bool exact) {
  if (record.length < mcap::kChunkFields) return std::nullopt;
  // Names of compressions are short; this keeps the read small.
  const auto bytes =
      file.read(record.content, std::min<std::uint64_t>(record.length, mcap::kChunkFields + 64));
  if (!bytes) return std::nullopt;
  Decoder decoder(*bytes);
  Piece piece;
  piece.at = record.at;
  piece.start = decoder.number<std::uint64_t>();
  piece.end = decoder.number<std::uint64_t>();
  piece.size = decoder.number<std::uint64_t>();
  decoder.number<std::uint32_t>();
  piece.compression = decoder.string();
  piece.stored = decoder.number<std::uint64_t>();
  const std::uint64_t before = mcap::kChunkFields + piece.compression.size();
  piece.data = record.content + before;
  if (!decoder.ok() || record.length < before) return std::nullopt;
  const std::uint64_t left = record.length - before;
  if (exact ? piece.stored != left : piece.stored > left) return std::nullopt;
  if (exact && compression_named(piece.compression) == Compression::kUnknown) return std::nullopt;
  return piece;
}

void McapReader::State::scan_piece(Piece piece) {
  const auto unpacked = load(piece);
  if (!unpacked) return;
  const auto found = entries(piece, unpacked->view(), true);
  if (found.empty()) return;
  // The times in a chunk's own fields are under no CRC; those of its messages are.
  piece.start = found.front().time;
  piece.end = found.back().time;
  if (pieces.empty()) {
    start = piece.start;
    end = piece.end;
  }
  start = std::min(start, piece.start);
  end = std::max(end, piece.end);
  for (const Entry& entry : found) {
    Decoder decoder(unpacked->view().subspan(entry.offset, entry.length));
    ++counts[decoder.number<std::uint16_t>()];
  }
  pieces.push_back(std::move(piece));
}

void McapReader::State::close_loose_piece() {
  if (!loose) return;
  scan_piece(*std::exchange(loose, std::nullopt));
}

/// Where the next whole chunk begins, after bytes that made no sense.
std::optional<std::uint64_t> McapReader::State::next_chunk(std::uint64_t from) {
  while (from < file.size()) {
    const auto window = file.read(from, std::min(kWindow, file.size() - from));
    if (!window) return std::nullopt;
    const std::uint64_t until = from + window->size();
    // chunk_at moves the window, so the places are gathered first.
    std::vector<std::uint64_t> places;
    for (std::size_t i = 0; i < window->size(); ++i) {
      if ((*window)[i] != static_cast<std::uint8_t>(Op::kChunk)) continue;
      if (i + 9 <= window->size() && ((*window)[i + 7] != 0 || (*window)[i + 8] != 0)) continue;
      places.push_back(from + i);
    }
    for (const std::uint64_t place : places) {
      const auto record = record_at(place);
      if (record && chunk_at(*record, true)) return place;
    }
    from = until;
  }
  return std::nullopt;
}

bool McapReader::State::take_schema(Bytes bytes) {
  Decoder decoder(bytes);
  const auto id = decoder.number<std::uint16_t>();
  Schema schema;
  schema.name = decoder.string();
  schema.encoding = decoder.string();
  schema.text = decoder.string();
  if (decoder.ok() && id != 0) schemas.emplace(id, std::move(schema));
  return decoder.ok();
}

bool McapReader::State::take_channel(Bytes bytes) {
  Decoder decoder(bytes);
  McapChannel channel{};
  channel.id = decoder.number<std::uint16_t>();
  const auto schema = decoder.number<std::uint16_t>();
  channel.topic = decoder.string();
  channel.message_encoding = decoder.string();
  decoder.block();  // its metadata
  if (!decoder.ok()) return false;
  if (by_id.emplace(channel.id, channel).second) schema_of[channel.id] = schema;
  return true;
}

bool McapReader::State::take_metadata(Bytes bytes) {
  Decoder decoder(bytes);
  const std::string name = decoder.string();
  Decoder map(decoder.block());
  std::map<std::string, std::string> values;
  while (map.ok() && !map.at_end()) {
    std::string key = map.string();
    values[std::move(key)] = map.string();
  }
  if (!decoder.ok() || !map.ok()) return false;
  metadata[name] = std::move(values);
  return true;
}

std::optional<AttachmentHead> McapReader::State::attachment_head(const Record& record) {
  AttachmentHead head;
  std::uint64_t at = record.content;
  // Field by field, each within the record, so that the data themselves are not read.
  const auto take = [&](std::uint64_t size) -> std::optional<Bytes> {
    if (size > record.end() - at) return std::nullopt;
    at += size;
    return file.read(at - size, size);
  };
  const auto text = [&](std::string& out) {
    const auto size = take(4);
    if (!size) return false;
    const auto bytes = take(Decoder(*size).number<std::uint32_t>());
    if (!bytes) return false;
    out.assign(bytes->begin(), bytes->end());
    return true;
  };
  const auto times = take(16);
  if (!times) return std::nullopt;
  head.log_time = Decoder(*times).number<std::uint64_t>();
  if (!text(head.name) || !text(head.media_type)) return std::nullopt;
  const auto size = take(8);
  if (!size) return std::nullopt;
  head.size = Decoder(*size).number<std::uint64_t>();
  head.data = at;
  if (record.end() - at < 4 || head.size > record.end() - at - 4) return std::nullopt;
  return head;
}

void McapReader::State::name_channels() {
  channels.clear();
  for (auto& [id, channel] : by_id) {
    if (const auto schema = schemas.find(schema_of[id]); schema != schemas.end()) {
      channel.schema_name = schema->second.name;
      channel.schema_encoding = schema->second.encoding;
      channel.schema_text = schema->second.text;
    }
    channel.messages = counts[id];
    channels.push_back(channel);
  }
}

/// The unpacked records of a piece; nothing, and a note, when they are not what was stored.
std::optional<Unpacked> McapReader::State::load(Piece& piece) {
  const auto refuse = [&](std::string_view what) {
    note_once(piece, fmt::format("chunk left out: {}", what));
    return std::nullopt;
  };
  const Compression compression = compression_named(piece.compression);
  if (compression == Compression::kUnknown) {
    return refuse(
        fmt::format("found compression \"{}\", expected zstd, lz4 or none", piece.compression));
  }
  if (piece.size > kMostUnpacked && compression != Compression::kNone) {
    return refuse(
        fmt::format("found {} bytes of records, expected at most {}", piece.size, kMostUnpacked));
  }
  if (compression == Compression::kNone && piece.size != piece.stored) {
    return refuse(fmt::format("found {} bytes of records, expected {}", piece.stored, piece.size));
  }
  std::uint32_t expected_crc = 0;
  if (!piece.loose) {
    const auto crc = file.read(piece.at + kRecordPrefix + mcap::kChunkCrcAt, 4);
    if (!crc) return refuse("it cannot be read");
    expected_crc = Decoder(*crc).number<std::uint32_t>();
  }
  Unpacked result;
  if (compression == Compression::kNone) {
    result.size = piece.size;
    result.bytes = std::make_unique_for_overwrite<std::uint8_t[]>(result.size);
    if (!file.read_into(piece.data, result.bytes.get(), result.size))
      return refuse("it cannot be read");
  } else {
    packed.resize(piece.stored);
    if (!file.read_into(piece.data, packed.data(), packed.size()))
      return refuse("it cannot be read");
    // Before the memory is taken: what the frame says of itself must agree.
    if (compression == Compression::kZstd) {
      const auto promised = ZSTD_getFrameContentSize(packed.data(), packed.size());
      if (promised == ZSTD_CONTENTSIZE_ERROR ||
          (promised != ZSTD_CONTENTSIZE_UNKNOWN && promised != piece.size)) {
        return refuse("its zstd data do not hold what it says");
      }
    }
    result.size = piece.size;
    result.bytes = std::make_unique_for_overwrite<std::uint8_t[]>(result.size);
    const std::span<std::uint8_t> out(result.bytes.get(), result.size);
    const std::string wrong = compression == Compression::kZstd
                                  ? unpack_zstd(zstd.get(), packed, out)
                                  : unpack_lz4(packed, out);
    if (!wrong.empty()) return refuse(wrong);
  }
  if (expected_crc != 0) {
    const std::uint32_t crc = mcap::crc32(0, result.view());
    if (crc != expected_crc) {
      return refuse(fmt::format("found CRC {:08x}, expected {:08x}", crc, expected_crc));
    }
  }
  return result;
}

/// The messages of a piece in order of log time. With `learn`, its schemas and channels too.
std::vector<Entry> McapReader::State::entries(Piece& piece, Bytes records, bool learn) {
  std::vector<Entry> found;
  std::uint64_t strangers = 0;
  bool ordered = true;
  Decoder decoder(records);
  while (!decoder.at_end()) {
    const auto op = static_cast<Op>(decoder.number<std::uint8_t>());
    const auto length = decoder.number<std::uint64_t>();
    const Bytes body = decoder.take(length);
    if (!decoder.ok() || (op == Op::kMessage && body.size() < mcap::kMessageFields)) {
      note_once(piece, "the last record of this chunk is not whole and was left out");
      break;
    }
    if (learn && op == Op::kSchema) take_schema(body);
    if (learn && op == Op::kChannel) take_channel(body);
    if (op != Op::kMessage) continue;
    Decoder fields(body);
    if (!by_id.contains(fields.number<std::uint16_t>())) {
      ++strangers;
      continue;
    }
    fields.number<std::uint32_t>();
    const auto time = fields.number<std::uint64_t>();
    if (!found.empty() && time < found.back().time) ordered = false;
    found.push_back({time, static_cast<std::size_t>(body.data() - records.data()), body.size()});
  }
  if (strangers > 0) {
    note_once(piece,
              fmt::format("{} messages of channels that the file does not describe were left out",
                          strangers));
  }
  if (!ordered) {
    std::stable_sort(found.begin(), found.end(),
                     [](const Entry& a, const Entry& b) { return a.time < b.time; });
  }
  return found;
}

McapReader::McapReader(const std::filesystem::path& file) : state_(std::make_unique<State>(file)) {}
McapReader::~McapReader() = default;
McapReader::McapReader(McapReader&&) noexcept = default;

bool McapReader::finished() const noexcept { return state_->finished; }
const std::vector<std::string>& McapReader::damage() const noexcept { return state_->damage; }
const std::vector<McapChannel>& McapReader::channels() const noexcept { return state_->channels; }
std::int64_t McapReader::start_ns() const noexcept { return to_time(state_->start); }
std::int64_t McapReader::end_ns() const noexcept { return to_time(state_->end); }
std::uint64_t McapReader::messages() const noexcept { return state_->messages; }
const std::map<std::string, std::map<std::string, std::string>>& McapReader::metadata()
    const noexcept {
  return state_->metadata;
}

std::optional<McapChannel> McapReader::find(std::string_view topic_suffix) const {
  for (const McapChannel& channel : state_->channels) {
    if (std::string_view(channel.topic).ends_with(topic_suffix)) return channel;
  }
  return std::nullopt;
}

std::vector<McapAttachment> McapReader::attachments() const {
  std::vector<McapAttachment> found;
  std::vector<Record> sound;  // the others are noted once
  for (const Record& listed : state_->attachment_records) {
    const auto record = state_->record_at(listed.at);
    std::optional<AttachmentHead> head;
    if (record && record->op == Op::kAttachment && record->length == listed.length) {
      head = state_->attachment_head(*record);
    }
    if (!head) {
      state_->note(listed.at, "attachment left out: found no whole record");
      continue;
    }
    McapAttachment attachment{head->name, head->media_type, to_time(head->log_time), {}};
    attachment.data.resize(head->size);
    bool whole = state_->file.read_into(head->data, attachment.data.data(), head->size);
    if (whole) {
      const auto crc = state_->file.read(head->data + head->size, 4);
      const auto expected = crc ? Decoder(*crc).number<std::uint32_t>() : 0;
      const auto before = state_->file.read(record->content, head->data - record->content);
      whole = crc && before &&
              (expected == 0 || mcap::crc32(mcap::crc32(0, *before), attachment.data) == expected);
    }
    if (!whole) {
      state_->note(listed.at,
                   fmt::format("attachment \"{}\" left out: its CRC is wrong", head->name));
      continue;
    }
    found.push_back(std::move(attachment));
    sound.push_back(listed);
  }
  state_->attachment_records = std::move(sound);
  return found;
}

void McapReader::for_each(const std::function<bool(const McapMessage&)>& visit,
                          std::int64_t start_ns) {
  struct Cursor {
    Unpacked unpacked;
    std::vector<Entry> entries;
    std::size_t next = 0;
    std::uint64_t at = 0;  // of the piece in the file: the earlier one wins at equal times
    std::pair<std::uint64_t, std::uint64_t> key() const { return {entries[next].time, at}; }
  };
  const auto later = [](const std::unique_ptr<Cursor>& a, const std::unique_ptr<Cursor>& b) {
    return a->key() > b->key();
  };
  std::vector<std::unique_ptr<Cursor>> heap;  // pieces that overlap the present message's time
  const std::uint64_t from = start_ns > 0 ? static_cast<std::uint64_t>(start_ns) : 0;
  auto& pieces = state_->pieces;  // by start
  std::size_t next_piece = 0;
  while (next_piece < pieces.size() || !heap.empty()) {
    while (next_piece < pieces.size() &&
           (heap.empty() || pieces[next_piece].start <= heap.front()->key().first)) {
      Piece& piece = pieces[next_piece++];
      if (piece.end < from) continue;
      auto cursor = std::make_unique<Cursor>();
      auto unpacked = state_->load(piece);
      if (!unpacked) continue;
      cursor->unpacked = std::move(*unpacked);
      cursor->at = piece.at;
      cursor->entries = state_->entries(piece, cursor->unpacked.view(), false);
      while (cursor->next < cursor->entries.size() && cursor->entries[cursor->next].time < from) {
        ++cursor->next;
      }
      if (cursor->next == cursor->entries.size()) continue;
      heap.push_back(std::move(cursor));
      std::push_heap(heap.begin(), heap.end(), later);
    }
    if (heap.empty()) continue;

    std::pop_heap(heap.begin(), heap.end(), later);
    Cursor& cursor = *heap.back();
    const Entry& entry = cursor.entries[cursor.next++];
    Decoder decoder(cursor.unpacked.view().subspan(entry.offset, entry.length));
    McapMessage message{};
    message.channel = decoder.number<std::uint16_t>();
    message.sequence = decoder.number<std::uint32_t>();
    message.log_time_ns = to_time(decoder.number<std::uint64_t>());
    message.publish_time_ns = to_time(decoder.number<std::uint64_t>());
    message.data = decoder.rest();
    if (!visit(message)) return;
    if (cursor.next == cursor.entries.size()) {
      heap.pop_back();
    } else {
      std::push_heap(heap.begin(), heap.end(), later);
    }
  }
}

std::uint64_t repair(const std::filesystem::path& damaged, const std::filesystem::path& repaired) {
  McapReader reader(damaged);
  McapWriter writer(repaired);
  std::map<std::uint16_t, std::uint16_t> ids;
  for (const McapChannel& channel : reader.channels()) {
    ids[channel.id] =
        writer.add_channel(channel.topic, channel.schema_name, channel.schema_encoding,
                           channel.schema_text, channel.message_encoding);
  }
  for (const auto& [name, values] : reader.metadata()) writer.write_metadata(name, values);
  reader.for_each([&](const McapMessage& message) {
    writer.write(ids.at(message.channel), message.sequence, message.log_time_ns,
                 message.publish_time_ns, message.data);
    return true;
  });
  for (const McapAttachment& attachment : reader.attachments()) {
    writer.write_attachment(attachment.name, attachment.media_type, attachment.log_time_ns,
                            attachment.data);
  }
  const std::uint64_t messages = writer.messages();
  writer.close();
  return messages;
}

}  // namespace secondskin::recording
