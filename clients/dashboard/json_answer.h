#pragma once

#include <fmt/chrono.h>
#include <fmt/format.h>

#include <cstdint>
#include <ctime>
#include <nlohmann/json.hpp>
#include <string>

#include "clients/dashboard/http.h"

/// What HTTP handlers that speak JSON share.
namespace secondskin::dashboard {

/// A request that cannot be answered: status and why. Handlers throw it at themselves.
struct Refusal {
  unsigned status;
  std::string words;
};

/// A text in it that is no UTF-8 does not end the answer.
inline HttpResponse json_answer(unsigned status, const nlohmann::json& body) {
  return {.status = status,
          .body = body.dump(-1, ' ', false, nlohmann::json::error_handler_t::replace),
          .file_name = {}};
}

inline HttpResponse error_response(unsigned status, const std::string& text) {
  return json_answer(status, {{"error", text}});
}

/// ISO 8601, UTC, with milliseconds. @param ns  since the Unix epoch
inline std::string iso_time(std::int64_t ns) {
  const std::int64_t ms = ns / 1'000'000;
  return fmt::format("{:%FT%T}.{:03}Z", fmt::gmtime(static_cast<std::time_t>(ms / 1000)),
                     ms % 1000);
}

}  // namespace secondskin::dashboard
