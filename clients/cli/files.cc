#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <cmath>
#include <fstream>
#include <nlohmann/json.hpp>
#include <system_error>

#include "bus/pose_messages.h"
#include "bus/raw.h"
#include "bus/topics.h"
#include "clients/authoring/export_motion.h"
#include "clients/cli/common.h"
#include "clients/players/coach_rerun.h"
#include "clients/recorder/coach_replay.h"
#include "coach/align/aligner.h"
#include "coach/score/offline.h"
#include "motion/angle_csv.h"
#include "motion/bvh.h"
#include "motion/kinematics.h"
#include "motion/marker_file.h"
#include "recording/mcap_reader.h"
#include "recording/mcap_writer.h"
#include "server/markers/marker_source.h"
#include "server/open_source.h"

/// Commands on files: look, convert, align, score, replay.
namespace secondskin::cli {
namespace {

namespace fs = std::filesystem;
namespace msg = bus::msg;
using nlohmann::json;

constexpr const char* kPhaseNames[] = {"waiting", "moving", "paused", "finished", "lost"};
// Of RepetitionScore::lost.
constexpr const char* kLostNames[] = {"depth", "trunk",    "head",  "legs",
                                      "arms",  "symmetry", "joints"};

double seconds(std::int64_t ns) { return static_cast<double>(ns) * 1e-9; }

// ---- export

/// A source's own markers; nothing where it has none.
std::optional<MarkerMotion> own_markers(server::PoseSource& source) {
  if (const auto* own = dynamic_cast<server::MarkerSource*>(&source)) return own->markers();
  auto* optical = optical_of(source);
  if (optical == nullptr) return {};
  MarkerMotion out;
  out.rate_hz = source.rate_hz();
  out.names = optical->names();
  optical->observe([&out](const server::OpticalSource& from, server::Next what) {
    if (what == server::Next::kPose) out.frames.push_back(from.points());
  });
  server::for_each_pose(source, [](const StampedPose&) {});
  optical->observe({});
  return out;
}

/// A live source that ends when the user says so.
class UntilStopped final : public server::PoseSource {
 public:
  UntilStopped(server::PoseSource& source, std::stop_token stop)
      : source_(source), stop_(std::move(stop)) {}

  const Skeleton& skeleton() const override { return source_.skeleton(); }
  double rate_hz() const override { return source_.rate_hz(); }
  server::Next next(StampedPose& pose) override {
    return stop_.stop_requested() ? server::Next::kEnd : source_.next(pose);
  }
  bool rewind() override { return false; }
  bool live() const override { return true; }

 private:
  server::PoseSource& source_;
  std::stop_token stop_;
};

void export_command(CLI::App& app) {
  struct Options {
    std::string source;
    fs::path to;
    SourceOptions from;
  };
  auto options = std::make_shared<Options>();
  auto* command = app.add_subcommand("export", "run a source as fast as it can into a file");
  command->footer(
      "Example:  secondskin export session.mcap --to angles.csv\n"
      "csv: time, root position, every joint's anatomical angles in degrees. bvh: canonical body,\n"
      "metres, z up. c3d, trc: the source's markers or points, else the joints' centres. mcap: "
      "skeleton\n"
      "and poses.");
  command->add_option("source", options->source, kSourceHelp)->required();
  command->add_option("--to", options->to, "FILE.bvh, FILE.csv, FILE.c3d, FILE.trc or FILE.mcap")
      ->required();
  add_source_options(*command, options->from);
  command->callback([options] {
    const Library library;
    auto source = options->from.open(options->source, library);
    std::optional<StopOnSignal> signals;
    std::unique_ptr<server::PoseSource> live;
    if (options->source.starts_with("mvn:")) {
      live = std::exchange(source, nullptr);
      signals.emplace();
      source = std::make_unique<UntilStopped>(*live, signals->token());
      spdlog::info("exporting until Ctrl-C");
    }
    const std::string kind = options->to.extension().string();
    std::optional<MarkerMotion> markers;
    if (kind == ".c3d" || kind == ".trc") markers = own_markers(*source);
    if (markers) {
      write_markers(*markers, options->to);
    } else {
      authoring::export_source(*source, options->source, library.idl(), options->to);
    }
    spdlog::info("wrote {}", options->to.string());
  });
}

// ---- align and score: the coach's own stages over a file

/// Runs the aligner over a source; `look` gets every pose with its estimate.
template <class Look>
void follow(const std::shared_ptr<const coach::Reference>& reference, server::PoseSource& source,
            Look look) {
  coach::Aligner aligner(reference);
  std::optional<std::int64_t> start;
  server::for_each_pose(source, [&](StampedPose pose) {
    if (!start) start = pose.stamp_ns;
    // Stamps count from one millisecond: 0 means "none" to the stages.
    pose.stamp_ns += 1'000'000 - *start;
    look(pose, aligner.update(pose.stamp_ns, pose.pose), seconds(pose.stamp_ns - 1'000'000));
  });
}

void align_command(CLI::App& app) {
  struct Options {
    std::string reference, source;
    SourceOptions from;
    bool json = false;
  };
  auto options = std::make_shared<Options>();
  auto* command = app.add_subcommand("align", "say for each frame where in the reference it is");
  command->footer("Example:  secondskin align --reference squat my_squats.bvh --json");
  command
      ->add_option("--reference", options->reference,
                   "name, folder or motion file; given more than once: several performances")
      ->join(kPerformances)
      ->required();
  command->add_option("source", options->source, kSourceHelp)->required();
  command->add_flag("--json", options->json, "one JSON object a line");
  add_source_options(*command, options->from);
  command->callback([options] {
    const Library library;
    const auto reference = library.load_reference(options->reference);
    const auto source = options->from.open(options->source, library);
    if (!options->json) {
      fmt::print("{:>8} {:>11} {:>6} {:>10} {:>8} {:>10}\n", "t", "reference_t", "tempo",
                 "confidence", "phase", "repetition");
    }
    follow(reference, *source,
           [&](const StampedPose&, const coach::AlignmentEstimate& e, double t) {
             const char* phase = kPhaseNames[static_cast<int>(e.phase)];
             if (options->json) {
               fmt::print("{}\n", json{{"t", t},
                                       {"reference_t", e.reference_time},
                                       {"tempo", e.tempo},
                                       {"confidence", e.confidence},
                                       {"phase", phase},
                                       {"repetition", e.repetition}}
                                      .dump());
             } else {
               fmt::print("{:8.3f} {:11.3f} {:6.2f} {:10.2f} {:>8} {:10}\n", t, e.reference_time,
                          e.tempo, e.confidence, phase, e.repetition);
             }
           });
  });
}

json to_json(const std::string& source, const coach::RepetitionScore& score, bool mirrored) {
  const auto or_null = [](const std::optional<double>& value) {
    return value ? json(*value) : json(nullptr);
  };
  json joints = json::object();
  for (std::size_t j = 0; j < kJointCount; ++j) {
    const coach::JointScore& joint = score.joints[j];
    joints[std::string(joint_name(static_cast<Joint>(j)))] = {
        {"measured", joint.measured},
        {"rms_deg", deg(joint.rms)},
        {"peak_deg", deg(joint.peak)},
        {"in_band", joint.in_band},
        {"timing_error_s", or_null(joint.timing_error)},
        {"smoothness", or_null(joint.smoothness)},
        {"range_deg", deg(joint.range)},
        {"reference_range_deg", deg(joint.reference_range)}};
  }
  json lost = json::object();
  for (std::size_t c = 0; c < score.lost.size(); ++c) lost[kLostNames[c]] = or_null(score.lost[c]);
  return {{"source", source},
          {"start_s", seconds(score.start_ns - 1'000'000)},
          {"end_s", seconds(score.end_ns - 1'000'000)},
          {"mirrored", mirrored},
          {"total", score.total},
          {"lost", lost},
          {"joints", joints}};
}

void print_score(const std::string& source, const coach::RepetitionScore& score, bool mirrored) {
  fmt::print("{}: repetition {} from {:.2f} to {:.2f} s: {:.1f}{}\n", source, score.repetition,
             seconds(score.start_ns - 1'000'000), seconds(score.end_ns - 1'000'000), score.total,
             mirrored ? " (other side)" : "");
  fmt::print("  lost:");
  for (std::size_t c = 0; c < score.lost.size(); ++c) {
    if (score.lost[c]) fmt::print(" {} {:.0f} %", kLostNames[c], 100.0 * *score.lost[c]);
  }
  fmt::print("\n");
}

/// Every pose of a source, its stamps counted from one millisecond: 0 means "none" to the stages.
std::vector<StampedPose> stamped_poses(server::PoseSource& source) {
  std::vector<StampedPose> poses;
  server::for_each_pose(source, [&](const StampedPose& pose) { poses.push_back(pose); });
  const std::int64_t start = poses.empty() ? 0 : poses.front().stamp_ns;
  for (StampedPose& pose : poses) pose.stamp_ns += 1'000'000 - start;
  return poses;
}

void score_command(CLI::App& app) {
  struct Options {
    std::string reference;
    std::vector<std::string> sources;
    SourceOptions from;
    bool whole = false, either_side = false, json = false;
  };
  auto options = std::make_shared<Options>();
  auto* command = app.add_subcommand("score", "score each repetition in recordings");
  command->footer("Example:  secondskin score --reference squat monday.mcap friday.mcap --json");
  command
      ->add_option("--reference", options->reference,
                   "name, folder or motion file; given more than once: several performances")
      ->join(kPerformances)
      ->required();
  command->add_option("source", options->sources, kSourceHelp)->required();
  command->add_flag("--whole", options->whole, "each source is exactly one repetition");
  command->add_flag("--either-side", options->either_side,
                    "done as in a mirror it is as good: the better side counts");
  command->add_flag("--json", options->json, "one JSON object");
  add_source_options(*command, options->from);
  command->callback([options] {
    const Library library;
    auto reference = library.load_reference(options->reference);
    if (options->either_side && !reference->either_side) {
      auto either = std::make_shared<coach::Reference>(*reference);
      either->either_side = true;
      reference = std::move(either);
    }
    json all = json::array();
    for (const auto& name : options->sources) {
      const auto poses = stamped_poses(*options->from.open(name, library));
      const auto scores = options->whole ? coach::score_whole(reference, poses)
                                         : coach::score_recording(reference, poses);
      for (const auto& score : scores.repetitions) {
        all.push_back(to_json(name, score, scores.mirrored));
        if (!options->json) print_score(name, score, scores.mirrored);
      }
    }
    if (options->json) {
      fmt::print("{}\n", json{{"repetitions", all}}.dump(2));
    } else if (all.empty()) {
      fmt::print("no repetition found\n");
    }
  });
}

// ---- info

json describe_recording(const fs::path& file) {
  recording::McapReader reader(file);
  json topics = json::array();
  for (const auto& channel : reader.channels()) {
    topics.push_back(
        {{"topic", channel.topic}, {"type", channel.schema_name}, {"messages", channel.messages}});
  }
  return {{"file", file.string()},
          {"finished", reader.finished()},
          {"damage", reader.damage()},
          {"messages", reader.messages()},
          {"duration_s", seconds(reader.end_ns() - reader.start_ns())},
          {"topics", topics},
          {"metadata", reader.metadata()}};
}

json describe_motion(const fs::path& file, const Library& library, const RetargetOptions& options) {
  const auto native = read_bvh(file);
  json out{{"file", file.string()},
           {"joints", native.motion.skeleton.size()},
           {"frames", native.motion.poses.size()},
           {"rate_hz", native.motion.rate_hz},
           {"duration_s", native.motion.duration()},
           {"ignored_position_joints", native.ignored_position_joints}};
  const auto map = JointMap::choose(library.joint_maps(), native.motion.skeleton);
  const auto body = to_canonical(native.motion, map, options);
  out["joint_map"] = map.name();
  out["up"] = body.up == UpAxis::kY ? "y" : "z";
  out["metres_per_unit"] = body.metres_per_unit;
  json ranges = json::object();
  for (std::size_t j = 1; j < kJointCount; ++j) {
    const auto joint = static_cast<Joint>(j);
    if (body.motion.poses.front().confidence[j] == 0.0f) continue;
    for (std::size_t m = 0; m < 3; ++m) {
      double low = INFINITY, high = -INFINITY;
      for (const auto& pose : body.motion.poses) {
        const double angle = deg(joint_angles(joint, pose.q_PB[j])[m]);
        low = std::min(low, angle);
        high = std::max(high, angle);
      }
      if (high - low > 0.5) {
        ranges[fmt::format("{}_{}_deg", joint_name(joint), kMovementNames[m])] = {
            std::round(low * 10) / 10, std::round(high * 10) / 10};
      }
    }
  }
  out["angle_ranges"] = ranges;
  return out;
}

std::string plain(const json& value) {
  return value.is_string() ? value.get<std::string>() : value.dump();
}

// Nested objects as indented lines; a list of objects a line each, their values beside each other.
void print_tree(const json& value, int depth) {
  const std::string indent(static_cast<std::size_t>(2 * depth), ' ');
  for (const auto& [key, item] : value.items()) {
    if (item.is_object()) {
      fmt::print("{}{}:\n", indent, key);
      print_tree(item, depth + 1);
    } else if (item.is_array() && !item.empty() && item.front().is_object()) {
      fmt::print("{}{}:\n", indent, key);
      for (const auto& row : item) {
        std::string line = indent + "  ";
        for (const auto& [name, field] : row.items()) {
          line += fmt::format("{}{}", plain(field), field.is_number() ? " " + name + "  " : "  ");
        }
        fmt::print("{}\n", line);
      }
    } else if (!item.is_array() || !item.empty()) {
      fmt::print("{}{}: {}\n", indent, key, plain(item));
    }
  }
}

void info_command(CLI::App& app) {
  struct Options {
    fs::path path;
    SourceOptions from;
    bool json = false;
  };
  auto options = std::make_shared<Options>();
  auto* command = app.add_subcommand("info", "say what a motion file or a recording holds");
  command->footer("Example:  secondskin info session.mcap");
  command->add_option("file", options->path, ".bvh or .mcap")->required()->check(CLI::ExistingFile);
  command->add_flag("--json", options->json, "as JSON");
  add_source_options(*command, options->from);
  command->callback([options] {
    const json out = options->path.extension() == ".mcap"
                         ? describe_recording(options->path)
                         : describe_motion(options->path, Library(), options->from.retarget());
    if (options->json) {
      fmt::print("{}\n", out.dump(2));
    } else {
      print_tree(out, 0);
    }
  });
}

// ---- replay

void play(const fs::path& file, const bus::Config& config, double speed, std::stop_token stop) {
  recording::McapReader reader(file);
  bus::Participant participant(config);
  // What people look at; nothing that makes anything move or vibrate.
  constexpr std::array<std::string_view, 8> kShown{"skeleton",   "pose",          "points",
                                                   "raw",        "session_state", "alignment",
                                                   "correction", "repetition"};
  std::map<std::uint16_t, std::unique_ptr<bus::RawWriter>> writers;
  for (const auto& channel : reader.channels()) {
    for (std::size_t t = 0; t < bus::kTopics.size(); ++t) {
      const auto name = bus::kTopics[t].name;
      if (channel.topic.ends_with(fmt::format("/{}", name)) &&
          std::find(kShown.begin(), kShown.end(), name) != kShown.end()) {
        writers[channel.id] = std::make_unique<bus::RawWriter>(participant, t);
      }
    }
  }
  std::mutex mutex;
  std::condition_variable_any alarm;
  std::unique_lock lock(mutex);
  alarm.wait_for(lock, stop, std::chrono::milliseconds(500), [] { return false; });  // discovery
  const auto begin = std::chrono::steady_clock::now();
  std::uint64_t played = 0;
  bus::RawMessage message;
  reader.for_each([&](const recording::McapMessage& recorded) {
    const auto writer = writers.find(recorded.channel);
    if (writer == writers.end()) return true;
    const auto due =
        begin + std::chrono::nanoseconds(static_cast<std::int64_t>(
                    static_cast<double>(recorded.log_time_ns - reader.start_ns()) / speed));
    alarm.wait_until(lock, stop, due, [] { return false; });
    if (stop.stop_requested()) return false;
    message.bytes.assign(recorded.data.begin(), recorded.data.end());
    if (writer->second->write(message)) ++played;
    return true;
  });
  fmt::print("replay: {} messages played\n", played);
}

void rerun(const fs::path& file, const players::RerunSettings& settings, const fs::path& to,
           bool as_json) {
  const Library library;
  const auto replay = library.for_replay();
  const players::RerunLibrary all{
      .reference = replay.reference,
      .body_map = replay.body_map,
      .plan = [&library](const std::string& name) { return library.load_plan(name); }};
  if (fs::exists(to)) throw std::runtime_error(fmt::format("{}: exists already", to.string()));
  fs::path part = to;
  part += ".part";
  fs::remove(part);
  players::RerunResult result;
  try {
    result = players::rerun_coach(file, library.idl(), all, settings, part);
  } catch (...) {
    fs::remove(part);
    throw;
  }
  fs::rename(part, to);
  if (as_json) {
    json totals = json::array();
    for (const auto& score : result.repetitions) totals.push_back(score.total);
    fmt::print("{}\n", json{{"frames", result.frames},
                            {"cues", result.cues},
                            {"totals", totals},
                            {"remarks", result.remarks}}
                           .dump(2));
    return;
  }
  for (const auto& score : result.repetitions) {
    fmt::print("repetition {}: score {:5.1f}, {} cues\n", score.repetition, score.total,
               score.cues);
  }
  fmt::print("{} frames, {} cues; wrote {}\n", result.frames, result.cues, to.string());
  for (const auto& remark : result.remarks) fmt::print("note: {}\n", remark);
}

void replay_command(CLI::App& app) {
  struct Options {
    BusOptions bus;
    fs::path file;
    double speed = 1.0;
    bool coach = false;
    bool json = false;
    players::RerunSettings other;
    fs::path to;
  };
  auto options = std::make_shared<Options>();
  auto* command = app.add_subcommand("replay", "play a recording, or run the coach over it again");
  command->footer(
      "Example:  secondskin replay session.mcap --coach\n"
      "          secondskin replay session.mcap --coach --tolerance-scale 2 --to wider.mcap\n"
      "Without --coach the recording is published for dashboards to see; tactors stay still. With\n"
      "it the coach runs again on the recorded poses and its commands are compared byte for byte.");
  command->add_option("file", options->file, "a recording (.mcap)")
      ->required()
      ->check(CLI::ExistingFile);
  command->add_option("--speed", options->speed, "times the recording's own")
      ->check(CLI::Range(0.01, 100.0))
      ->capture_default_str();
  command->add_flag("--coach", options->coach, "run the coach again and compare its commands");
  command->add_flag("--json", options->json, "with --coach: the result as JSON");
  auto* to = command->add_option("--to", options->to,
                                 "with --coach: do not compare; write what the coach does with the "
                                 "settings below, else the recorded ones, into OUT.mcap");
  command->add_option("--reference", options->other.reference, "name, folder or motion file")
      ->needs(to);
  command->add_option("--tolerance-scale", options->other.tolerance_scale)
      ->check(CLI::Range(0.1, 10.0))
      ->needs(to);
  command->add_option("--max-cues", options->other.max_cues)
      ->check(CLI::Range(1u, static_cast<unsigned>(kJointCount)))
      ->needs(to);
  command->add_option("--body-map", options->other.body_map, "name or .toml file")->needs(to);
  command->add_option("--plan", options->other.plan, "name or .toml file; none: always cued")
      ->needs(to);
  add_bus_options(*command, options->bus);
  command->callback([options] {
    if (!options->coach && !options->to.empty()) {
      throw CLI::ValidationError("--to", "expected --coach with it");
    }
    if (!options->to.empty())
      return rerun(options->file, options->other, options->to, options->json);
    if (!options->coach) {
      StopOnSignal signals;
      play(options->file, options->bus.configuration("secondskin_replay"), options->speed,
           signals.token());
      return;
    }
    const Library library;
    const auto result = recorder::replay_coach(options->file, library.for_replay());
    if (options->json) {
      fmt::print("{}\n", json{{"sessions", result.sessions},
                              {"frames", result.frames},
                              {"corrections", result.corrections},
                              {"commands_compared", result.commands_compared},
                              {"commands_different", result.commands_different},
                              {"repetitions", result.repetitions.size()},
                              {"remarks", result.remarks}}
                             .dump(2));
    } else {
      fmt::print("replayed {} frames of {} sessions with {} corrections: {} of {} commands equal\n",
                 result.frames, result.sessions, result.corrections,
                 result.commands_compared - result.commands_different, result.commands_compared);
      for (const auto& remark : result.remarks) fmt::print("note: {}\n", remark);
    }
    if (result.commands_different > 0) throw CLI::RuntimeError(1);
  });
}

}  // namespace

void add_files(CLI::App& app) {
  export_command(app);
  info_command(app);
  replay_command(app);
  align_command(app);
  score_command(app);
}

}  // namespace secondskin::cli
