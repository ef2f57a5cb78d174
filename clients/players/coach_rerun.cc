#include "clients/players/coach_rerun.h"

#include <fmt/format.h>

#include <algorithm>
#include <deque>
#include <stdexcept>
#include <unordered_set>

#include "bus/pose_messages.h"
#include "clients/players/topic_file.h"
#include "coach/coach_messages.h"
#include "coach/correct/simulated_source.h"
#include "motion/anatomy.h"

namespace secondskin::players {
namespace {

namespace msg = bus::msg;
namespace fs = std::filesystem;

// From a problem to the use of its result: what the live solver typically takes at 60 to 120 Hz.
constexpr std::uint64_t kSolverFrames = 1;

void check(const RerunSettings& settings) {
  const auto& scale = settings.tolerance_scale;
  if (scale && !(*scale >= 0.1 && *scale <= 10.0)) {
    throw std::runtime_error(fmt::format("tolerance_scale {}: expected 0.1 to 10", *scale));
  }
  const auto& cues = settings.max_cues;
  if (cues && (*cues < 1 || *cues > kJointCount)) {
    throw std::runtime_error(fmt::format("max_cues {}: expected 1 to {}", *cues, kJointCount));
  }
}

class Rerun {
 public:
  Rerun(const RerunLibrary& library, const RerunSettings& settings, TopicFile& out)
      : library_(library), settings_(settings), out_(out), ghosts_(library.reference) {
    if (!settings.reference.empty()) chosen_ = reference(settings.reference);
    if (!settings.body_map.empty()) map_ = library.body_map(settings.body_map);
    if (settings.plan == "none")
      plan_ = coach::SessionPlan::open();
    else if (!settings.plan.empty())
      plan_ = library.plan(settings.plan);
  }

  /// What the recorder heard late may have held before: so states are known beforehand, in their
  /// order, and apply from the frame that they name.
  void expect(const msg::SessionState& state, std::int64_t time_ns) {
    waiting_.push_back({state, time_ns});
  }
  /// Likewise the first body.
  void meet(const msg::SkeletonDefinition& body) {
    ghosts_.take(body);
    if (body_ && body_id_ == body.skeleton_id()) return;
    Skeleton skeleton = bus::to_skeleton(body);
    if (!is_canonical(skeleton)) return;
    body_ = std::move(skeleton);
    body_id_ = body.skeleton_id();
  }

  void take(const msg::SkeletonDefinition& body, std::int64_t time_ns) {
    out_.write(time_ns, body);
    meet(body);
  }

  /// @param consumed  whether the recorded coach took it, too
  void take(const msg::SkeletonPose& message, std::int64_t time_ns, bool consumed) {
    out_.write(time_ns, message);
    ghosts_.take(message);
    if (!bus::from_message(message, pose_)) return;
    while (!waiting_.empty()) {
      const auto& [state, heard_ns] = waiting_.front();
      // A coach that has met no pose yet names none: its state is for its first one.
      const bool unnamed = state.header().stamp_ns() <= 1 && session_start_ns_ != 0;
      if (unnamed ? heard_ns > time_ns : state.header().stamp_ns() > pose_.stamp_ns) break;
      obey(state, time_ns);
      waiting_.pop_front();
    }
    if (!consumed || !coach_ || message.skeleton_id() != body_id_ ||
        pose_.pose.q_PB.size() != kJointCount) {
      return;
    }
    ++result.frames;
    coach_->step(pose_, step_);
    coach_->pose_problem();
    publish(time_ns);
    go_on(time_ns);
    publish_state(time_ns);
  }

  void end(std::int64_t time_ns) {
    for (const auto& [state, heard_ns] : waiting_) obey(state, time_ns);
    end_block(time_ns);
    publish_state(time_ns);
  }

  RerunResult result;

 private:
  std::shared_ptr<const coach::Reference> reference(const std::string& name) const {
    auto found = library_.reference(name);
    if (!found) throw std::runtime_error(fmt::format("reference '{}' is not known", name));
    return found;
  }

  void obey(const msg::SessionState& recorded, std::int64_t time_ns) {
    const bool another_session = recorded.session_start_ns() != session_start_ns_;
    const bool another_block = !plan_ && recorded.block_start_ns() != block_start_ns_;
    const bool runs = recorded.phase() == msg::SESSION_RUNNING;
    if ((another_session || another_block) && runs && body_) {
      end_block(time_ns);
      session_start_ns_ = recorded.session_start_ns();
      block_start_ns_ = recorded.block_start_ns();
      if (another_session) begin_session(recorded);
      state_ = recorded;
      begin_block(recorded);
    } else if (recorded.phase() == msg::SESSION_ENDED && coach_) {
      end_block(time_ns);
    }
    const auto counts = counts_;
    state_ = recorded;
    counts_ = counts;
    changed_ = true;
    if (!coach_) return;
    coach_->pause(recorded.phase() == msg::SESSION_PAUSED);
    coach_->mute(recorded.stopped());
    if (progress_) return;
    // The recorded block's cues are for its own repetitions, which another reference may not share.
    if (chosen_ == nullptr) coach_->feedback(coach::feedback_of(recorded));
    coach_->rest(recorded.resting());
  }

  void begin_session(const msg::SessionState& recorded) {
    counts_.session = 0;
    reference_ = chosen_ ? chosen_ : reference(recorded.reference().to_string());
    if (!chosen_ && coach::fingerprint(*reference_) != recorded.reference_fingerprint()) {
      result.remarks.push_back(
          fmt::format("reference '{}' is not the one of the recording", reference_->name));
    }
    if (plan_) progress_.emplace(*plan_, reference_->weight);
    coach::BodyMap map;
    if (!coach::from_message(recorded, map, tactile_)) {
      map = library_.body_map(recorded.body_map().to_string());
    }
    session_map_ = map_ ? *map_ : std::move(map);
  }

  void begin_block(const msg::SessionState& recorded) {
    counts_.block = 0;
    double tempo = recorded.block_tempo() > 0.0 ? recorded.block_tempo() : 1.0;
    scale_ = recorded.tolerance_scale();
    cues_ = recorded.max_cues();
    if (progress_) {
      const coach::Block& block = progress_->block();
      tempo = block.tempo;
      scale_ = block.tolerance_scale.value_or(scale_);
      cues_ = block.max_cues.value_or(cues_);
    }
    scale_ = settings_.tolerance_scale.value_or(scale_);
    cues_ = settings_.max_cues.value_or(cues_);
    const auto at_tempo = coach::at_tempo(reference_, tempo);
    solver_ = std::make_unique<coach::SimulatedSource>(
        at_tempo, *body_, coach::CorrectionOptions{.tolerance_scale = scale_, .max_joints = cues_},
        kSolverFrames);
    coach_ = std::make_unique<coach::Coach>(
        at_tempo, session_map_, coach::CoachSettings{.tolerance_scale = scale_, .max_cues = cues_},
        *solver_, tactile_);
    if (progress_) {
      coach_->feedback(progress_->feedback());
      coach_->rest(progress_->resting());
    }
    changed_ = true;
  }

  void end_block(std::int64_t time_ns) {
    if (!coach_) return;
    if (const auto score = coach_->finish()) publish(*score, time_ns);
    result.cues += coach_->cues_given();
    tactile_.exposure = coach_->exposure();
    coach_.reset();
    solver_.reset();
    step_.tactors = {};
    coach::to_message(pose_, step_.tactors, ++command_number_, command_);
    command_.header().publish_ns(time_ns);
    out_.write(time_ns, command_);
  }

  // As CoachService: what a finished repetition and the time mean for the plan.
  void go_on(std::int64_t time_ns) {
    if (!progress_) return;
    if (step_.repetition) {
      switch (progress_->repetition(*step_.repetition, pose_.stamp_ns)) {
        case coach::PlanProgress::Step::kNone:
          coach_->feedback(progress_->feedback());
          break;
        case coach::PlanProgress::Step::kBlockBegins:
          end_block(time_ns);
          begin_block(state_);
          break;
        case coach::PlanProgress::Step::kEnded:
          end_block(time_ns);
          changed_ = true;
          return;
      }
    }
    if (progress_->advance(pose_.stamp_ns)) {
      coach_->rest(false);
      changed_ = true;
    }
  }

  void publish(std::int64_t time_ns) {
    coach::to_message(pose_, step_.tactors, ++command_number_, command_);
    command_.header().publish_ns(time_ns);
    out_.write(time_ns, command_);
    coach::to_message(pose_, step_.alignment, alignment_);
    alignment_.header().publish_ns(time_ns);
    out_.write(time_ns, alignment_);
    if (const auto* ghost = ghosts_.take(alignment_)) out_.write(time_ns, *ghost, "expert");
    coach::to_message(pose_, step_, coach_->tolerance(), correction_);
    correction_.header().publish_ns(time_ns);
    correction_.solve_time(0.0);  // of this machine now: says nothing of the session
    out_.write(time_ns, correction_);
    if (step_.repetition) publish(*step_.repetition, time_ns);
  }

  void publish(const coach::RepetitionScore& score, std::int64_t time_ns) {
    coach::to_message(pose_, score, repetition_);
    repetition_.header().publish_ns(time_ns);
    out_.write(time_ns, repetition_);
    result.repetitions.push_back(score);
    ++counts_.session;
    ++counts_.block;
    changed_ = true;
  }

  void publish_state(std::int64_t time_ns) {
    if (!changed_ || !reference_) return;
    changed_ = false;
    msg::SessionState state = state_;
    if (progress_) {
      coach::to_message(*progress_, state);
      if (progress_->ended()) state.phase(msg::SESSION_ENDED);
    }
    state.reference(reference_->name.substr(0, 64));
    state.reference_fingerprint(coach::fingerprint(*reference_));
    if (map_) coach::to_message(session_map_, tactile_, state);
    state.tolerance_scale(scale_);
    state.max_cues(cues_);
    state.repetitions(counts_.session);
    state.block_repetitions(counts_.block);
    ghosts_.take(state);
    out_.write(time_ns, state);
  }

  const RerunLibrary& library_;
  const RerunSettings& settings_;
  TopicFile& out_;
  ExpertTrack ghosts_;
  std::shared_ptr<const coach::Reference> chosen_, reference_;
  std::optional<coach::BodyMap> map_;
  std::optional<coach::SessionPlan> plan_;

  std::optional<Skeleton> body_;
  std::uint32_t body_id_ = 0;
  struct Waiting {
    msg::SessionState state;
    std::int64_t heard_ns;
  };
  std::deque<Waiting> waiting_;
  msg::SessionState state_;
  std::int64_t session_start_ns_ = 0, block_start_ns_ = 0;
  std::optional<coach::PlanProgress> progress_;
  coach::BodyMap session_map_;
  coach::TactileSetup tactile_;
  double scale_ = 1.0;
  std::uint32_t cues_ = 2;
  struct Counts {
    std::uint32_t session = 0, block = 0;
  } counts_;
  std::unique_ptr<coach::SimulatedSource> solver_;
  std::unique_ptr<coach::Coach> coach_;  // after the solver that it uses
  std::uint64_t command_number_ = 0;
  bool changed_ = false;

  StampedPose pose_;
  coach::CoachOutput step_;
  msg::TactorCommand command_;
  msg::Alignment alignment_;
  msg::Correction correction_;
  msg::RepetitionScore repetition_;
};

}  // namespace

RerunResult rerun_coach(const fs::path& recording, const fs::path& idl, const RerunLibrary& library,
                        const RerunSettings& settings, const fs::path& to, const Progress& progress,
                        std::stop_token stop) {
  check(settings);
  recording::McapReader reader(recording);
  const auto topics = topics_of(reader);
  // Which poses the coach took: it may have missed some.
  std::unordered_set<std::int64_t> consumed;
  msg::Alignment alignment;
  msg::SessionState state;
  msg::SkeletonDefinition body, first_body;
  std::vector<std::pair<msg::SessionState, std::int64_t>> states;
  const auto total = static_cast<double>(std::max<std::uint64_t>(reader.messages(), 1)) * 2.0;
  std::uint64_t done = 0;
  const auto told = [&] {
    if (++done % 2000 == 0 && progress) progress(static_cast<double>(done) / total);
    return !stop.stop_requested();
  };
  const auto topic_of = [&](const recording::McapMessage& raw) {
    const auto found = topics.find(raw.channel);
    return found == topics.end() ? bus::kTopics.size() : found->second;
  };
  reader.for_each([&](const recording::McapMessage& raw) {
    const auto topic = topic_of(raw);
    if (topic == bus::kTopicOf<msg::Alignment> && bus::decode(raw.data, alignment)) {
      consumed.insert(alignment.header().stamp_ns());
    }
    if (topic == bus::kTopicOf<msg::SessionState> && bus::decode(raw.data, state)) {
      states.emplace_back(state, raw.log_time_ns);
    }
    if (topic == bus::kTopicOf<msg::SkeletonDefinition> && first_body.joints().empty() &&
        !bus::decode(raw.data, first_body)) {
      first_body = {};
    }
    return told();
  });
  if (consumed.empty() || states.empty() || first_body.joints().empty()) {
    throw std::runtime_error(
        fmt::format("{}: holds no coached session (expected the topics skeleton, session_state, "
                    "alignment)",
                    recording.filename().string()));
  }
  TopicFile out(to, idl, subject_of(reader));
  Rerun rerun(library, settings, out);
  rerun.meet(first_body);
  for (const auto& [known, heard_ns] : states) rerun.expect(known, heard_ns);
  states.clear();
  msg::SkeletonPose pose;
  reader.for_each([&](const recording::McapMessage& raw) {
    switch (topic_of(raw)) {
      case bus::kTopicOf<msg::SkeletonDefinition>:
        if (bus::decode(raw.data, body)) rerun.take(body, raw.log_time_ns);
        break;
      case bus::kTopicOf<msg::SkeletonPose>:
        if (bus::decode(raw.data, pose)) {
          rerun.take(pose, raw.log_time_ns, consumed.contains(pose.header().stamp_ns()));
        }
        break;
      case bus::kTopicOf<msg::EmergencyStop>:
      case bus::kTopicOf<msg::ReferenceMotionList>:
        out.write_bytes(topic_of(raw), {}, raw.log_time_ns, raw.data);
        break;
      default:
        break;
    }
    return told();
  });
  if (stop.stop_requested()) throw std::runtime_error("ended before it was done");
  rerun.end(reader.end_ns());
  for (const auto& damage : reader.damage()) rerun.result.remarks.push_back(damage);
  out.write_metadata("rerun", {{"recording", recording.filename().string()}});
  out.close();
  return std::move(rerun.result);
}

}  // namespace secondskin::players
