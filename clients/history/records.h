#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

/// What the history keeps: a learner's sessions, their blocks, and each repetition. SI units; times
/// are nanoseconds since the Unix epoch.
namespace secondskin::history {

/// Whom a session is booked to when nobody said.
inline constexpr const char* kUnassigned = "unassigned";
/// The schedule of a block without cues: what was learnt shows there.
inline constexpr const char* kNoCues = "off";

struct Learner {
  std::string id;  ///< a pseudonym, e.g. "L-7K3M9Q"
  std::string note;
  std::int64_t created_ns = 0;
  std::size_t sessions = 0;
  std::optional<std::int64_t> last_session_ns;
};

/// As the coach scores it (docs/scoring.md). Without meaning where not measured.
struct JointFigures {
  std::string joint;
  bool measured = false;
  double rms = 0.0;                    ///< of the angular error [rad]
  double peak = 0.0;                   ///< [rad]
  double in_band = 0.0;                ///< share of the time inside the tolerance, 0 to 1
  std::optional<double> timing_error;  ///< [s], positive: late
  std::optional<double> smoothness;    ///< spectral arc length, below 0
  double range = 0.0;                  ///< of motion [rad]
  double reference_range = 0.0;        ///< the expert's own [rad]
};

struct Repetition {
  std::uint32_t number = 0;   ///< in its block, from 1
  std::int64_t stamp_ns = 0;  ///< of the frame that ended it; tells repetitions apart
  std::int64_t start_ns = 0;
  std::int64_t end_ns = 0;
  double total = 0.0;        ///< 0 to 100, higher is better
  std::uint32_t cues = 0;    ///< that were given
  std::optional<bool> cued;  ///< whether the schedule let it be cued; empty: was not heard
  std::vector<JointFigures> joints;
};

struct Block {
  std::uint32_t index = 0;  ///< in the plan, from 0
  std::string name;
  std::int64_t start_ns = 0;          ///< repetitions that end from here on are its own
  std::optional<double> tempo = 1.0;  ///< of the expert's; empty: nobody heard the block begin
  std::string schedule;               ///< "always", "fading", "off", ...; empty as tempo
  std::uint32_t planned = 0;          ///< repetitions; 0: without end
  double tolerance_scale = 1.0;       ///< times the reference's tolerances
  std::uint32_t max_cues = 0;         ///< joints cued at once
  std::vector<Repetition> repetitions;
};

/// What the skin under one tactor had borne that day (docs/tactile.md).
struct SiteExposure {
  std::uint32_t channel = 0;
  std::string segment;
  double dose_before = 0.0;  ///< when the session began: integral of the squared level [s]
  double dose = 0.0;         ///< when it was last known [s]
  double duty = 0.0;         ///< share of the last minute that it was on, 0 to 1
  double heat = 0.0;         ///< of a voice coil above the skin's own temperature [K]
};

/// An expert motion as it was when the session used it.
struct ReferenceFacts {
  std::string name;
  std::uint64_t fingerprint = 0;  ///< of poses, weights and tolerances: another one, another task
  std::string description;
  double duration = 0.0;  ///< [s]; 0: unknown
};

struct Session {
  std::int64_t id = 0;
  std::string learner;
  std::string subject;  ///< of the topics' names
  std::int64_t start_ns = 0;
  std::optional<std::int64_t> end_ns;  ///< empty: under way, or it never said that it ended
  ReferenceFacts reference;
  std::string plan;    ///< empty: practice without a plan
  std::string source;  ///< what yielded the poses
  std::string body_map;
  std::size_t repetitions = 0;
  std::optional<double> mean_total;  ///< of its repetitions
  std::uint64_t cues = 0;
  std::vector<Block> blocks;           ///< filled by History::session and History::course only
  std::vector<SiteExposure> exposure;  ///< as blocks
};

}  // namespace secondskin::history
