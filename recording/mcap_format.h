#pragma once

#include <array>
#include <bit>
#include <cstdint>
#include <cstring>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

/// The bytes of an MCAP file, for the writer and the reader beside this header: record codes, the
/// little-endian encoding, and the CRC. The layout is the specification's
/// (https://mcap.dev/spec, "Records" and "Serialization").
namespace secondskin::recording::mcap {

static_assert(std::endian::native == std::endian::little, "numbers are copied as they lie");

using Bytes = std::span<const std::uint8_t>;

inline constexpr std::array<std::uint8_t, 8> kMagic{0x89, 'M', 'C', 'A', 'P', '0', '\r', '\n'};

enum class Op : std::uint8_t {
  kHeader = 0x01,
  kFooter = 0x02,
  kSchema = 0x03,
  kChannel = 0x04,
  kMessage = 0x05,
  kChunk = 0x06,
  kMessageIndex = 0x07,
  kChunkIndex = 0x08,
  kAttachment = 0x09,
  kAttachmentIndex = 0x0A,
  kStatistics = 0x0B,
  kMetadata = 0x0C,
  kMetadataIndex = 0x0D,
  kSummaryOffset = 0x0E,
  kDataEnd = 0x0F,
};

/// The most that a compressed chunk may hold once unpacked. The reader believes no file that asks
/// for more; the writer's chunks stay below with messages and `chunk_bytes` of at most a quarter.
inline constexpr std::uint64_t kMostUnpacked = std::uint64_t{256} << 20;

inline constexpr std::size_t kRecordPrefix = 1 + 8;  ///< code and length of every record
inline constexpr std::size_t kMessageFields = 2 + 4 + 8 + 8;
/// Of a chunk, without the name of its compression and its data.
inline constexpr std::size_t kChunkFields = 8 + 8 + 8 + 4 + 4 + 8;
inline constexpr std::size_t kChunkCrcAt = 8 + 8 + 8;  ///< within the content of a chunk
inline constexpr std::size_t kFooterContent = 8 + 8 + 4;
inline constexpr std::size_t kDataEndContent = 4;

/// CRC-32 (IEEE 802.3, reflected, as zlib's) of `bytes` after those that gave `crc`; 0 begins.
[[nodiscard]] std::uint32_t crc32(std::uint32_t crc, Bytes bytes) noexcept;

inline Bytes bytes_of(std::string_view text) noexcept {
  return {reinterpret_cast<const std::uint8_t*>(text.data()), text.size()};
}

/// Appends the specification's serialised types to `out`.
class Encoder {
 public:
  std::vector<std::uint8_t> out;

  template <typename Number>
  void number(Number value) {
    raw({reinterpret_cast<const std::uint8_t*>(&value), sizeof value});
  }
  void raw(Bytes bytes);
  void string(std::string_view text) {
    number(static_cast<std::uint32_t>(text.size()));
    raw(bytes_of(text));
  }
  /// Opens a record; what it returns goes to `close_record`.
  std::size_t open_record(Op op) {
    number(static_cast<std::uint8_t>(op));
    number(std::uint64_t{0});
    return out.size();
  }
  void close_record(std::size_t content) { put(content - 8, std::uint64_t{out.size() - content}); }
  /// Leaves room for the length of an array or map, for `close_array`.
  std::size_t open_array() {
    number(std::uint32_t{0});
    return out.size();
  }
  void close_array(std::size_t content) {
    put(content - 4, static_cast<std::uint32_t>(out.size() - content));
  }

 private:
  template <typename Number>
  void put(std::size_t at, Number value) {
    std::memcpy(out.data() + at, &value, sizeof value);
  }
};

/// Reads the serialised types; past the end every value is 0 and `ok()` turns false for good.
class Decoder {
 public:
  explicit Decoder(Bytes bytes) : rest_(bytes) {}

  [[nodiscard]] bool ok() const noexcept { return ok_; }
  [[nodiscard]] bool at_end() const noexcept { return rest_.empty(); }
  [[nodiscard]] Bytes rest() const noexcept { return rest_; }

  template <typename Number>
  Number number() noexcept {
    Number value{};
    if (const Bytes raw = take(sizeof value); !raw.empty()) {
      std::memcpy(&value, raw.data(), sizeof value);
    }
    return value;
  }
  Bytes take(std::uint64_t size) noexcept {
    if (size > rest_.size()) {
      ok_ = false;
      rest_ = {};
    }
    if (!ok_) return {};
    const Bytes taken = rest_.first(static_cast<std::size_t>(size));
    rest_ = rest_.subspan(taken.size());
    return taken;
  }
  /// A byte string with its 32-bit length before it: string, array, map.
  Bytes block() noexcept { return take(number<std::uint32_t>()); }
  std::string string() {
    const Bytes text = block();
    return {reinterpret_cast<const char*>(text.data()), text.size()};
  }

 private:
  Bytes rest_;
  bool ok_ = true;
};

}  // namespace secondskin::recording::mcap
