#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <string_view>
#include <tl/expected.hpp>

#include "bus/messages.h"

/// What clients may publish, read from JSON or CDR. Pure. publish_ns is left to whoever publishes.
namespace secondskin::dashboard {

/// JSON: {"action": "start"|"pause"|"resume"|"stop", "reference", "tolerance_scale", "max_cues",
/// "plan", "learner"}; what is left out is kept as it is.
/// @param encoding  "json" or "cdr"
/// @returns the message, or a sentence that names the field and what was expected.
tl::expected<bus::msg::SessionCommand, std::string> session_command(
    std::string_view encoding, std::span<const std::uint8_t> payload);

/// JSON: {"active": true|false, "reason"}. As session_command().
tl::expected<bus::msg::EmergencyStop, std::string> emergency_stop(
    std::string_view encoding, std::span<const std::uint8_t> payload);

}  // namespace secondskin::dashboard
