#include "wire/garment_stream.h"

#include <zlib.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstring>
#include <stdexcept>

namespace secondskin::wire {
namespace {

static_assert(std::endian::native == std::endian::little);

constexpr std::array<std::uint8_t, 8> kHeaderMagic{0x89, 'G', 'A', 'R', 'M', 'E', 'N', 'T'};
constexpr std::array<std::uint8_t, 4> kBlockMagic{0xB5, 'S', 'L', 'T'};
constexpr std::uint16_t kVersion = 1;
constexpr std::size_t kNameSize = 32;
constexpr std::size_t kBlockHead = 16, kCrcSize = 4;

template <typename T>
void put(std::vector<std::uint8_t>& out, T value) {
  std::array<std::uint8_t, sizeof(T)> bytes;
  std::memcpy(bytes.data(), &value, sizeof(T));
  out.insert(out.end(), bytes.begin(), bytes.end());
}

template <typename T>
T get(std::span<const std::uint8_t> bytes, std::size_t at) noexcept {
  T value;
  std::memcpy(&value, bytes.data() + at, sizeof(T));
  return value;
}

std::uint32_t crc(std::span<const std::uint8_t> bytes) noexcept {
  return static_cast<std::uint32_t>(::crc32(0, bytes.data(), static_cast<unsigned>(bytes.size())));
}

void put_crc(std::vector<std::uint8_t>& out, std::size_t from) {
  put(out, crc(std::span(out).subspan(from)));
}

bool crc_fits(std::span<const std::uint8_t> bytes) noexcept {
  const std::size_t size = bytes.size() - kCrcSize;
  return crc(bytes.first(size)) == get<std::uint32_t>(bytes, size);
}

std::int32_t milli(double value, const char* field) {
  if (!(std::abs(value) < 2e6)) {
    throw std::invalid_argument(std::string("garment stream: ") + field + " is out of range");
  }
  return static_cast<std::int32_t>(std::lround(value * 1e3));
}

double from_milli(std::span<const std::uint8_t> bytes, std::size_t at) noexcept {
  return static_cast<double>(get<std::int32_t>(bytes, at)) * 1e-3;
}

void expect(bool holds, const char* field, const char* expected) {
  if (!holds) {
    throw std::invalid_argument(std::string("garment stream: ") + field + ": expected " + expected);
  }
}

template <std::size_t N>
bool begins_with(std::span<const std::uint8_t> bytes, const std::array<std::uint8_t, N>& magic,
                 bool& may) noexcept {
  const std::size_t n = std::min(N, bytes.size());
  const bool fits =
      std::equal(magic.begin(), magic.begin() + static_cast<std::ptrdiff_t>(n), bytes.begin());
  may = may || fits;
  return fits && n == N;
}

}  // namespace

std::int64_t GarmentStreamHeader::stamp_ns(std::uint32_t sequence) const noexcept {
  return start_ns + std::llround(1e9 * static_cast<double>(sequence) *
                                 static_cast<double>(slot_samples) / sample_rate_hz);
}

void append_header(const GarmentStreamHeader& header, std::vector<std::uint8_t>& out) {
  expect(header.boards >= 1 && header.boards <= kMaxGarmentChannels, "boards", "1 to 64");
  expect(header.sources <= kMaxGarmentChannels, "sources", "0 to 64");
  expect(header.slot_samples >= 1, "slot samples", "at least one");
  expect(header.sample_rate_hz > 0.0, "sample rate", "more than 0");
  expect(header.garment.size() <= kNameSize, "garment's name", "at most 32 bytes");
  const std::size_t from = out.size();
  out.insert(out.end(), kHeaderMagic.begin(), kHeaderMagic.end());
  put(out, kVersion);
  put(out, header.boards);
  put(out, header.sources);
  put(out, header.slot_samples);
  put(out, header.start_ns);
  put(out, milli(header.sample_rate_hz, "sample rate"));
  put(out, milli(header.inertial_rate_hz, "inertial rate"));
  put(out, milli(header.carrier_hz, "carrier"));
  put(out, milli(header.temperature, "temperature"));
  out.insert(out.end(), header.garment.begin(), header.garment.end());
  out.resize(from + kGarmentHeaderSize - kCrcSize, 0);
  put_crc(out, from);
}

void append_slot(const GarmentStreamHeader& header, std::uint32_t sequence,
                 std::span<const std::int16_t> samples, std::vector<std::uint8_t>& out) {
  expect(samples.size() == static_cast<std::size_t>(header.boards) * header.slot_samples, "samples",
         "a slot of each board");
  if (sequence % kSlotsPerHeader == 0) append_header(header, out);
  const std::size_t from = out.size();
  out.insert(out.end(), kBlockMagic.begin(), kBlockMagic.end());
  put(out, sequence);
  put(out, header.sources == 0 ? kNoSource : static_cast<std::uint16_t>(sequence % header.sources));
  put(out, header.boards);
  put(out, header.slot_samples);
  put(out, std::uint16_t{0});
  const std::size_t at = out.size();
  out.resize(at + samples.size_bytes());
  std::memcpy(out.data() + at, samples.data(), samples.size_bytes());
  put_crc(out, from);
}

void GarmentStreamReader::reset() noexcept {
  counters_.skipped_bytes += buffer_.size() - begin_;
  header_.reset();
  last_.reset();
  buffer_.clear();
  begin_ = 0;
}

void GarmentStreamReader::feed(std::span<const std::uint8_t> bytes, const Sink& sink) {
  constexpr std::size_t kPiece = 16384;  // so that the buffer stays small, and moves are rare
  counters_.bytes += bytes.size();
  while (!bytes.empty()) {
    const auto piece = bytes.first(std::min(kPiece, bytes.size()));
    bytes = bytes.subspan(piece.size());
    if (begin_ > 0 && buffer_.size() + piece.size() > buffer_.capacity()) {
      buffer_.erase(buffer_.begin(), buffer_.begin() + static_cast<std::ptrdiff_t>(begin_));
      begin_ = 0;
    }
    buffer_.insert(buffer_.end(), piece.begin(), piece.end());
    search(sink, false);
  }
}

void GarmentStreamReader::finish(const Sink& sink) {
  search(sink, true);
  counters_.skipped_bytes += buffer_.size() - begin_;
  buffer_.clear();
  begin_ = 0;
}

void GarmentStreamReader::search(const Sink& sink, bool ended) {
  for (;;) {
    const std::span rest = std::span<const std::uint8_t>(buffer_).subspan(begin_);
    if (rest.empty()) break;
    bool may = false;
    const bool is_header = begins_with(rest, kHeaderMagic, may);
    const bool is_block = begins_with(rest, kBlockMagic, may);
    std::size_t size = 0;
    if (is_header) {
      size = kGarmentHeaderSize;
    } else if (is_block && header_) {
      // A block whose layout is not the header's is none; no need to wait for its end.
      if (rest.size() < kBlockHead && !ended) break;
      if (rest.size() >= kBlockHead && get<std::uint16_t>(rest, 10) == header_->boards &&
          get<std::uint16_t>(rest, 12) == header_->slot_samples) {
        size = header_->block_size();
      } else {
        ++counters_.garbled;
      }
    } else if (may && !is_block && !ended) {
      break;
    }
    if (size > rest.size() && !ended) break;
    if (size > 0 && size <= rest.size()) {
      const auto whole = rest.first(size);
      if (crc_fits(whole) && (is_header ? take_header(whole) : take_block(whole, sink))) {
        begin_ += size;
        continue;
      }
      ++counters_.garbled;
    }
    const auto next = std::find_if(rest.begin() + 1, rest.end(), [](std::uint8_t byte) {
      return byte == kHeaderMagic[0] || byte == kBlockMagic[0];
    });
    const auto skipped = static_cast<std::size_t>(next - rest.begin());
    counters_.skipped_bytes += skipped;
    begin_ += skipped;
  }
  if (begin_ == buffer_.size()) {
    buffer_.clear();
    begin_ = 0;
  }
}

bool GarmentStreamReader::take_header(std::span<const std::uint8_t> bytes) {
  if (get<std::uint16_t>(bytes, 8) != kVersion) return false;
  GarmentStreamHeader header;
  header.boards = get<std::uint16_t>(bytes, 10);
  header.sources = get<std::uint16_t>(bytes, 12);
  header.slot_samples = get<std::uint16_t>(bytes, 14);
  header.start_ns = get<std::int64_t>(bytes, 16);
  header.sample_rate_hz = from_milli(bytes, 24);
  header.inertial_rate_hz = from_milli(bytes, 28);
  header.carrier_hz = from_milli(bytes, 32);
  header.temperature = from_milli(bytes, 36);
  const auto name = bytes.subspan(40, kNameSize);
  header.garment.assign(name.begin(), std::find(name.begin(), name.end(), 0));
  if (header.boards < 1 || header.boards > kMaxGarmentChannels ||
      header.sources > kMaxGarmentChannels || header.slot_samples < 1 ||
      !(header.sample_rate_hz > 0.0)) {
    return false;
  }
  if (!header_) {
    header_ = header;
    slot_.samples.resize(static_cast<std::size_t>(header.boards) * header.slot_samples);
    buffer_.reserve(2 * header.block_size() + 65536);
    return true;
  }
  GarmentStreamHeader same = header;
  same.temperature = header_->temperature;
  same.start_ns = header_->start_ns;
  if (same != *header_) {
    ++counters_.foreign;
    return true;
  }
  if (header.start_ns != header_->start_ns) last_.reset();  // the box was started anew
  header_ = header;
  return true;
}

bool GarmentStreamReader::take_block(std::span<const std::uint8_t> bytes, const Sink& sink) {
  slot_.sequence = get<std::uint32_t>(bytes, 4);
  const auto source = get<std::uint16_t>(bytes, 8);
  if (source != kNoSource && source >= header_->sources) return false;
  if (last_ && slot_.sequence <= *last_) {
    ++counters_.repeated;
    return true;
  }
  if (last_) counters_.lost += slot_.sequence - *last_ - 1;
  last_ = slot_.sequence;
  slot_.source = source == kNoSource ? std::nullopt : std::optional<std::size_t>(source);
  slot_.stamp_ns = header_->stamp_ns(slot_.sequence);
  std::memcpy(slot_.samples.data(), bytes.data() + kBlockHead,
              slot_.samples.size() * sizeof(std::int16_t));
  ++counters_.slots;
  if (sink) sink(slot_);
  return true;
}

}  // namespace secondskin::wire
