#pragma once

#include <unistd.h>

#include <chrono>
#include <cstdint>
#include <thread>

#include "bus/participant.h"

namespace secondskin::bus {

/// A domain of this test process's own, on this machine only.
inline Config test_config() {
  Config config;
  config.domain = 10 + static_cast<std::uint32_t>(::getpid()) % 90;
  config.subject = "test_" + std::to_string(::getpid());
  config.qos_file = SECONDSKIN_SOURCE_DIR "/idl/qos.xml";
  return config;
}

/// Waits until `done()` or the time is over; for discovery, whose end nothing else tells a test.
template <class Condition>
bool eventually(Condition done, std::chrono::milliseconds at_most = std::chrono::seconds(10)) {
  const auto end = std::chrono::steady_clock::now() + at_most;
  while (!done()) {
    if (std::chrono::steady_clock::now() > end) return false;
    std::this_thread::sleep_for(std::chrono::milliseconds(2));
  }
  return true;
}

}  // namespace secondskin::bus
