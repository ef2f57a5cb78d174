#pragma once

#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "bus/latency_histogram.h"
#include "bus/writer.h"

namespace secondskin::bus {

/// Collects what a service did over a second and publishes it on the health topic. One thread.
class HealthReporter {
 public:
  HealthReporter(Participant& participant, std::string_view service);

  /// One sample passed through. @param latency  from its measurement to this service's output [s]
  void sample(double latency) noexcept;
  void lost(std::uint64_t samples) noexcept { message_.lost(message_.lost() + samples); }
  void confidence(double value) noexcept { message_.confidence(value); }

  /// The parts of a device, to be filled before each tick; at most MAX_SENSORS are published.
  std::vector<msg::SensorHealth>& sensors() noexcept { return message_.sensors(); }

  /// What is wrong and what to do; empty when nothing is. A change is published at once.
  void state(msg::ServiceState state, std::string_view words = {});

  /// Publishes if a second has passed. Call it at least that often. @returns when it is next due
  /// [ns]
  std::int64_t tick(std::int64_t now_ns) noexcept;

  std::uint64_t samples() const noexcept { return message_.samples(); }
  std::uint64_t lost() const noexcept { return message_.lost(); }
  /// Latencies of all samples so far.
  const LatencyHistogram& latency() const noexcept { return total_; }

 private:
  void publish(std::int64_t now_ns) noexcept;

  Writer<msg::ServiceHealth> writer_;
  msg::ServiceHealth message_;
  LatencyHistogram this_second_;
  LatencyHistogram total_;
  std::int64_t since_ns_ = 0;
};

}  // namespace secondskin::bus
