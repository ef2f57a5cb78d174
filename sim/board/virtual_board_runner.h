#pragma once

#include <functional>
#include <mutex>
#include <stop_token>

#include "sim/board/virtual_board.h"
#include "sim/board/waveform_recorder.h"
#include "wire/pseudo_terminal.h"

namespace secondskin::sim {

/// Serves a virtual board on a pseudo-terminal in real time: sleeps until bytes come, and looks
/// every millisecond only while something is on.
class VirtualBoardRunner {
 public:
  using Observer = std::function<void(const BoardSample&)>;

  /// @param terminal  borrowed; nobody else may read it while run() does
  /// @param observer  called on run()'s thread at the start and whenever a drive or the number of
  ///                  slots that are on changed; may be empty; must not throw
  explicit VirtualBoardRunner(wire::PseudoTerminal& terminal, const VirtualBoardConfig& config = {},
                              Observer observer = {});

  /// Until stopped. One thread. @throws std::system_error if it cannot wait for bytes
  void run(std::stop_token stop);

  /// The newest state, from any thread.
  BoardSample sample() const;
  VirtualBoardCounters counters() const;

 private:
  void publish(std::int64_t now_ns);

  wire::PseudoTerminal& terminal_;
  Observer observer_;
  VirtualBoard board_;
  BoardSample published_;
  bool first_ = true;

  mutable std::mutex mutex_;  ///< guards the two below
  BoardSample sample_;
  VirtualBoardCounters counters_;
};

}  // namespace secondskin::sim
