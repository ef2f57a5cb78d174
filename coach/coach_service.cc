#include "coach/coach_service.h"

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <optional>
#include <stdexcept>

#include "bus/health.h"
#include "bus/pose_messages.h"
#include "bus/sole_writer.h"
#include "bus/stop_state.h"
#include "bus/wait_set.h"
#include "coach/coach_messages.h"

namespace secondskin::coach {

namespace msg = bus::msg;

namespace {

// In a command: a session without a plan.
constexpr const char* kNoPlan = "none";

std::string not_known(const char* kind, const std::string& name) {
  return fmt::format("{} '{}' is not known here", kind, name);
}

}  // namespace

struct CoachService::State {
  State(bus::Participant& participant, CoachServiceOptions options_)
      : options(std::move(options_)),
        skeletons(participant),
        poses(participant),
        commands(participant),
        stop(participant),
        alignments(participant),
        corrections(participant),
        tactors(participant),
        sole(participant, "coach"),
        repetitions(participant),
        states(participant),
        references(participant),
        health(participant, "coach") {
    settings = options.settings;
    for (bus::ReaderBase* reader :
         {static_cast<bus::ReaderBase*>(&skeletons), static_cast<bus::ReaderBase*>(&poses),
          static_cast<bus::ReaderBase*>(&commands), &stop.reader()}) {
      news.attach(*reader);
    }
  }

  // ---- what happens

  void publish_references() {
    msg::ReferenceMotionList list;
    for (const auto& reference : options.references) {
      if (list.references().size() == msg::MAX_REFERENCES) break;  // can still be named
      msg::ReferenceMotion entry;
      entry.name(reference->name.substr(0, 64));
      entry.description(reference->description.substr(0, 512));
      entry.duration(reference->motion.duration());
      entry.rate_hz(reference->motion.rate_hz);
      list.references().push_back(entry);
    }
    list.publish_ns(bus::now_ns());
    references.write(list);
  }

  // A new session: everything that remembers starts afresh.
  void start_session() {
    end_block();
    if (!body) return;  // starts when it is known who learns
    const auto& chosen = options.references.at(reference_index);
    progress.emplace(options.plan, chosen->weight);
    ++session_number;
    session_start_ns = bus::now_ns();
    repetition_count = 0;
    phase = msg::SESSION_RUNNING;
    spdlog::info("session {}: reference '{}'", session_number, chosen->name);
    start_block();
  }

  // A block begins with a coach of its own: its reference has another tempo.
  void start_block() {
    const Block& block = progress->block();
    const auto reference = at_tempo(options.references.at(reference_index), block.tempo);
    settings = options.settings;
    settings.tolerance_scale = block.tolerance_scale.value_or(settings.tolerance_scale);
    settings.max_cues = block.max_cues.value_or(settings.max_cues);
    coach.reset();
    solver = std::make_unique<SolverThread>(
        reference, *body,
        CorrectionOptions{.tolerance_scale = settings.tolerance_scale,
                          .max_joints = settings.max_cues},
        options.solve_limit);
    coach =
        std::make_unique<Coach>(reference, options.body_map, settings, *solver, options.tactile);
    coach->mute(stop.active());
    coach->pause(phase == msg::SESSION_PAUSED);
    coach->feedback(progress->feedback());
    coach->rest(progress->resting());
    block_start_ns = bus::now_ns();
    summary.blocks.push_back({block.name, block.tempo, summary.repetitions.size(), 0, 0});
    state_changed = true;
    if (!progress->plan().name.empty()) {
      spdlog::info("block {} of {}: {}{}", progress->block_index() + 1,
                   progress->plan().blocks.size(), block.name,
                   progress->resting() ? ", after a rest" : "");
    }
  }

  void end_block() {
    if (!coach) return;
    if (auto score = coach->finish()) publish_repetition(*score);
    count_solver();
    options.tactile.exposure = coach->exposure();  // the skin does not begin afresh
    coach.reset();
    solver.reset();
    all_off();
  }

  // What a finished repetition and the time mean for the plan. Holds from the next frame on.
  void go_on() {
    if (out.repetition) {
      switch (progress->repetition(*out.repetition, pose.stamp_ns)) {
        case PlanProgress::Step::kNone:
          coach->feedback(progress->feedback());
          break;
        case PlanProgress::Step::kBlockBegins:
          end_block();
          start_block();
          break;
        case PlanProgress::Step::kEnded:
          wanted = false;
          end_block();
          phase = msg::SESSION_ENDED;
          state_changed = true;
          if (ended) ended();
          return;
      }
    }
    if (progress->advance(pose.stamp_ns)) {
      coach->rest(false);
      state_changed = true;
    }
  }

  void count_solver() {
    if (coach) {
      summary.cues += coach->cues_given();
      summary.blocks.back().cues = coach->cues_given();
      for (std::size_t j = 0; j < kJointCount; ++j) {
        summary.cues_by_joint[j] += coach->cues_by_joint()[j];
      }
    }
    if (solver) summary.solver_cpu += solver->cpu_time();
  }

  void all_off() {
    to_message(pose, wire::BoardState{}, ++command_number, command);
    command.header().publish_ns(bus::now_ns());
    tactors.write(command);
  }

  void publish_repetition(const RepetitionScore& score) {
    to_message(pose, score, repetition);
    repetition.header().publish_ns(bus::now_ns());
    repetitions.write(repetition);
    summary.repetitions.push_back(score);
    ++summary.blocks.back().repetitions;
    ++repetition_count;
    state_changed = true;
  }

  // What the next session is of; empty keeps. Changes nothing when it throws.
  void choose(const std::string& reference, const std::string& plan) {
    std::optional<SessionPlan> next_plan;
    if (plan == kNoPlan) {
      next_plan = SessionPlan::open();
    } else if (!plan.empty() && plan != options.plan.name) {
      if (!options.find_plan) throw std::runtime_error(not_known("plan", plan));
      next_plan = options.find_plan(plan);
    }
    if (!reference.empty()) {
      auto& known = options.references;
      auto found = std::find_if(known.begin(), known.end(),
                                [&](const auto& r) { return r->name == reference; });
      if (found == known.end()) {
        if (!options.find_reference) throw std::runtime_error(not_known("reference", reference));
        found = known.insert(known.end(), options.find_reference(reference));
        publish_references();
      }
      reference_index = static_cast<std::size_t>(found - known.begin());
    }
    if (next_plan) options.plan = std::move(*next_plan);
  }

  void obey(const msg::SessionCommand& order) {
    switch (order.action()) {
      case msg::SESSION_START: {
        try {
          choose(order.reference().to_string(), order.plan().to_string());
        } catch (const std::exception& error) {
          complaint = fmt::format("session start: {}", error.what());
          return;
        }
        if (order.learner().size() > 0) options.learner = order.learner().to_string();
        if (order.tolerance_scale() > 0.0) {
          options.settings.tolerance_scale = std::clamp(order.tolerance_scale(), 0.1, 10.0);
        }
        if (order.max_cues() > 0) options.settings.max_cues = order.max_cues();
        wanted = true;
        complaint.clear();
        start_session();
        return;
      }
      case msg::SESSION_PAUSE:
      case msg::SESSION_RESUME: {
        if (!coach) return;
        const bool pause = order.action() == msg::SESSION_PAUSE;
        coach->pause(pause);
        phase = pause ? msg::SESSION_PAUSED : msg::SESSION_RUNNING;
        state_changed = true;
        return;
      }
      case msg::SESSION_STOP:
        wanted = false;
        end_block();
        phase = msg::SESSION_ENDED;
        state_changed = true;
        return;
    }
  }

  void take_orders() {
    msg::SkeletonDefinition definition;
    if (skeletons.take_newest(definition) > 0) meet(definition);
    if (stop.poll()) {
      if (coach) coach->mute(stop.active());
      if (stop.active()) all_off();
      state_changed = true;
      spdlog::warn("emergency stop {}: {}", stop.active() ? "in force" : "lifted", stop.reason());
    }
    msg::SessionCommand order;
    while (commands.take(order)) obey(order);
  }

  void meet(const msg::SkeletonDefinition& definition) {
    try {
      Skeleton skeleton = bus::to_skeleton(definition);
      if (!is_canonical(skeleton)) {
        throw std::runtime_error("topic skeleton: expected the canonical joints in their order");
      }
      if (body && body_id == definition.skeleton_id()) return;
      body = std::move(skeleton);
      body_id = definition.skeleton_id();
      complaint.clear();
      if (wanted) start_session();
    } catch (const std::exception& error) {
      complaint = error.what();
    }
  }

  void publish_state() {
    if (!state_changed) return;
    state_changed = false;
    msg::SessionState message;
    // It holds from the next frame on.
    message.header().frame(pose.frame + 1);
    message.header().stamp_ns(pose.stamp_ns + 1);
    message.session_start_ns(session_start_ns);
    message.phase(phase);
    message.stopped(stop.active());
    const auto& chosen = *options.references.at(reference_index);
    message.reference(chosen.name.substr(0, 64));
    message.reference_fingerprint(fingerprint(chosen));
    to_message(options.body_map, options.tactile, message);
    message.tolerance_scale(settings.tolerance_scale);
    message.max_cues(settings.max_cues);
    if (progress) to_message(*progress, message);
    message.block_start_ns(block_start_ns);
    message.repetitions(repetition_count);
    message.learner(options.learner.substr(0, 64));
    message.header().publish_ns(bus::now_ns());
    states.write(message);
  }

  void follow() {
    if (poses.take_newest(pose_message) == 0) return;
    const std::uint64_t last = pose.frame;
    const bool valid = bus::from_message(pose_message, pose) &&
                       pose_message.skeleton_id() == body_id &&
                       pose.pose.q_PB.size() == kJointCount;
    if (last != 0 && pose.frame > last + 1) {
      summary.lost += pose.frame - last - 1;
      health.lost(pose.frame - last - 1);
    }
    if (!valid || !coach) {
      if (!valid) {
        ++summary.refused;
        health.lost(1);
      }
      return;
    }
    ++summary.frames;
    coach->step(pose, out);

    // The skin first.
    to_message(pose, out.tactors, ++command_number, command);
    command.header().publish_ns(bus::now_ns());
    tactors.write(command);
    to_message(pose, out.alignment, alignment);
    alignment.header().publish_ns(bus::now_ns());
    alignments.write(alignment);
    to_message(pose, out, coach->tolerance(), correction);
    correction.header().publish_ns(bus::now_ns());
    corrections.write(correction);
    if (out.repetition) publish_repetition(*out.repetition);
    coach->pose_problem();

    if (out.handed_over) {
      ++summary.corrections;
      if (out.correction.status == SolverStatus::kFallback) ++summary.fallbacks;
    }
    health.sample(static_cast<double>(command.header().publish_ns() - pose.stamp_ns) * 1e-9);
    health.confidence(out.alignment.confidence);
    if (look) look({pose, out, coach->cues(), coach->reference()});
    go_on();
  }

  void report() {
    if (sole.another()) {
      health.state(msg::SERVICE_FAULT, "another coach commands the tactors too; end one");
    } else if (!complaint.empty()) {
      health.state(msg::SERVICE_FAULT, complaint);
    } else if (!body) {
      health.state(msg::SERVICE_WAITING, "waiting for a capture server on this subject");
    } else if (!coach) {
      health.state(msg::SERVICE_WAITING, "waiting for a session to start");
    } else if (poses.counts().writers == 0) {
      health.state(msg::SERVICE_WAITING, "the capture server is gone; waiting for it");
    } else {
      health.state(msg::SERVICE_RUNNING);
    }
  }

  CoachServiceOptions options;
  std::function<void(const CoachFrame&)> look;
  std::function<void()> ended;

  bus::Reader<msg::SkeletonDefinition> skeletons;
  bus::Reader<msg::SkeletonPose> poses;
  bus::Reader<msg::SessionCommand> commands;
  bus::StopState stop;
  bus::WaitSet news;
  bus::Writer<msg::Alignment> alignments;
  bus::Writer<msg::Correction> corrections;
  bus::Writer<msg::TactorCommand> tactors;
  bus::SoleWriter<msg::TactorCommand> sole;
  bus::Writer<msg::RepetitionScore> repetitions;
  bus::Writer<msg::SessionState> states;
  bus::Writer<msg::ReferenceMotionList> references;
  bus::HealthReporter health;

  std::optional<Skeleton> body;
  std::uint32_t body_id = 0;
  std::size_t reference_index = 0;
  std::unique_ptr<SolverThread> solver;
  std::unique_ptr<Coach> coach;  // after the solver that it uses
  bool wanted = true;            // a session is to run
  bool state_changed = false;
  std::string complaint;  // why the last order or body was refused
  msg::SessionPhase phase = msg::SESSION_IDLE;
  std::uint32_t session_number = 0;
  std::int64_t session_start_ns = 0;
  CoachSettings settings;  // the block's
  std::optional<PlanProgress> progress;
  std::int64_t block_start_ns = 0;
  std::uint32_t repetition_count = 0;
  std::uint64_t command_number = 0;

  // Kept from frame to frame, so that their memory is.
  StampedPose pose;
  CoachOutput out;
  msg::SkeletonPose pose_message;
  msg::Alignment alignment;
  msg::Correction correction;
  msg::TactorCommand command;
  msg::RepetitionScore repetition;
  CoachSummary summary;
};

CoachService::CoachService(bus::Participant& participant, CoachServiceOptions options) {
  if (options.references.empty()) throw std::invalid_argument("the coach needs a reference");
  state_ = std::make_unique<State>(participant, std::move(options));
  state_->wanted = state_->options.start;
  state_->publish_references();
}

CoachService::~CoachService() = default;

void CoachService::on_frame(std::function<void(const CoachFrame&)> look) {
  state_->look = std::move(look);
}

void CoachService::on_end(std::function<void()> ended) { state_->ended = std::move(ended); }

std::optional<double> mean_total(const BlockSummary& block,
                                 std::span<const RepetitionScore> repetitions) noexcept {
  if (block.repetitions == 0) return std::nullopt;
  double sum = 0.0;
  for (const auto& score : repetitions.subspan(block.first, block.repetitions)) sum += score.total;
  return sum / static_cast<double>(block.repetitions);
}

CoachSummary CoachService::run(std::stop_token stop) {
  auto& s = *state_;
  const std::stop_callback wake(stop, [&s] { s.news.wake(); });
  while (!stop.stop_requested()) {
    s.take_orders();
    s.publish_state();
    s.follow();
    s.publish_state();
    s.report();
    const std::int64_t now = bus::now_ns();
    const std::int64_t due = s.health.tick(now);
    s.news.wait(std::chrono::nanoseconds(std::max<std::int64_t>(due - now, 1'000'000)));
  }
  s.end_block();
  s.summary.exposure = s.options.tactile.exposure;
  s.phase = msg::SESSION_ENDED;
  s.state_changed = true;
  s.publish_state();
  s.health.state(msg::SERVICE_ENDED);
  return s.summary;
}

}  // namespace secondskin::coach
