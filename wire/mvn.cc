#include "wire/mvn.h"

#include <bit>
#include <cmath>
#include <limits>
#include <stdexcept>

namespace secondskin::wire {
namespace {

constexpr std::string_view kMagic = "MXTP";
constexpr float kUnitWithin = 0.01F;  // a quaternion's length may be off by so much

template <class Integer>
void put(Datagram& out, Integer value) {
  for (int shift = 8 * (static_cast<int>(sizeof value) - 1); shift >= 0; shift -= 8) {
    out.push_back(static_cast<std::uint8_t>(value >> shift));
  }
}

void put(Datagram& out, float value) { put(out, std::bit_cast<std::uint32_t>(value)); }

// Byte by byte: gcc 12 takes a vector's insert here for an overflow.
void put_characters(Datagram& out, std::string_view text) {
  for (const char c : text) out.push_back(static_cast<std::uint8_t>(c));
}

// Section 2.5.12: a 32-bit length, then UTF-8 without a final zero.
void put(Datagram& out, std::string_view text) {
  put(out, static_cast<std::uint32_t>(text.size()));
  put_characters(out, text);
}

std::uint32_t get(std::span<const std::uint8_t> bytes, std::size_t at, std::size_t size) noexcept {
  std::uint32_t value = 0;
  for (std::size_t i = 0; i < size; ++i) value = value << 8 | bytes[at + i];
  return value;
}

float get_float(std::span<const std::uint8_t> bytes, std::size_t at) noexcept {
  return std::bit_cast<float>(get(bytes, at, 4));
}

Datagram with_header(MvnHeader header, std::string_view type, const Datagram& payload) {
  if (payload.size() > std::numeric_limits<std::uint16_t>::max()) {
    throw std::length_error("MVN datagram: the payload is longer than 65535 bytes");
  }
  Datagram out;
  out.reserve(kMvnHeaderBytes + payload.size());
  put_characters(out, kMagic);
  put_characters(out, type);
  put(out, header.sample);
  put(out, header.datagram);
  put(out, header.items);
  put(out, header.time_ms);
  put(out, header.avatar);
  put(out, header.body_segments);
  put(out, header.props);
  put(out, header.fingers);
  put(out, std::uint16_t{0});
  put(out, static_cast<std::uint16_t>(payload.size()));
  out.insert(out.end(), payload.begin(), payload.end());
  return out;
}

bool is_digit(std::uint8_t c) noexcept { return c >= '0' && c <= '9'; }

}  // namespace

std::string_view words(MvnFault fault) noexcept {
  switch (fault) {
    case MvnFault::kNone:
      return "whole";
    case MvnFault::kForeign:
      return "no MVN datagram (expected \"MXTP\" and a type, 24 bytes at least)";
    case MvnFault::kWrongLength:
      return "not as long as its header says";
    case MvnFault::kBadNumber:
      return "a segment id 0, a number that is not finite or a quaternion not of unit length";
  }
  return "";
}

Datagram encode_mvn_pose(MvnHeader header, std::span<const MvnSegment> segments) {
  Datagram payload;
  payload.reserve(segments.size() * kMvnSegmentBytes);
  for (const MvnSegment& segment : segments) {
    put(payload, segment.id);
    for (const float value : segment.position) put(payload, value);
    for (const float value : segment.orientation) put(payload, value);
  }
  header.items = static_cast<std::uint8_t>(segments.size());
  return with_header(header, kMvnPose, payload);
}

Datagram encode_mvn_meta_data(MvnHeader header, std::string_view name) {
  std::string tags = "name:";
  tags += name;
  tags += '\n';
  Datagram payload;
  put(payload, std::string_view(tags));
  header.items = 1;
  return with_header(header, kMvnMetaData, payload);
}

Datagram encode_mvn_scale(MvnHeader header, std::span<const MvnPlace> segments) {
  Datagram payload;
  put(payload, static_cast<std::uint32_t>(segments.size()));
  for (const MvnPlace& place : segments) {
    put(payload, place.name);
    for (const float value : place.position) put(payload, value);
  }
  put(payload, std::uint32_t{0});  // points
  header.items = static_cast<std::uint8_t>(segments.size());
  return with_header(header, kMvnScale, payload);
}

std::optional<MvnHeader> decode_mvn_header(std::span<const std::uint8_t> datagram,
                                           MvnFault& fault) noexcept {
  fault = MvnFault::kForeign;
  if (datagram.size() < kMvnHeaderBytes) return std::nullopt;
  for (std::size_t i = 0; i < kMagic.size(); ++i) {
    if (datagram[i] != static_cast<std::uint8_t>(kMagic[i])) return std::nullopt;
  }
  if (!is_digit(datagram[4]) || !is_digit(datagram[5])) return std::nullopt;
  MvnHeader header;
  header.type = {static_cast<char>(datagram[4]), static_cast<char>(datagram[5])};
  header.sample = get(datagram, 6, 4);
  header.datagram = datagram[10];
  header.items = datagram[11];
  header.time_ms = get(datagram, 12, 4);
  header.avatar = datagram[16];
  header.body_segments = datagram[17];
  header.props = datagram[18];
  header.fingers = datagram[19];
  header.payload = static_cast<std::uint16_t>(get(datagram, 22, 2));
  // Before MVN 2019 these bytes were reserved, and zero.
  if (header.payload != 0 && header.payload != datagram.size() - kMvnHeaderBytes) {
    fault = MvnFault::kWrongLength;
    return std::nullopt;
  }
  fault = MvnFault::kNone;
  return header;
}

MvnFault decode_mvn_pose(std::span<const std::uint8_t> datagram, const MvnHeader& header,
                         std::vector<MvnSegment>& segments) {
  segments.clear();
  if (datagram.size() != kMvnHeaderBytes + header.items * kMvnSegmentBytes) {
    return MvnFault::kWrongLength;
  }
  for (std::size_t i = 0; i < header.items; ++i) {
    const std::size_t at = kMvnHeaderBytes + i * kMvnSegmentBytes;
    MvnSegment segment;
    segment.id = get(datagram, at, 4);
    bool good = segment.id != 0;
    for (std::size_t k = 0; k < 3; ++k) {
      segment.position[k] = get_float(datagram, at + 4 + 4 * k);
      good = good && std::isfinite(segment.position[k]);
    }
    float square = 0.0F;
    for (std::size_t k = 0; k < 4; ++k) {
      segment.orientation[k] = get_float(datagram, at + 16 + 4 * k);
      square += segment.orientation[k] * segment.orientation[k];
    }
    if (!good || !(std::abs(std::sqrt(square) - 1.0F) <= kUnitWithin)) return MvnFault::kBadNumber;
    segments.push_back(segment);
  }
  return MvnFault::kNone;
}

}  // namespace secondskin::wire
