#pragma once

#include "clients/dashboard/http.h"
#include "clients/players/coach_rerun.h"

/// /api/recordings: the list, the files with ranges, the ghost of each, and re-runs of the coach
/// (docs/players.md).
namespace secondskin::players {

struct RecordingsApi {
  std::filesystem::path folder;  ///< what is computed goes to .players in it
  std::filesystem::path idl;
  RerunLibrary library;  ///< by name only: who asks over the network must not make us read any file
};

dashboard::HttpHandler recordings_api(RecordingsApi api);

}  // namespace secondskin::players
