#pragma once

#include <chrono>
#include <cstdint>
#include <memory>
#include <stop_token>

#include "bus/participant.h"
#include "bus/topics.h"

namespace secondskin::bus {

/// What happened at a writer since it was made.
struct WriterCounts {
  std::uint64_t written = 0;
  std::uint64_t refused = 0;       ///< the middleware did not take the message
  std::uint32_t readers = 0;       ///< matched now
  std::uint64_t incompatible = 0;  ///< readers refused for their QoS
};

/// Writes one topic with the QoS of its name. One thread at a time.
template <TopicMessage Message>
class Writer {
 public:
  /// @throws std::runtime_error naming topic and profile.
  explicit Writer(Participant& participant);
  ~Writer();

  /// Hands the message over; never waits for a reader.
  bool write(const Message& message) noexcept;
  WriterCounts counts() const noexcept;

  /// Sleeps until so many readers are matched. @returns false when time or a stop came first.
  bool wait_for_readers(std::uint32_t at_least, std::chrono::nanoseconds at_most,
                        std::stop_token stop = {});

  /// Sleeps until every reliable reader that is matched has all that was written; for a program
  /// that says one thing and ends. @returns false when the time came first.
  bool wait_until_delivered(std::chrono::nanoseconds at_most);

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace secondskin::bus
