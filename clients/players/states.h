#pragma once

#include <filesystem>
#include <set>
#include <stop_token>
#include <string>

#include "clients/players/expert_track.h"

/// The few messages of a recording that say what holds from then on (body, references, session,
/// emergency stop, scores), in a small file of their own: they are spread over the recording, whose
/// blocks are full of poses, and whoever opens it needs all of them.
namespace secondskin::players {

/// Copies them as they are, at their times, under the recording's own topics and schemas.
/// @throws std::runtime_error when a file cannot be read or written, or at a stop
void write_states(const std::filesystem::path& recording, const std::filesystem::path& to,
                  const Progress& progress = {}, std::stop_token stop = {});

struct Learners {
  std::set<std::string> ids;  ///< of its sessions; one without a learner has none
  bool sure = true;  ///< false: parts cannot be read and what can says nothing of a session
};

/// Reads a recording, or its states, whole.
/// @throws recording::McapError
Learners learners_in(const std::filesystem::path& file, std::stop_token stop = {});

}  // namespace secondskin::players
