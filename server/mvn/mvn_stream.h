#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "motion/retarget.h"
#include "motion/xsens_body.h"
#include "wire/mvn.h"

/// From Xsens MVN's datagrams (wire/mvn.h) to poses of the canonical body. Time is passed in.
namespace secondskin::server {

struct MvnCounts {
  std::uint64_t poses = 0;
  std::uint64_t lost = 0;                  ///< samples missing from the sequence
  std::uint64_t late = 0;                  ///< datagrams of a sample older than the newest
  std::uint64_t incomplete = 0;            ///< samples of which a datagram was missing
  std::uint64_t other_types = 0;           ///< datagrams of types that carry no pose we read
  std::uint64_t other_avatars = 0;         ///< datagrams of others than the first one heard
  std::array<std::uint64_t, 4> garbled{};  ///< by wire::MvnFault

  std::uint64_t all_garbled() const noexcept { return garbled[1] + garbled[2] + garbled[3]; }
};

/// Joins datagrams to samples, follows the first avatar heard, and tells its body from the first
/// whole sample. A sample's time of measurement is its time code set against the arrivals: none
/// comes early, so the earliest of them lie on a line.
class MvnStream {
 public:
  static constexpr double kFirstRate = 60.0;  ///< until the stream tells another [Hz]

  /// @param options  metres_per_unit: told from the legs when empty; up: z when empty
  explicit MvnStream(RetargetOptions options) : options_(options) {}

  /// Takes a datagram. @param arrival_ns  since the Unix epoch
  /// @returns whether it completed a sample, which `pose` then has; frames count the lost, too
  [[nodiscard]] bool add(std::span<const std::uint8_t> datagram, std::int64_t arrival_ns,
                         StampedPose& pose);

  /// Of an average person until the first pose is given; the avatar's from then on.
  const Skeleton& skeleton() const noexcept { return skeleton_; }
  double rate_hz() const noexcept { return rate_hz_; }
  std::optional<std::uint8_t> avatar() const noexcept { return avatar_; }
  const MvnCounts& counts() const noexcept { return counts_; }

  /// Why there may be no poses, and what to do; empty when nothing is known to be wrong.
  std::string trouble() const;

 private:
  struct Sample {
    std::uint32_t number = 0;
    std::uint32_t time_ms = 0;
    std::uint32_t seen = 0;  // bit i: segment i
    std::array<TPoseSegment, kXsensSegmentCount> segments;
  };

  bool place(const wire::MvnHeader& header, std::int64_t arrival_ns);
  void fill(const wire::MvnSegment& segment) noexcept;
  std::int64_t stamp(std::uint32_t time_ms, std::int64_t arrival_ns) noexcept;
  bool begin();
  bool knows_rate(std::int64_t stamp_ns) noexcept;

  RetargetOptions options_;
  Skeleton skeleton_ = canonical_skeleton();
  double rate_hz_ = kFirstRate;
  std::optional<std::uint8_t> avatar_;
  MvnCounts counts_;
  wire::MvnFault last_fault_ = wire::MvnFault::kNone;
  std::array<char, 2> last_other_{};
  std::string bad_body_;

  std::vector<wire::MvnSegment> decoded_;
  Sample sample_;
  bool has_body_ = false, has_rate_ = false, following_ = false;
  double metres_per_unit_ = 1.0;
  std::uint32_t last_number_ = 0;  // of the newest whole sample
  std::uint64_t frame_ = 0;
  std::int64_t last_arrival_ns_ = 0;
  std::int64_t origin_ns_ = 0, last_time_ns_ = -1, last_stamp_ns_ = 0;
  std::int64_t rate_stamp_ns_ = 0;
  std::uint64_t rate_frame_ = 0;
  std::array<TPoseSegment, kJointCount> joints_;
};

}  // namespace secondskin::server
