#pragma once

#include <nlohmann/json_fwd.hpp>
#include <span>
#include <string>

#include "clients/history/progress.h"
#include "clients/history/records.h"

/// The history as people and other programs read it: JSON and CSV, with angles in degrees and
/// times in ISO 8601 UTC. docs/history.md lists the fields.
namespace secondskin::history {

/// "2026-03-04T05:06:07.089Z"
std::string iso_time(std::int64_t ns);

/// A fingerprint as 16 hexadecimal digits.
std::string hex(std::uint64_t fingerprint);

nlohmann::json to_json(const Learner& learner);
/// @param whole  with blocks, repetitions, joints and exposure
nlohmann::json to_json(const Session& session, bool whole);
nlohmann::json to_json(const Progress& progress, const std::string& reference);

/// All that is kept of a learner.
nlohmann::json export_json(const Learner& learner, std::span<const Session> course);

/// The same as a table: one row for each repetition and joint. Exposure and notes are not in it.
std::string export_csv(std::span<const Session> course);

}  // namespace secondskin::history
