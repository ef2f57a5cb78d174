#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <span>
#include <string>
#include <vector>

/// What a garment's driver box records and streams (Practical Motion Capture, 3.1): the sampled
/// wires of all boards, cut into slots that begin with a source's pulse. A .garment file holds the
/// same bytes. All numbers little-endian:
///
///   header, 80 bytes              block, 20 + 2 * boards * slot_samples bytes
///    0  8  89 'GARMENT'            0  4  B5 'SLT'
///    8  2  version, 1              4  4  sequence: of the slot, from 0
///   10  2  boards                  8  2  source that sounds, slot k's is k mod sources;
///   12  2  sources                        FFFF if there are none
///   14  2  samples a slot         10  2  boards
///   16  8  start: stamp of the    12  2  samples a slot
///          first sample of slot   14  2  0
///          0 [ns since 1970]      16  .. int16, all of board 0, then all of board 1, ...
///   24  4  sample rate [mHz]      ..  4  CRC-32 of all before
///   28  4  inertial rate [mHz]
///   32  4  carrier [mHz]
///   36  4  temperature [mdeg C]
///   40 32  garment's name, UTF-8, zeros after it
///   72  4  0
///   76  4  CRC-32 of all before
///
/// CRC-32 is zlib's. The header comes first and again before every 64th block, so that a reader can
/// join at any time. Slot k's first sample was taken at start + k * samples / rate.
namespace secondskin::wire {

inline constexpr std::uint16_t kNoSource = 0xFFFF;
inline constexpr std::uint32_t kSlotsPerHeader = 64;
inline constexpr std::size_t kGarmentHeaderSize = 80;
inline constexpr std::size_t kMaxGarmentChannels = 64;  ///< boards, and sources

struct GarmentStreamHeader {
  std::string garment;  ///< name, at most 32 bytes
  std::uint16_t boards = 0;
  std::uint16_t sources = 0;
  std::uint16_t slot_samples = 0;
  std::int64_t start_ns = 0;    ///< stamp of the first sample of slot 0
  double sample_rate_hz = 0.0;  ///< to a thousandth, as all below
  double inertial_rate_hz = 0.0;
  double carrier_hz = 0.0;
  double temperature = 20.0;  ///< of the air, as the box measured it [deg C]

  std::size_t block_size() const noexcept {
    return 20 + 2 * static_cast<std::size_t>(boards) * slot_samples;
  }
  /// Stamp of a slot's first sample: when its source's pulse began.
  std::int64_t stamp_ns(std::uint32_t sequence) const noexcept;
  friend bool operator==(const GarmentStreamHeader&, const GarmentStreamHeader&) = default;
};

/// @throws std::invalid_argument naming a field that is out of range
void append_header(const GarmentStreamHeader& header, std::vector<std::uint8_t>& out);

/// The header where it is due, and the block. @param samples  board-major, boards * slot_samples
/// @throws std::invalid_argument on another number of samples, and as append_header
void append_slot(const GarmentStreamHeader& header, std::uint32_t sequence,
                 std::span<const std::int16_t> samples, std::vector<std::uint8_t>& out);

/// One slot as it was read.
struct GarmentSlot {
  std::uint32_t sequence = 0;
  std::optional<std::size_t> source;  ///< that sounds
  std::int64_t stamp_ns = 0;          ///< of its first sample
  std::vector<std::int16_t> samples;  ///< board-major

  std::span<const std::int16_t> board(std::size_t i, std::size_t slot_samples) const noexcept {
    return std::span(samples).subspan(i * slot_samples, slot_samples);
  }
};

/// What a reader met, from the beginning.
struct GarmentStreamCounters {
  std::uint64_t bytes = 0;
  std::uint64_t slots = 0;          ///< whole ones, given out
  std::uint64_t lost = 0;           ///< slots that the sequence says were sent and did not come
  std::uint64_t garbled = 0;        ///< headers and blocks with a wrong CRC
  std::uint64_t skipped_bytes = 0;  ///< that belong to no whole header or block
  std::uint64_t repeated = 0;       ///< slots whose number is not above the last one's: dropped
  std::uint64_t foreign = 0;        ///< headers of another layout than the first: ignored
};

/// Finds the whole slots of a stream, wherever it is cut, torn or garbled. What is given out
/// depends on the bytes alone, not on how feed() got them. After the first header nothing is
/// allocated.
class GarmentStreamReader {
 public:
  using Sink = std::function<void(const GarmentSlot&)>;

  void feed(std::span<const std::uint8_t> bytes, const Sink& sink);
  /// The stream has ended: what is left of a torn block is searched for whole ones and counted.
  void finish(const Sink& sink);
  /// Forgets the stream, as for a device that was plugged in again; counters go on.
  void reset() noexcept;

  /// Empty until the first one has come. Start and temperature are the newest header's.
  const std::optional<GarmentStreamHeader>& header() const noexcept { return header_; }
  const GarmentStreamCounters& counters() const noexcept { return counters_; }

 private:
  void search(const Sink& sink, bool ended);
  bool take_header(std::span<const std::uint8_t> bytes);
  bool take_block(std::span<const std::uint8_t> bytes, const Sink& sink);

  std::optional<GarmentStreamHeader> header_;
  GarmentStreamCounters counters_;
  GarmentSlot slot_;
  std::optional<std::uint32_t> last_;  ///< sequence
  std::vector<std::uint8_t> buffer_;
  std::size_t begin_ = 0;  ///< of what is not yet understood
};

}  // namespace secondskin::wire
