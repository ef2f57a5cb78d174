#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "bus/reader.h"

/// Messages as bytes, for whoever only passes them on (recorder, player, bridge).
namespace secondskin::bus {

/// A message as it travelled.
struct RawMessage {
  std::vector<std::uint8_t> bytes;  ///< encapsulation header and CDR
  std::int64_t source_ns = 0;       ///< when its writer wrote it
};

/// Reads a topic without knowing its type; asks for every message. One thread at a time.
class RawReader final : public ReaderBase {
 public:
  /// @param topic  a place in kTopics. @throws std::runtime_error naming the topic.
  RawReader(Participant& participant, std::size_t topic);
  ~RawReader() override;

  [[nodiscard]] bool take(RawMessage& message) noexcept;
};

/// Writes messages that were recorded or encoded before. One thread at a time.
class RawWriter {
 public:
  /// @param topic  a place in kTopics. @throws std::runtime_error naming the topic.
  RawWriter(Participant& participant, std::size_t topic);
  ~RawWriter();

  /// @param message  encapsulation header and CDR. @returns whether the middleware took it.
  bool write(const RawMessage& message) noexcept;

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace secondskin::bus
