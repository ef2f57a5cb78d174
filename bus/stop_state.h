#pragma once

#include "bus/reader.h"
#include "bus/writer.h"

namespace secondskin::bus {

/// The emergency stop as a listener holds it. A stop is obeyed whoever says it and whatever their
/// clock; a lift only when it is newer than the stop. The listener repeats what it obeys for
/// whoever comes later, so that a stop outlives the program that asked for it and the restart of
/// any one listener.
class StopState {
 public:
  explicit StopState(Participant& participant)
      : reader_(participant, Want::kEvery), writer_(participant) {}

  /// Takes what has arrived. @returns whether active() changed.
  bool poll() noexcept {
    const bool before = newest_.active();
    while (reader_.take(message_)) {
      const bool newer = message_.publish_ns() > newest_.publish_ns();
      if (!message_.active() || newest_.active()) {
        // Only ever newer words: so listeners that repeat each other agree and fall silent.
        if (!newer) continue;
      } else {
        if (message_.publish_ns() == last_stop_ns_) continue;  // the one that was lifted, late
        if (!newer) message_.publish_ns(now_ns());  // of a clock that is behind, or of none
      }
      if (message_.active()) last_stop_ns_ = message_.publish_ns();
      newest_ = message_;
      writer_.write(newest_);
    }
    return newest_.active() != before;
  }

  bool active() const noexcept { return newest_.active(); }
  std::string reason() const { return newest_.reason().to_string(); }
  ReaderBase& reader() noexcept { return reader_; }

 private:
  Reader<msg::EmergencyStop> reader_;
  Writer<msg::EmergencyStop> writer_;
  msg::EmergencyStop message_;
  msg::EmergencyStop newest_;
  std::int64_t last_stop_ns_ = -1;  // none yet
};

}  // namespace secondskin::bus
