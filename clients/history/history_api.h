#pragma once

#include <filesystem>

#include "clients/dashboard/http.h"

/// The history over HTTP: /api/history/... docs/history.md lists the requests.
namespace secondskin::history {

/// Has a connection of its own, opened with the first request; so it may be made before there is a
/// file, and a service may write the same file meanwhile. One call at a time.
/// @param profiles  the folder of learners' profiles, which go with them
dashboard::HttpHandler history_api(std::filesystem::path database, std::filesystem::path profiles);

}  // namespace secondskin::history
