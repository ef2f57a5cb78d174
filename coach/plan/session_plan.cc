#include "coach/plan/session_plan.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <map>

#include "motion/toml_fields.h"

namespace secondskin::coach {
namespace {

constexpr double kSlowest = 0.25, kFastest = 2.0;

std::vector<GivenCue> read_yoked(const TomlFields& in, const std::filesystem::path& plan,
                                 std::uint64_t seed, const CueReader& read_cues) {
  const std::string session = in.text("session", "the recording of another session (.mcap)");
  std::vector<GivenCue> cues;
  try {
    if (!read_cues) throw std::runtime_error("recordings cannot be read here");
    cues = read_cues(plan.parent_path() / session);
  } catch (const std::exception& error) {
    in.fail("session", fmt::format("the recording of a coached session, but {}", error.what()));
  }
  std::map<std::uint32_t, std::size_t> by_repetition;
  std::vector<Joint> joints;
  for (const GivenCue& cue : cues) {
    if (++by_repetition[cue.repetition] > kMostYokedCues) {
      in.fail("session", fmt::format("at most {} cues in a repetition", kMostYokedCues));
    }
    if (std::find(joints.begin(), joints.end(), cue.joint) == joints.end()) {
      joints.push_back(cue.joint);
    }
  }
  if (in.table().contains("random_joints") && in.flag("random_joints")) {
    cues = shuffled(std::move(cues), joints, seed);
  }
  return cues;
}

FeedbackSchedule read_schedule(const TomlFields& in, const std::filesystem::path& plan,
                               std::uint64_t seed, const CueReader& read_cues) {
  using Kind = FeedbackSchedule::Kind;
  constexpr std::string_view kKinds =
      "\"always\", \"bandwidth\", \"fading\", \"fading_by_joint\", \"yoked\" or \"off\"";
  FeedbackSchedule schedule;
  const std::string kind = in.text("kind", kKinds);
  const auto has = [&](std::string_view field) { return in.table().contains(field); };
  const auto shares = [&] {
    schedule.first = has("first") ? in.number("first", 0.0, 1.0) : 1.0;
    schedule.last = has("last") ? in.number("last", 0.0, 1.0) : 0.0;
    if (schedule.last > schedule.first) in.fail("last", "at most first");
    if (has("goal")) schedule.goal = in.number("goal", 0.01, 1.0);
  };
  if (kind == "always" || kind == "off") {
    in.allow({"kind"});
    schedule.kind = kind == "off" ? Kind::kOff : Kind::kAlways;
  } else if (kind == "bandwidth") {
    in.allow({"kind", "band"});
    schedule.kind = Kind::kBandwidth;
    schedule.band = in.number("band", 1.0, 10.0);
  } else if (kind == "fading") {
    in.allow({"kind", "first", "last", "with", "goal"});
    schedule.kind = Kind::kFading;
    constexpr std::string_view kWith = "\"repetitions\" or \"success\"";
    const std::string with = has("with") ? in.text("with", kWith) : "repetitions";
    if (with != "repetitions" && with != "success") in.fail("with", kWith);
    schedule.by_success = with == "success";
    shares();
  } else if (kind == "fading_by_joint") {
    in.allow({"kind", "first", "last", "goal"});
    schedule.kind = Kind::kFadingByJoint;
    schedule.by_success = true;
    shares();
  } else if (kind == "yoked") {
    in.allow({"kind", "session", "random_joints"});
    schedule.kind = Kind::kYoked;
    schedule.cues = read_yoked(in, plan, seed, read_cues);
  } else {
    in.fail("kind", kKinds);
  }
  return schedule;
}

}  // namespace

SessionPlan SessionPlan::open() {
  SessionPlan plan;
  plan.blocks.emplace_back();
  return plan;
}

SessionPlan SessionPlan::load(const std::filesystem::path& file, const CueReader& read_cues) {
  const toml::table table = parse_toml(file);
  const TomlFields in(file, table);
  in.allow({"name", "description", "seed", "block"});
  SessionPlan plan;
  plan.name = in.text("name", "a name of at most 64 letters");
  if (plan.name.size() > 64) in.fail("name", "a name of at most 64 letters");
  if (table.contains("description")) plan.description = in.text("description");
  if (table.contains("seed")) plan.seed = in.whole("seed", 0, 1'000'000'000);
  in.each("block", [&](const TomlFields& fields) {
    fields.allow(
        {"name", "repetitions", "tempo", "tolerance_scale", "max_cues", "rest_s", "schedule"});
    const auto has = [&](std::string_view field) { return fields.table().contains(field); };
    Block block;
    block.name = fields.text("name", "a name of at most 64 letters");
    if (block.name.size() > 64) fields.fail("name", "a name of at most 64 letters");
    block.repetitions = fields.whole("repetitions", 1, 1000);
    if (has("tempo")) block.tempo = fields.number("tempo", kSlowest, kFastest);
    if (has("tolerance_scale")) {
      block.tolerance_scale = fields.number("tolerance_scale", 0.1, 10.0);
    }
    if (has("max_cues")) {
      block.max_cues = static_cast<std::uint32_t>(fields.whole("max_cues", 1, 16));
    }
    if (has("rest_s")) block.rest = fields.number("rest_s", 0.0, 3600.0);
    const toml::table* schedule = fields.table()["schedule"].as_table();
    if (schedule == nullptr) fields.fail("schedule", "a table such as { kind = \"always\" }");
    block.schedule = read_schedule(TomlFields(file, *schedule), file, plan.seed, read_cues);
    plan.blocks.push_back(std::move(block));
  });
  if (plan.blocks.size() > 64) in.fail("block", "at most 64 blocks");
  return plan;
}

std::shared_ptr<const Reference> at_tempo(std::shared_ptr<const Reference> reference,
                                          double tempo) {
  if (tempo == 1.0) return reference;
  // The poses as if sampled slower or faster, and then at the reference's rate again.
  auto slowed = std::make_shared<Reference>(*reference);
  Motion stretched = reference->motion;
  stretched.rate_hz *= tempo;
  slowed->motion = resample(stretched, reference->motion.rate_hz);
  slowed->posture = coach::stretched(reference->posture, slowed->motion.poses.size());
  if (!reference->band.empty()) {
    slowed->band.resize(slowed->motion.poses.size());
    for (std::size_t i = 0; i < slowed->band.size(); ++i) {
      const double time = static_cast<double>(i) / slowed->motion.rate_hz * tempo;
      for (std::size_t j = 0; j < kJointCount; ++j) {
        slowed->band[i][j] = reference->tolerance_at(time, j);
      }
    }
  }
  return slowed;
}

PlanProgress::PlanProgress(SessionPlan plan, const std::array<double, kJointCount>& weight)
    : plan_(std::move(plan)), weight_(weight) {
  if (plan_.blocks.empty()) throw std::invalid_argument("a plan has one block at least");
  decide_next();
}

void PlanProgress::decide_next() {
  feedback_ =
      decide(block().schedule, plan_.seed + block_, done_, block().repetitions, number_, weight_);
}

PlanProgress::Step PlanProgress::repetition(const RepetitionScore& score, std::int64_t stamp_ns) {
  if (ended_) return Step::kNone;
  Outcome& outcome = done_.emplace_back();
  for (std::size_t j = 0; j < kJointCount; ++j) outcome.in_band[j] = score.joints[j].in_band;
  ++number_;
  if (block().repetitions == 0 || done_.size() < block().repetitions) {
    decide_next();
    return Step::kNone;
  }
  if (block_ + 1 == plan_.blocks.size()) {
    ended_ = true;
    return Step::kEnded;
  }
  rest_ends_ns_ = block().rest > 0.0 ? stamp_ns + std::llround(block().rest * 1e9) : 0;
  ++block_;
  done_.clear();
  decide_next();
  return Step::kBlockBegins;
}

bool PlanProgress::advance(std::int64_t stamp_ns) noexcept {
  if (rest_ends_ns_ == 0 || stamp_ns < rest_ends_ns_) return false;
  rest_ends_ns_ = 0;
  return true;
}

}  // namespace secondskin::coach
