#pragma once

#include <array>
#include <cstdint>
#include <deque>
#include <memory>
#include <optional>
#include <vector>

#include "clients/dashboard/foxglove.h"

/// What waits for one client. Pure.
namespace secondskin::dashboard {

using Bytes = std::shared_ptr<const std::vector<std::uint8_t>>;

/// A WebSocket message: a head of its own before bytes that all clients share.
struct Frame {
  Bytes body;
  std::optional<std::array<std::uint8_t, foxglove::kMessageHeadSize>> head;
  bool text = false;
  /// Of frames of one stream only the newest waits; empty: all of them wait, in their order.
  std::optional<std::uint32_t> stream;

  std::size_t size() const noexcept { return body->size() + (head ? head->size() : 0); }
};

/// Frames that wait until a client has taken those before. A slow client sees fewer of a stream and
/// every one of the rest.
class Outbox {
 public:
  /// @param most_bytes  of the frames that are of no stream
  explicit Outbox(std::size_t most_bytes) : most_bytes_(most_bytes) {}

  /// @returns false when it would hold too much: the client is too slow to be served.
  [[nodiscard]] bool push(Frame frame);

  /// Those of no stream first; streams in turn.
  std::optional<Frame> pop();

  /// Forgets what waits of a stream.
  void forget(std::uint32_t stream);

  std::uint64_t skipped() const noexcept { return skipped_; }  ///< a newer one took their place

 private:
  std::size_t most_bytes_;
  std::size_t bytes_ = 0;
  std::deque<Frame> in_order_;
  std::deque<Frame> newest_;
  std::uint64_t skipped_ = 0;
};

}  // namespace secondskin::dashboard
