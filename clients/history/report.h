#pragma once

#include <cstdint>
#include <span>
#include <string>

#include "clients/history/records.h"

/// What goes into a patient's file.
namespace secondskin::history {

/// A page of A4 that prints as it is: no scripts, nothing from elsewhere, plots inline. It says
/// what each number means and on which reference and tolerances it rests.
/// @param course   whole sessions, the earliest first (History::course)
/// @param made_ns  when the report is made
std::string report_html(const Learner& learner, std::span<const Session> course,
                        std::int64_t made_ns);

}  // namespace secondskin::history
