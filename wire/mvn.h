#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

/// Xsens MVN's real-time network stream: datagrams of a 24-byte header and a payload, big-endian
/// ("MVN real-time network streaming Protocol Specification", MV0305P revision N, 2018; section
/// numbers below are its own). Read: type 02, positions and quaternions of the segments. Written:
/// 02, 12 (name) and 13 (the T-pose).
///
/// Positions are metres here and in what is written. Section 2.5.6 says centimetres, MVN's own
/// manual and streams have metres for type 02, so whoever reads must look.
namespace secondskin::wire {

using Datagram = std::vector<std::uint8_t>;

inline constexpr std::uint16_t kMvnPort = 9763;         ///< section 2.3
inline constexpr std::size_t kMvnHeaderBytes = 24;      ///< section 2.4.1
inline constexpr std::size_t kMvnSegmentBytes = 32;     ///< section 2.5.3
inline constexpr std::size_t kMvnBodySegments = 23;     ///< section 2.4.1.7
inline constexpr std::uint8_t kMvnLastDatagram = 0x80;  ///< of a sample, section 2.4.1.3
inline constexpr std::string_view kMvnPose = "02", kMvnMetaData = "12", kMvnScale = "13";

/// What a datagram says of itself, section 2.4.1.
struct MvnHeader {
  std::array<char, 2> type{'0', '2'};
  std::uint32_t sample = 0;                  ///< counts up by one a sample
  std::uint8_t datagram = kMvnLastDatagram;  ///< its place among the sample's, and the last's flag
  std::uint8_t items = 0;                    ///< segments in this datagram
  std::uint32_t time_ms = 0;                 ///< since the recording began
  std::uint8_t avatar = 0;                   ///< "character ID"
  std::uint8_t body_segments = kMvnBodySegments;  ///< 0: from before MVN 2019
  std::uint8_t props = 0;
  std::uint8_t fingers = 0;
  std::uint16_t payload = 0;  ///< bytes after the header; 0: from before 2019

  std::string_view type_text() const noexcept { return {type.data(), type.size()}; }
};

/// One segment of type 02.
struct MvnSegment {
  std::uint32_t id = 0;                          ///< from 1: section 3.1
  std::array<float, 3> position{};               ///< in the world
  std::array<float, 4> orientation{1, 0, 0, 0};  ///< unit quaternion, w x y z
};

/// A segment's name and where its origin is in the T-pose [m].
struct MvnPlace {
  std::string_view name;
  std::array<float, 3> position{};
};

/// The datagram of a sample's segments; items and payload of the header are filled in.
Datagram encode_mvn_pose(MvnHeader header, std::span<const MvnSegment> segments);
/// Type 12: who the avatar is. @param name  without line ends
Datagram encode_mvn_meta_data(MvnHeader header, std::string_view name);
/// Type 13: segment origins in the T-pose, no points.
Datagram encode_mvn_scale(MvnHeader header, std::span<const MvnPlace> segments);

/// Why a datagram was refused.
enum class MvnFault : std::uint8_t {
  kNone,
  kForeign,      ///< no MVN datagram: shorter than a header, or no "MXTP" and two digits
  kWrongLength,  ///< not as long as its header says
  kBadNumber,    ///< a segment id 0, a number that is not finite, a quaternion not of unit length
};
std::string_view words(MvnFault fault) noexcept;

/// The header of any MVN datagram. @param fault  out: why there is none
[[nodiscard]] std::optional<MvnHeader> decode_mvn_header(std::span<const std::uint8_t> datagram,
                                                         MvnFault& fault) noexcept;

/// The segments of a datagram of type 02 with this header; props and fingers come with them.
/// @param segments  out; no allocation once it has held as many
[[nodiscard]] MvnFault decode_mvn_pose(std::span<const std::uint8_t> datagram,
                                       const MvnHeader& header, std::vector<MvnSegment>& segments);

}  // namespace secondskin::wire
