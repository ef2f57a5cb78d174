#pragma once

#include <array>
#include <cstdint>
#include <string>

#include "wire/tactor_protocol.h"

namespace secondskin::sim {

/// What the virtual board does at one instant.
struct BoardSample {
  std::int64_t monotonic_ns = 0;  ///< CLOCK_MONOTONIC: the same for all processes of a machine
  std::array<double, wire::kTactorCount> drive{};      ///< share of full voltage, 0 to 1
  std::array<double, wire::kTactorCount> amplitude{};  ///< the actuators' vibration, 0 to 1
  std::size_t slots_on = 0;  ///< commands in force; 0 tells "off" from the pause between two pulses
};

/// Writes the drives as CSV, a row whenever one changed:
///   monotonic_ns,slots_on,drive_0,...,drive_15
/// Each row is one write(2), so that another process reads it at once and a kill loses none.
/// One thread.
class WaveformRecorder {
 public:
  /// Begins a new file. @throws std::system_error naming the path
  explicit WaveformRecorder(const std::string& path);
  ~WaveformRecorder();
  WaveformRecorder(const WaveformRecorder&) = delete;
  WaveformRecorder& operator=(const WaveformRecorder&) = delete;

  void record(const BoardSample& sample) noexcept;

  /// Rows that could not be written (a full disk).
  std::uint64_t lost_rows() const noexcept { return lost_rows_; }

 private:
  int fd_ = -1;
  bool first_ = true;
  BoardSample last_;
  std::uint64_t lost_rows_ = 0;
};

}  // namespace secondskin::sim
