#pragma once

#include <filesystem>
#include <memory>
#include <stop_token>

#include "bus/participant.h"

/// Writes a subject's sessions into the history as they happen: session_state, repetition, skeleton
/// and references in, rows out.
namespace secondskin::history {

struct HistoryCounts {
  std::uint64_t repetitions = 0;  ///< booked by this service
  std::uint64_t unbooked = 0;     ///< of sessions that it never heard of, or whose learner is gone
  std::uint64_t waiting = 0;      ///< not written when the service ended
};

class HistoryService {
 public:
  /// Does not open the file: a session runs whether or not it can be written.
  HistoryService(bus::Participant& participant, std::filesystem::path database);
  ~HistoryService();

  /// Books until a stop is asked for. What the disk refuses waits in memory and is tried again each
  /// second; health ("history") says why. Never throws for the file.
  HistoryCounts run(std::stop_token stop);

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace secondskin::history
