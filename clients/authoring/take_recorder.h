#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <stop_token>
#include <string>
#include <vector>

#include "bus/participant.h"
#include "motion/motion.h"

/// Records performances of whoever is measured: countdown, recording, finished. A session of the
/// subject is paused meanwhile, so that nothing vibrates on the expert.
///
/// Threads: run()'s listens and finishes takes; all else may be called from any other.
namespace secondskin::authoring {

/// A performance as it was recorded.
struct Recorded {
  Motion motion;  ///< canonical, at the source's nominal rate, times by the poses' stamps
  std::string source;
  std::int64_t start_ns = 0;        ///< since the Unix epoch
  std::vector<std::string> faults;  ///< lost frames, gaps, a source that vanished, for people
};

enum class RecorderPhase : std::uint8_t { kIdle, kCountdown, kRecording };

struct RecorderState {
  RecorderPhase phase = RecorderPhase::kIdle;
  double remaining = 0.0;  ///< of the countdown [s]
  double elapsed = 0.0;    ///< of the recording [s]
  double most = 0.0;       ///< the recording ends by itself then [s]
  bool alive = false;      ///< poses come
  std::string source;      ///< what the capture server says it is; empty: none was met
  double rate_hz = 0.0;
  std::uint64_t lost = 0;      ///< frames of this recording that never came or were not valid
  bool paused = false;         ///< a session is paused, or was by us
  std::string trouble;         ///< why the last recording came to nothing; empty if it did not
  std::uint64_t recorded = 0;  ///< takes so far
};

inline constexpr double kLongestCountdown = 60.0;   ///< [s]
inline constexpr double kLongestRecording = 180.0;  ///< [s]

class TakeRecorder {
 public:
  /// @param keep  called on run()'s thread with each finished take; what it throws is the trouble
  TakeRecorder(bus::Participant& participant, std::function<void(Recorded)> keep);
  ~TakeRecorder();

  /// Begins the countdown. @throws std::invalid_argument naming the field that is out of range,
  /// std::runtime_error when there is nothing to record or a recording is under way.
  void record(double countdown, double most_seconds);

  /// Ends the recording, which is kept, or the countdown. Otherwise nothing.
  void stop();

  RecorderState state() const;

  void run(std::stop_token stop);

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace secondskin::authoring
