#pragma once

#include <optional>
#include <vector>

#include "clients/players/expert_track.h"
#include "coach/coach.h"
#include "coach/plan/session_plan.h"

/// Runs the coach over the poses of a recording with settings of choice, and writes what it would
/// have done as a recording of its own.
///
/// Poses, pauses, emergency stops and, without a plan of choice, the blocks and their cueing are
/// the recorded ones. The learner's movement is what it was: a re-run says what another coach would
/// have scored and cued, not what the learner would have done with it. The solver runs in simulated
/// time (coach/correct/simulated_source.h), so the same settings give the same messages; a
/// bit-exact replay of the recorded commands is recorder/coach_replay.h.
namespace secondskin::players {

/// What is empty stays as it was recorded.
struct RerunSettings {
  std::string reference;
  std::optional<double> tolerance_scale;  ///< 0.1 to 10
  std::optional<std::uint32_t> max_cues;  ///< 1 to 22
  std::string body_map;
  std::string plan;  ///< "none": one block without end, always cued
};

/// Finds by name. Each throws std::runtime_error that lists the names when there is none.
struct RerunLibrary {
  FindReference reference;
  std::function<coach::BodyMap(const std::string& name)> body_map;
  std::function<coach::SessionPlan(const std::string& name)> plan;
};

struct RerunResult {
  std::uint64_t frames = 0;
  std::uint64_t cues = 0;  ///< onsets
  std::vector<coach::RepetitionScore> repetitions;
  std::vector<std::string> remarks;
};

/// @throws std::runtime_error naming the setting and what was expected; or the file when it holds
/// no coached session, cannot be read or written.
RerunResult rerun_coach(const std::filesystem::path& recording, const std::filesystem::path& idl,
                        const RerunLibrary& library, const RerunSettings& settings,
                        const std::filesystem::path& to, const Progress& progress = {},
                        std::stop_token stop = {});

}  // namespace secondskin::players
