#pragma once

#include <cstdint>
#include <vector>

#include "motion/skeleton.h"
#include "wire/osc.h"

namespace secondskin::stream {

/// Writes poses in another program's language. Belongs to the stream service; one thread.
class PoseEncoder {
 public:
  virtual ~PoseEncoder() = default;

  /// The body of the poses to come. @param body  canonical
  virtual void set_body(const Skeleton& body) = 0;

  /// The datagrams of a pose of that body, none longer than kMostBytes.
  virtual std::vector<wire::Datagram> encode(const StampedPose& pose) = 0;

  /// What fits into one Ethernet frame: 1500 bytes less the headers of IPv4 and UDP.
  static constexpr std::size_t kMostBytes = 1472;
};

}  // namespace secondskin::stream
