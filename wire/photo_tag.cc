#include "wire/photo_tag.h"

#include <algorithm>
#include <stdexcept>
#include <string>

namespace secondskin::wire {
namespace {

constexpr std::uint8_t kLargestValue = kSetStart - 1;

// A set's value from its byte. In Gray code a byte can mean 255, which is no value.
std::uint8_t decode_value(bool gray, std::uint8_t byte) noexcept {
  if (!gray) return byte;
  const std::uint8_t binary = from_gray(byte);
  return binary > kLargestValue ? kNoValue : binary;
}

}  // namespace

TagDecoder::TagDecoder(const TagFormat& format) : format_(format) {
  if (format.detectors < 1 || format.detectors > kDetectorsOnATag) {
    throw std::invalid_argument("photo tag: expected 1 to " + std::to_string(kDetectorsOnATag) +
                                " detectors, found " + std::to_string(format.detectors));
  }
  if (format.projectors < 1 || format.projectors > 255) {
    throw std::invalid_argument("photo tag: expected 1 to 255 projectors, found " +
                                std::to_string(format.projectors));
  }
  set_.values.resize(format.values());
}

void TagDecoder::feed(std::span<const std::uint8_t> bytes, std::int64_t now_ns, const Sink& sink) {
  if (bytes.empty()) return;
  counters_.bytes += bytes.size();
  last_byte_ns_ = now_ns;
  for (const std::uint8_t byte : bytes) {
    if (byte == kSetStart) {
      if (open_ && filled_ == set_.values.size()) {
        give_out(sink);
      } else {
        drop_run();
      }
      start(now_ns);
      continue;
    }
    ++run_;
    if (!open_) {
      ++counters_.stray_bytes;
    } else if (filled_ == set_.values.size()) {
      open_ = false;  // too long
      counters_.stray_bytes += run_;
    } else {
      set_.values[filled_++] = decode_value(format_.gray, byte);
    }
  }
}

void TagDecoder::tick(std::int64_t now_ns, const Sink& sink) {
  if (open_ && filled_ == set_.values.size() && now_ns - last_byte_ns_ >= kSilenceNs) {
    give_out(sink);
  }
}

void TagDecoder::finish(const Sink& sink) {
  if (open_ && filled_ == set_.values.size()) {
    give_out(sink);
  } else {
    drop_run();
  }
}

void TagDecoder::start(std::int64_t now_ns) noexcept {
  started_ = true;
  open_ = true;
  filled_ = 0;
  run_ = 1;
  set_.arrival_ns = now_ns;
}

void TagDecoder::give_out(const Sink& sink) {
  // Each set that was dropped was one of the tag's cycles.
  set_.number = counters_.sets + counters_.torn;
  ++counters_.sets;
  open_ = false;
  run_ = 0;
  sink(set_);
}

void TagDecoder::drop_run() noexcept {
  if (open_) counters_.stray_bytes += run_;
  // So many sets at least have left bytes here; before the first start nothing is known.
  const std::uint64_t length = 1 + set_.values.size();
  if (started_) counters_.torn += (run_ + length - 1) / length;
  open_ = false;
  run_ = 0;
}

void encode_set(const TagFormat& format, std::span<const std::uint8_t> values,
                std::vector<std::uint8_t>& out) {
  if (values.size() != format.values()) {
    throw std::invalid_argument("photo tag: expected " + std::to_string(format.values()) +
                                " values, found " + std::to_string(values.size()));
  }
  out.push_back(kSetStart);
  for (const std::uint8_t value : values) {
    const std::uint8_t binary = std::min(value, kLargestValue);
    out.push_back(std::min(format.gray ? to_gray(binary) : binary, kLargestValue));
  }
}

}  // namespace secondskin::wire
