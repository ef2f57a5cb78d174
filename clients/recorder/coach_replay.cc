#include "clients/recorder/coach_replay.h"

#include <fmt/format.h>

#include <map>
#include <optional>
#include <stdexcept>

#include "bus/pose_messages.h"
#include "bus/topics.h"
#include "coach/coach_messages.h"
#include "motion/anatomy.h"
#include "recording/mcap_reader.h"

namespace secondskin::recorder {
namespace {

namespace msg = bus::msg;

// Hands each result over at the frame at which the live solver did, after as many iterations.
class RecordedSchedule final : public coach::CorrectionSource {
 public:
  RecordedSchedule(std::shared_ptr<const coach::Reference> reference, const Skeleton& body,
                   const coach::CorrectionOptions& options)
      : solver_(std::move(reference), body, options) {}

  /// What the live coach was handed at the frame that comes next; null for nothing.
  void expect(const msg::Correction* handed_over) { handed_over_ = handed_over; }

  std::optional<coach::CorrectionResult> take(std::uint64_t) override {
    if (handed_over_ == nullptr || !posed_) return std::nullopt;
    posed_ = false;
    return solver_.solve(problem_, {.iterations = handed_over_->iterations()});
  }
  bool idle() const override { return !posed_; }
  void post(const coach::CorrectionProblem& problem) override {
    problem_ = problem;
    posed_ = true;
  }

 private:
  coach::CorrectionSolver solver_;
  coach::CorrectionProblem problem_;
  bool posed_ = false;
  const msg::Correction* handed_over_ = nullptr;
};

struct Recorded {
  std::map<std::uint32_t, Skeleton> bodies;
  std::map<std::int64_t, std::pair<std::uint32_t, StampedPose>> poses;  // by stamp
  std::map<std::int64_t, msg::Correction> corrections;
  std::map<std::int64_t, msg::TactorCommand> commands;  // the first of each stamp
  std::vector<std::int64_t> consumed;                   // stamps, in the coach's order
  std::vector<msg::SessionState> states;
  std::vector<std::string> remarks;
};

Recorded read(const std::filesystem::path& file) {
  recording::McapReader reader(file);
  std::map<std::uint16_t, std::size_t> topic_of;
  for (const auto& channel : reader.channels()) {
    for (std::size_t t = 0; t < bus::kTopics.size(); ++t) {
      if (channel.topic.ends_with(fmt::format("/{}", bus::kTopics[t].name))) {
        topic_of[channel.id] = t;
      }
    }
  }
  Recorded out;
  std::uint64_t unreadable = 0;
  const auto take = [&](const recording::McapMessage& raw, auto message, auto use) {
    if (bus::decode(raw.data, message)) {
      use(std::move(message));
    } else {
      ++unreadable;
    }
  };
  reader.for_each([&](const recording::McapMessage& raw) {
    const auto topic = topic_of.find(raw.channel);
    if (topic == topic_of.end()) return true;
    switch (topic->second) {
      case bus::kTopicOf<msg::SkeletonDefinition>:
        take(raw, msg::SkeletonDefinition{},
             [&](const auto& m) { out.bodies.emplace(m.skeleton_id(), bus::to_skeleton(m)); });
        break;
      case bus::kTopicOf<msg::SkeletonPose>:
        take(raw, msg::SkeletonPose{}, [&](const auto& m) {
          StampedPose pose;
          if (bus::from_message(m, pose)) {
            out.poses.emplace(pose.stamp_ns, std::pair(m.skeleton_id(), std::move(pose)));
          }
        });
        break;
      case bus::kTopicOf<msg::Alignment>:
        take(raw, msg::Alignment{},
             [&](const auto& m) { out.consumed.push_back(m.header().stamp_ns()); });
        break;
      case bus::kTopicOf<msg::Correction>:
        take(raw, msg::Correction{},
             [&](auto m) { out.corrections.emplace(m.header().stamp_ns(), std::move(m)); });
        break;
      case bus::kTopicOf<msg::TactorCommand>:
        take(raw, msg::TactorCommand{},
             [&](auto m) { out.commands.emplace(m.header().stamp_ns(), std::move(m)); });
        break;
      case bus::kTopicOf<msg::SessionState>:
        take(raw, msg::SessionState{}, [&](auto m) { out.states.push_back(std::move(m)); });
        break;
      default:
        break;
    }
    return true;
  });
  for (const auto& damage : reader.damage()) out.remarks.push_back(damage);
  if (unreadable > 0) out.remarks.push_back(fmt::format("{} messages are unreadable", unreadable));
  if (out.consumed.empty() || out.states.empty() || out.bodies.empty()) {
    throw std::runtime_error(fmt::format(
        "{}: holds no coached session (expected the topics skeleton, session_state, alignment)",
        file.string()));
  }
  return out;
}

struct Session {
  std::shared_ptr<const coach::Reference> reference;
  std::unique_ptr<RecordedSchedule> solver;
  std::unique_ptr<coach::Coach> coach;
};

}  // namespace

ReplayResult replay_coach(
    const std::filesystem::path& file, const ReplayLibrary& library,
    const std::function<void(const coach::Coach&, const coach::CoachOutput&)>& look) {
  Recorded recorded = read(file);
  ReplayResult result;
  result.remarks = std::move(recorded.remarks);
  Session session;
  std::int64_t session_start_ns = 0, block_start_ns = 0;
  std::size_t next_state = 0;
  bool fresh_coach = true;  // its numbers begin again
  std::uint64_t last_number = 0;
  coach::CoachOutput out;

  const auto finish = [&] {
    if (!session.coach) return;
    if (auto score = session.coach->finish()) result.repetitions.push_back(*score);
  };
  const auto obey = [&](const msg::SessionState& state, const Skeleton& body) {
    const bool another_session = state.session_start_ns() != session_start_ns;
    if ((another_session || state.block_start_ns() != block_start_ns) &&
        state.phase() == msg::SESSION_RUNNING) {
      finish();
      session_start_ns = state.session_start_ns();
      block_start_ns = state.block_start_ns();
      if (another_session) ++result.sessions;
      session = {};
      session.reference = library.reference(state.reference().to_string());
      if (coach::fingerprint(*session.reference) != state.reference_fingerprint()) {
        result.remarks.push_back(
            fmt::format("reference '{}' is not the one of the recording: commands will differ",
                        session.reference->name));
      }
      session.reference = coach::at_tempo(session.reference, state.block_tempo());
      session.solver = std::make_unique<RecordedSchedule>(
          session.reference, body,
          coach::CorrectionOptions{.tolerance_scale = state.tolerance_scale(),
                                   .max_joints = state.max_cues()});
      coach::BodyMap map;
      coach::TactileSetup tactile;
      if (!coach::from_message(state, map, tactile)) {
        map = library.body_map(state.body_map().to_string());
      }
      session.coach = std::make_unique<coach::Coach>(
          session.reference, std::move(map),
          coach::CoachSettings{.tolerance_scale = state.tolerance_scale(),
                               .max_cues = state.max_cues()},
          *session.solver, std::move(tactile));
    }
    if (session.coach) {
      session.coach->pause(state.phase() == msg::SESSION_PAUSED);
      session.coach->mute(state.stopped());
      session.coach->feedback(coach::feedback_of(state));
      session.coach->rest(state.resting());
    }
  };

  std::uint64_t missing_poses = 0, missing_commands = 0;
  for (const std::int64_t stamp : recorded.consumed) {
    const auto pose = recorded.poses.find(stamp);
    if (pose == recorded.poses.end()) {
      ++missing_poses;
      continue;
    }
    const auto body = recorded.bodies.find(pose->second.first);
    if (body == recorded.bodies.end()) {
      ++missing_poses;
      continue;
    }
    const auto command = recorded.commands.find(stamp);
    if (command != recorded.commands.end()) {
      fresh_coach = fresh_coach || command->second.command_number() < last_number;
      last_number = command->second.command_number();
    }
    while (next_state < recorded.states.size()) {
      const auto& state = recorded.states[next_state];
      // A coach that has met no pose yet names none: its state is for its first one.
      const bool of_fresh_coach = state.header().stamp_ns() <= 1;
      if (of_fresh_coach ? !fresh_coach : state.header().stamp_ns() > stamp) break;
      if (fresh_coach && last_number > 1) {
        result.remarks.push_back(
            fmt::format("the first {} frames of a session were not recorded: its commands may "
                        "differ",
                        last_number - 1));
      }
      fresh_coach = false;
      obey(state, body->second);
      ++next_state;
    }
    if (!session.coach) continue;
    const auto correction = recorded.corrections.find(stamp);
    const bool handed_over =
        correction != recorded.corrections.end() && correction->second.handed_over();
    session.solver->expect(handed_over ? &correction->second : nullptr);
    session.coach->step(pose->second.second, out);
    session.coach->pose_problem();
    if (look) look(*session.coach, out);
    ++result.frames;
    result.corrections += out.handed_over ? 1 : 0;
    if (out.repetition) result.repetitions.push_back(*out.repetition);

    if (command == recorded.commands.end()) {
      ++missing_commands;
      continue;
    }
    ++result.commands_compared;
    if (command->second.intensities() != out.tactors) ++result.commands_different;
  }
  finish();
  if (missing_poses > 0) {
    result.remarks.push_back(fmt::format(
        "{} frames cannot be replayed: their poses are not in the recording", missing_poses));
  }
  if (missing_commands > 0) {
    result.remarks.push_back(fmt::format(
        "{} commands are not in the recording and were not compared", missing_commands));
  }
  return result;
}

std::vector<coach::GivenCue> recorded_cues(const std::filesystem::path& recording,
                                           const ReplayLibrary& library) {
  coach::CueLog log;
  std::uint32_t repetition = 0;
  const auto result = replay_coach(
      recording, library, [&](const coach::Coach& coach, const coach::CoachOutput& out) {
        const double duration = coach.reference().motion.duration();
        const double share = duration > 0.0 ? out.alignment.reference_time / duration : 0.0;
        log.take(repetition, share, coach.cues(), out.correction, out.error, coach.tolerance());
        if (out.repetition) ++repetition;
      });
  if (result.commands_different > 0) {
    throw std::runtime_error(fmt::format("{}: its replay gives other commands ({} of {})",
                                         recording.string(), result.commands_different,
                                         result.commands_compared));
  }
  return log.cues();
}

}  // namespace secondskin::recorder
