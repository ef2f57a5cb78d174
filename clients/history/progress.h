#pragma once

#include <map>
#include <span>

#include "clients/history/records.h"

/// What a learner's sessions say about learning: over weeks, without cues, by schedule. Pure.
/// docs/history.md has the equations and what they do not show.
///
/// Only like is compared with like: the same reference (name and fingerprint) at the same tempo and
/// tolerances. Blocks without repetitions, and those that nobody heard begin, do not count.
namespace secondskin::history {

/// A block as one point of a curve.
struct ProgressPoint {
  std::int64_t session = 0;
  std::int64_t start_ns = 0;  ///< of its first repetition
  std::int64_t end_ns = 0;    ///< of its last
  std::uint32_t block = 0;
  std::string name;
  std::string schedule;
  double tempo = 1.0;
  double tolerance_scale = 1.0;
  std::uint64_t fingerprint = 0;  ///< of the reference
  std::optional<double> cued;     ///< share of the repetitions that the schedule let be cued
  std::size_t repetitions = 0;
  double mean_total = 0.0;
  std::optional<double> sd_total;        ///< of the repetitions; empty for one
  std::map<std::string, double> joints;  ///< root mean square of the repetitions' rms [rad]
};

/// A block without cues against an earlier one.
struct Retention {
  enum class Kind : std::uint8_t {
    kAfterCues,  ///< against the last cued block of the same session
    kAcrossDays  ///< the first block of a day against the newest of an earlier day
  };
  Kind kind = Kind::kAfterCues;
  ProgressPoint practice;   ///< the earlier block
  ProgressPoint retention;  ///< the block without cues
  double pause = 0.0;       ///< from the end of the one to the start of the other [s]
  double change() const { return retention.mean_total - practice.mean_total; }
};

/// What was practised with one schedule.
struct ScheduleSummary {
  std::string schedule;
  std::size_t sessions = 0;         ///< with such a block
  double first = 0.0, last = 0.0;   ///< mean total of the first such block, and of the last like it
  std::optional<double> retention;  ///< mean change of the kAfterCues that follow such a block
};

struct Progress {
  std::vector<ProgressPoint> points;  ///< the earliest first
  std::vector<Retention> retention;
  std::vector<ScheduleSummary> schedules;  ///< in order of their first use
};

/// @param course  whole sessions of one learner, the earliest first (History::course)
Progress progress(std::span<const Session> course, const std::string& reference);

/// The references of these sessions that have repetitions, by name, each once.
std::vector<std::string> practised_references(std::span<const Session> course);

}  // namespace secondskin::history
