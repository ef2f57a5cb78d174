#pragma once

#include <cstdint>
#include <memory>

#include "bus/participant.h"
#include "bus/topics.h"

namespace secondskin::bus {

/// What happened at a reader since it was made.
struct ReaderCounts {
  std::uint64_t taken = 0;
  std::uint64_t lost = 0;  ///< the middleware knows that it did not deliver these
  std::uint64_t deadline_missed = 0;
  std::uint32_t writers = 0;        ///< matched now
  std::uint32_t alive_writers = 0;  ///< matched now and asserting their liveliness
  std::uint64_t incompatible = 0;   ///< writers refused for their QoS
};

/// What a reader is for; it chooses the QoS profile.
enum class Want : std::uint8_t {
  kNewest,  ///< the live path
  kEvery,   ///< each message once, e.g. to record
};

/// The part that does not depend on the type; what a WaitSet waits for.
class ReaderBase {
 public:
  virtual ~ReaderBase() = default;
  ReaderCounts counts() const noexcept;

  struct Endpoint;
  Endpoint& endpoint() noexcept { return *endpoint_; }

 protected:
  ReaderBase();
  std::unique_ptr<Endpoint> endpoint_;
};

/// Reads one topic with the QoS of its name. One thread at a time.
template <TopicMessage Message>
class Reader final : public ReaderBase {
 public:
  /// @throws std::runtime_error naming topic and profile.
  explicit Reader(Participant& participant, Want want = Want::kNewest);
  ~Reader() override;

  /// Takes the next message, if there is one. `message` keeps its capacity, so nothing is allocated
  /// once it has held one as large.
  [[nodiscard]] bool take(Message& message) noexcept;

  /// Takes all there are and keeps the newest. @returns how many there were
  std::size_t take_newest(Message& message) noexcept {
    std::size_t n = 0;
    while (take(message)) ++n;
    return n;
  }
};

}  // namespace secondskin::bus
