#pragma once

#include <cstdint>
#include <memory>
#include <stop_token>
#include <string>

#include "bus/latency_histogram.h"
#include "bus/participant.h"
#include "clients/tactor_driver/driver_core.h"

/// The tactor driver as a service: commands and stops in, bytes to the board out. A thin shell
/// round DriverCore; the guardian process stands beside it.
namespace secondskin::tactor_driver {

struct TactorOptions {
  std::string port;  ///< a serial device or a pseudo-terminal
  unsigned baud_rate = 115'200;
};

struct TactorSummary {
  DriverCounters counters;
  bus::LatencyHistogram latency;  ///< from a sample's measurement to its bytes at the port
  std::string port_trouble;       ///< why the port was not open at the end; empty when it was
};

class TactorService {
 public:
  /// Starts the guardian; the program's main must hand kGuardianCommand to guardian_main().
  TactorService(bus::Participant& participant, const TactorOptions& options);
  ~TactorService();

  /// Drives the board until a stop is asked for, then switches everything off. A port that is not
  /// there, or goes, is waited for.
  TactorSummary run(std::stop_token stop);

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace secondskin::tactor_driver
