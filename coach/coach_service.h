#pragma once

#include <filesystem>
#include <functional>
#include <memory>
#include <stop_token>
#include <string>
#include <vector>

#include "bus/participant.h"
#include "coach/coach.h"
#include "coach/plan/session_plan.h"

/// The coach as a service: poses and session commands in; alignment, correction, tactor commands,
/// scores and the session's state out. A thin shell: all thinking is in Coach.
namespace secondskin::coach {

struct CoachServiceOptions {
  std::vector<std::shared_ptr<const Reference>> references;  ///< to choose from; the first at start
  BodyMap body_map;
  CoachSettings settings;
  TactileSetup tactile;
  SolveLimit solve_limit;
  SessionPlan plan = SessionPlan::open();  ///< each session follows it from its beginning
  bool start = true;                       ///< begin a session at once; else wait for a command
  std::string learner;                     ///< whose the sessions are, a pseudonym; may be empty

  /// Loads what a command names: a plan, and a reference that is not among `references` yet, e.g.
  /// one recorded since. Both throw std::runtime_error, which the service's health then tells.
  /// Empty: only what is here can be chosen.
  std::function<SessionPlan(const std::string& name)> find_plan;
  std::function<std::shared_ptr<const Reference>(const std::string& name)> find_reference;
};

/// What a frame gave, for whoever looks on in the same process.
struct CoachFrame {
  const StampedPose& pose;
  const CoachOutput& output;
  std::span<const Cue> cues;
  const Reference& reference;  ///< at the block's tempo
};

/// A block of the plan that was begun.
struct BlockSummary {
  std::string name;
  double tempo = 1.0;
  std::size_t first = 0;  ///< of its repetitions among the summary's
  std::size_t repetitions = 0;
  std::uint64_t cues = 0;  ///< onsets
};

/// The mean total of a block's repetitions; empty if there is none.
std::optional<double> mean_total(const BlockSummary& block,
                                 std::span<const RepetitionScore> repetitions) noexcept;

struct CoachSummary {
  std::vector<RepetitionScore> repetitions;
  std::vector<BlockSummary> blocks;
  std::uint64_t frames = 0;
  std::uint64_t lost = 0;     ///< poses that never reached the coach, by their frame numbers
  std::uint64_t refused = 0;  ///< poses that were not valid or of another body
  std::uint64_t cues = 0;     ///< onsets
  std::array<std::uint64_t, kJointCount> cues_by_joint{};
  std::uint64_t corrections = 0;  ///< solver results used
  std::uint64_t fallbacks = 0;
  double solver_cpu = 0.0;  ///< [s]
  ExposureState exposure;   ///< what the learner's skin has borne at the end
};

class CoachService {
 public:
  CoachService(bus::Participant& participant, CoachServiceOptions options);
  ~CoachService();

  /// Called on the service's thread after each frame's messages went out. Set it before run().
  void on_frame(std::function<void(const CoachFrame&)> look);

  /// Called on the service's thread when a plan has come to its end, and with it the session. Set
  /// it before run().
  void on_end(std::function<void()> ended);

  /// Coaches until a stop is asked for; then scores the repetition under way and switches all off.
  CoachSummary run(std::stop_token stop);

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace secondskin::coach
