#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "coach/coach.h"
#include "coach/plan/cue_log.h"

/// Runs the coach again over a recording: the poses that it consumed, the orders that it obeyed,
/// and each solver result at the frame at which it was handed over. The tactor commands come out
/// the same bit for bit, or the coach, the reference or the solver is not the one that was
/// recorded.
namespace secondskin::recorder {

struct ReplayResult {
  std::uint64_t sessions = 0;
  std::uint64_t frames = 0;  ///< consumed by the coach and replayed
  std::uint64_t commands_compared = 0;
  std::uint64_t commands_different = 0;
  std::uint64_t corrections = 0;     ///< solver results handed over
  std::vector<std::string> remarks;  ///< what could not be compared, and why
  std::vector<coach::RepetitionScore> repetitions;
};

/// Finds what a recording names.
struct ReplayLibrary {
  std::function<std::shared_ptr<const coach::Reference>(const std::string& name)> reference;
  std::function<coach::BodyMap(const std::string& name)> body_map;
};

/// @param look  if given, called after each frame that was replayed
/// @throws std::runtime_error when the file has no session to replay, or what it names is not
/// there.
ReplayResult replay_coach(
    const std::filesystem::path& recording, const ReplayLibrary& library,
    const std::function<void(const coach::Coach&, const coach::CoachOutput&)>& look = {});

/// The cues that were given in a recording, for a yoked schedule: it is replayed. The repetitions
/// of all its sessions count on.
/// @throws std::runtime_error as above, or when the replay does not give the recorded commands
std::vector<coach::GivenCue> recorded_cues(const std::filesystem::path& recording,
                                           const ReplayLibrary& library);

}  // namespace secondskin::recorder
