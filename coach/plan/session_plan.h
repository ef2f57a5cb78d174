#pragma once

#include <filesystem>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "coach/plan/feedback_schedule.h"
#include "coach/score/repetition_scorer.h"

/// A session is a row of blocks: how many repetitions, how fast, and when they are cued.
/// docs/learning.md has the file's format.
namespace secondskin::coach {

struct Block {
  std::string name;
  std::size_t repetitions = 0;  ///< 0: without end
  double tempo = 1.0;           ///< of the expert's; below 1: slower
  std::optional<double> tolerance_scale;
  std::optional<std::uint32_t> max_cues;
  double rest = 0.0;  ///< after it [s]: nothing is followed, scored or corrected
  FeedbackSchedule schedule;
};

/// Reads the cues that were given in another session, for a yoked schedule. Throws what the reader
/// of the plan is to say.
using CueReader = std::function<std::vector<GivenCue>(const std::filesystem::path& session)>;

struct SessionPlan {
  std::string name;
  std::string description;
  std::uint64_t seed = 1;
  std::vector<Block> blocks;  ///< at least one

  /// One block without end, always cued: practice without a plan.
  static SessionPlan open();

  /// @param read_cues  of a yoked schedule's session, whose path is taken from the plan's folder
  /// @throws std::runtime_error naming file, line, field and what was expected.
  static SessionPlan load(const std::filesystem::path& file, const CueReader& read_cues);
};

/// A repetition gets at most so many yoked cues; the messages are bounded.
inline constexpr std::size_t kMostYokedCues = 256;

/// The same reference, done at another tempo (0.25 to 2 of the expert's): for slow practice. The
/// reference itself for 1.
std::shared_ptr<const Reference> at_tempo(std::shared_ptr<const Reference> reference, double tempo);

/// Where a session is in its plan. Pure: fed with finished repetitions and with stamps.
class PlanProgress {
 public:
  /// @param weight  of the reference's joints, by which success is judged
  PlanProgress(SessionPlan plan, const std::array<double, kJointCount>& weight);

  const SessionPlan& plan() const noexcept { return plan_; }
  /// The block under way; the last one when the plan has ended.
  const Block& block() const noexcept { return plan_.blocks[block_]; }
  std::size_t block_index() const noexcept { return block_; }
  std::size_t repetitions() const noexcept { return done_.size(); }  ///< done in this block
  bool ended() const noexcept { return ended_; }
  /// Between two blocks. The next block's already counts as the one under way.
  bool resting() const noexcept { return rest_ends_ns_ != 0; }
  /// Of the repetition under way, or the coming one.
  const Feedback& feedback() const noexcept { return feedback_; }

  enum class Step : std::uint8_t { kNone, kBlockBegins, kEnded };
  /// Takes a repetition that ended at this stamp.
  Step repetition(const RepetitionScore& score, std::int64_t stamp_ns);
  /// Lets time pass. @returns whether a rest is over with it
  bool advance(std::int64_t stamp_ns) noexcept;

 private:
  void decide_next();

  SessionPlan plan_;
  std::array<double, kJointCount> weight_;
  std::size_t block_ = 0;
  std::vector<Outcome> done_;  ///< of this block
  std::uint32_t number_ = 0;   ///< repetitions done in the session
  std::int64_t rest_ends_ns_ = 0;
  bool ended_ = false;
  Feedback feedback_;
};

}  // namespace secondskin::coach
