#pragma once

#include <cstdint>
#include <memory>
#include <stop_token>
#include <string>

#include "bus/participant.h"
#include "clients/stream/pose_encoder.h"
#include "wire/udp.h"

/// Sends a subject's poses to another program over UDP. It never waits for anybody: of the poses
/// that came while one was written only the newest is sent, and a receiver that is away costs
/// nothing.
namespace secondskin::stream {

struct StreamCounts {
  std::uint64_t poses = 0;      ///< sent
  std::uint64_t skipped = 0;    ///< a newer one was there already
  std::uint64_t datagrams = 0;  ///< handed to the system
  std::uint64_t refused = 0;    ///< not taken, or answered that nobody listens
};

class StreamService {
 public:
  /// @param name  of the service in its health, e.g. "vmc"
  /// @throws std::system_error naming the place
  StreamService(bus::Participant& participant, std::string name,
                std::unique_ptr<PoseEncoder> encoder, const wire::UdpPlace& to);
  ~StreamService();

  /// Sends until a stop is asked for.
  StreamCounts run(std::stop_token stop);

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace secondskin::stream
