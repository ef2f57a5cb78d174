#pragma once

#include <chrono>
#include <memory>

#include "bus/reader.h"

namespace secondskin::bus {

/// Sleeps until one of its readers has news: data, a writer that came, went or lost its liveliness.
class WaitSet {
 public:
  WaitSet();
  ~WaitSet();

  /// The reader must outlive the wait set.
  void attach(ReaderBase& reader);

  /// @returns false when the time passed without news.
  bool wait(std::chrono::nanoseconds at_most) noexcept;

  /// Ends a wait at once, from any thread.
  void wake() noexcept;

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace secondskin::bus
