#pragma once

#include <nlohmann/json.hpp>
#include <span>

#include "clients/authoring/draft.h"
#include "clients/authoring/take.h"
#include "clients/authoring/take_recorder.h"

/// Takes and drafts as the page reads them (docs/references.md). Times in seconds from the take's
/// start, dates ISO 8601 UTC, angles in degrees.
namespace secondskin::authoring {

/// Poses for drawing come at most this often.
inline constexpr double kDrawnRate = 30.0;  ///< [Hz]

nlohmann::json to_json(const RecorderState& state);
nlohmann::json to_json(const TakeInfo& take);

/// {rate_hz, skeleton: [{name, parent, offset, end}], poses: [[x, y, z, then x, y, z, w of each
/// joint], ...]}
nlohmann::json to_json(const Motion& motion);

/// The mean, when each part is where, what is proposed, and the joints of interest as curves.
nlohmann::json to_json(const Draft& draft);

}  // namespace secondskin::authoring
