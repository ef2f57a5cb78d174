#pragma once

#include <cstdint>
#include <functional>
#include <span>
#include <vector>

/// The bytes of a photodetector tag and the projectors' timing (Second Skin, 2.1.2 and 2.1.3).
///
/// Once a projector cycle a tag sends one set: kSetStart, then for each of its detectors in the
/// order of its inputs the values of all projectors in the order of their slots, one byte each. A
/// value is 1 to 254; 0 says that nothing was received. kSetStart occurs nowhere else, so any loss
/// shows in the distance of two starts.
namespace secondskin::wire {

inline constexpr std::uint8_t kSetStart = 0xFF;
inline constexpr std::uint8_t kNoValue = 0;
inline constexpr std::size_t kDetectorsOnATag = 18;

// 2.1.2: a cycle is one slot a projector; in the first slot the sync bit comes before the code.
inline constexpr std::int64_t kSlotNs = 1'000'000;
inline constexpr std::int64_t kSyncOnNs = 100'000;
inline constexpr std::int64_t kSyncOffNs = 33'000;
inline constexpr std::int64_t kSyncSeenNs = 90'000;  ///< a light at least so long is the sync bit
inline constexpr std::int64_t kBitOnNs = 33'000;
inline constexpr std::int64_t kBitOffNs = 33'000;
inline constexpr int kBits = 8;
inline constexpr double kCarrierHz = 455'000.0;
inline constexpr int kPulsesToBeSeen = 10;  ///< of the fifteen of a bit

/// When a bit's light goes on, from the beginning of the cycle. Bit 0 is shown first (the most
/// significant). In the slave's slots too: "the tag reads at the correct times".
constexpr std::int64_t bit_start_ns(std::size_t projector, int bit) noexcept {
  const std::int64_t sync = projector == 0 ? kSyncOnNs + kSyncOffNs : 0;
  return static_cast<std::int64_t>(projector) * kSlotNs + sync + bit * (kBitOnNs + kBitOffNs);
}
/// The middle of a projector's code: the instant that its value is stamped with.
constexpr std::int64_t value_time_ns(std::size_t projector) noexcept {
  return (bit_start_ns(projector, 0) + bit_start_ns(projector, kBits - 1) + kBitOnNs) / 2;
}
constexpr std::int64_t cycle_ns(std::size_t projectors) noexcept {
  return static_cast<std::int64_t>(projectors) * kSlotNs;
}

constexpr std::uint8_t to_gray(std::uint8_t binary) noexcept {
  return static_cast<std::uint8_t>(binary ^ (binary >> 1));
}
constexpr std::uint8_t from_gray(std::uint8_t gray) noexcept {
  std::uint8_t binary = gray;
  for (int shift = 1; shift < kBits; shift <<= 1) {
    binary = static_cast<std::uint8_t>(binary ^ (binary >> shift));
  }
  return binary;
}

/// How a tag's sets look.
struct TagFormat {
  std::size_t detectors = kDetectorsOnATag;  ///< 1 to kDetectorsOnATag
  std::size_t projectors = 16;               ///< 1 to 255
  bool gray = false;  ///< the tag sends the Gray code as it is read; else binary (the paper's)
  std::size_t values() const noexcept { return detectors * projectors; }
};

/// One whole set.
struct TagSet {
  std::uint64_t number = 0;     ///< counts the tag's cycles as far as the stream shows them: torn
                                ///< sets count too, sets that left no trace do not
  std::int64_t arrival_ns = 0;  ///< when its start byte was read
  std::vector<std::uint8_t>
      values;  ///< detector-major, binary; kNoValue where nothing was received
};

/// What a decoder met, from the beginning.
struct TagCounters {
  std::uint64_t bytes = 0;
  std::uint64_t sets = 0;         ///< whole ones, given out
  std::uint64_t torn = 0;         ///< sets that were dropped: too short, too long or not confirmed
  std::uint64_t stray_bytes = 0;  ///< bytes of torn sets and before the first start
};

/// Finds the whole sets of a stream. A set is given out only when what follows its last byte shows
/// that none was lost: the next start byte, or silence of the line. A set that is too short or too
/// long is dropped whole. What is given out depends on the bytes and the calls of tick() and
/// finish() alone, not on how feed() cut the bytes. Nothing is allocated after construction.
///
/// What no decoder of this format can see: a flipped value, and a loss of exactly one or more whole
/// sets' lengths that begins inside a set and ends inside another (docs/optical-hardware.md).
class TagDecoder {
 public:
  using Sink = std::function<void(const TagSet&)>;

  /// A tag waits between two sets; no byte for so long after a set's last one ends it.
  static constexpr std::int64_t kSilenceNs = 2'000'000;

  /// @throws std::invalid_argument when the format is out of range
  explicit TagDecoder(const TagFormat& format);

  /// Takes bytes as they were read. @param now_ns when they were read, any clock that goes forward
  void feed(std::span<const std::uint8_t> bytes, std::int64_t now_ns, const Sink& sink);
  /// Says that no byte has come until now: gives out a set that silence has confirmed. To be called
  /// when the line was read and had nothing; a reader that merely was late must read first.
  void tick(std::int64_t now_ns, const Sink& sink);
  /// The stream has ended (a file's end): as silence.
  void finish(const Sink& sink);

  const TagFormat& format() const noexcept { return format_; }
  const TagCounters& counters() const noexcept { return counters_; }

 private:
  void start(std::int64_t now_ns) noexcept;
  void give_out(const Sink& sink);
  void drop_run() noexcept;

  TagFormat format_;
  TagCounters counters_;
  TagSet set_;                     ///< being filled; its values beyond filled_ are old
  bool started_ = false;           ///< a start byte was met, so further bytes belong to some set
  bool open_ = false;              ///< set_ may still become whole
  std::size_t filled_ = 0;         ///< values in set_
  std::uint64_t run_ = 0;          ///< bytes since the last start byte or set given out
  std::int64_t last_byte_ns_ = 0;  ///< when the last byte came
};

/// A set's bytes as a tag sends them, appended to `out`: kSetStart and format.values() bytes.
/// Values and bytes are clamped to 254; so a tag that sends Gray code tells 171 for 170, whose Gray
/// code is kSetStart. @param values detector-major, binary. @throws std::invalid_argument unless
/// there are format.values()
void encode_set(const TagFormat& format, std::span<const std::uint8_t> values,
                std::vector<std::uint8_t>& out);

}  // namespace secondskin::wire
