#include <fmt/format.h>
#include <poll.h>
#include <unistd.h>

#include <cmath>
#include <iostream>
#include <nlohmann/json.hpp>
#include <sstream>

#include "clients/authoring/draft.h"
#include "clients/authoring/save.h"
#include "clients/authoring/take.h"
#include "clients/authoring/take_recorder.h"
#include "clients/cli/common.h"
#include "server/capture_service.h"
#include "server/open_source.h"

/// secondskin reference record: the page's guided flow at a terminal, or all at once without one.
namespace secondskin::cli {
namespace {

using authoring::Draft;
using authoring::Take;
using authoring::TakeInfo;
using nlohmann::json;

constexpr double kLongestWait = 10.0;  // for a capture server [s]

struct RecordOptions {
  std::string name, source, description;
  std::size_t takes = 3;
  double countdown = 5.0, seconds = 60.0;
  bool json = false;
  SourceOptions from;
  BusOptions bus;
};

// A stretch of a take that goes into the reference.
struct Chosen {
  TakeInfo take;
  authoring::Span span;
  Motion motion;
};

bool interactive() { return ::isatty(STDIN_FILENO) == 1; }

std::string ask(const std::string& question) {
  fmt::print("{}", question);
  std::fflush(stdout);
  std::string line;
  if (!std::getline(std::cin, line)) throw std::runtime_error("the terminal was closed");
  return line;
}

/// Records from the subject's topics, which this process serves itself for a live SOURCE.
class LiveTakes {
 public:
  LiveTakes(const RecordOptions& options, const Library& library, authoring::TakeStore& store)
      : options_(options),
        participant_(options.bus.configuration("secondskin_reference")),
        recorder_(participant_, [this, &store](const authoring::Recorded& take) {
          newest_ = store.add(take.motion, take.source, take.start_ns, take.faults);
        }) {
    if (!options.source.empty()) {
      source_ = options.from.open(options.source, library);
      capture_ = std::make_unique<server::CaptureService>(
          participant_, *source_, server::CaptureOptions{.source_name = options.source});
      capture_thread_ = std::jthread([this](std::stop_token stop) { capture_->run(stop); });
    }
    thread_ = std::jthread([this](std::stop_token stop) { recorder_.run(stop); });
    for (int i = 0; i < static_cast<int>(kLongestWait * 10.0); ++i) {
      if (recorder_.state().alive) return;
      wait_for_stop({}, 0.1);
    }
    throw std::runtime_error(
        fmt::format("nobody is measured: expected a capture server for subject '{}' or a SOURCE",
                    options.bus.config.subject));
  }

  TakeInfo record(std::stop_token stop) {
    const auto before = recorder_.state().recorded;
    recorder_.record(options_.countdown, options_.seconds);
    std::string shown;
    while (!stop.stop_requested()) {
      const auto state = recorder_.state();
      if (state.phase == authoring::RecorderPhase::kIdle) break;
      const bool counting = state.phase == authoring::RecorderPhase::kCountdown;
      if (!options_.json) show(state, counting, shown);
      if (interactive() && enter_pressed()) {
        recorder_.stop();
        continue;
      }
      wait_for_stop(stop, 0.05);
    }
    recorder_.stop();
    if (!options_.json) fmt::print("\n");
    const auto state = recorder_.state();
    if (state.recorded == before) {
      throw std::runtime_error(state.trouble.empty() ? "nothing was recorded" : state.trouble);
    }
    return newest_;
  }

 private:
  static void show(const authoring::RecorderState& state, bool counting, std::string& shown) {
    const std::string line =
        counting ? fmt::format("{} ...{}", static_cast<int>(std::ceil(state.remaining)),
                               state.paused ? "  (the session is paused)" : "")
                 : fmt::format("RECORDING {:.0f} s, Enter ends it", state.elapsed);
    if (line == shown) return;
    shown = line;
    fmt::print("\r\033[K{}", line);
    std::fflush(stdout);
  }

  const RecordOptions& options_;
  bus::Participant participant_;
  TakeInfo newest_;
  authoring::TakeRecorder recorder_;
  std::unique_ptr<server::PoseSource> source_;
  std::unique_ptr<server::CaptureService> capture_;
  std::jthread capture_thread_, thread_;
};

bool is_live(const std::string& source) {
  const bool stream = source.starts_with("optical:") || source.starts_with("wearable:");
  return source.empty() || (stream && !source.ends_with(".csv") && !source.ends_with(".csv.gz") &&
                            !source.ends_with(".garment"));
}

std::vector<TakeInfo> all_takes(const RecordOptions& options, const Library& library,
                                authoring::TakeStore& store, std::stop_token stop) {
  if (!is_live(options.source)) {
    const auto source = options.from.open(options.source, library);
    return {store.add(server::read_all(*source), options.source, bus::now_ns())};
  }
  LiveTakes live(options, library, store);
  if (!interactive()) return {live.record(stop)};
  std::vector<TakeInfo> takes;
  while (!stop.stop_requested()) {
    const bool enough = takes.size() >= options.takes;
    const auto line =
        ask(enough ? fmt::format("Enter: go on with {} takes; r: record another  ", takes.size())
                   : fmt::format("Enter: record take {} of {}; d: done  ", takes.size() + 1,
                                 options.takes));
    if (enough ? line != "r" : line == "d") break;
    try {
      takes.push_back(live.record(stop));
      const TakeInfo& take = takes.back();
      fmt::print("take {}: {:.1f} s, {} repetition{} found\n", takes.size(), take.duration,
                 take.parts.size(), take.parts.size() == 1 ? "" : "s");
      for (const auto& fault : take.faults) fmt::print("  {}\n", fault);
    } catch (const std::runtime_error& error) {
      fmt::print("{}\n", error.what());
    }
  }
  if (takes.empty()) throw std::runtime_error("no take was recorded");
  return takes;
}

// Which of the repetitions count: numbers from 1, or all.
std::vector<Chosen> choose(std::vector<Chosen> all) {
  for (std::size_t i = 0; i < all.size(); ++i) {
    fmt::print("{:3}: take {}, {:.2f} to {:.2f} s\n", i + 1, all[i].take.id, all[i].span.start,
               all[i].span.end);
  }
  for (;;) {
    std::istringstream line(ask("Which count? Enter: all; else numbers, e.g. 1 3  "));
    std::vector<Chosen> chosen;
    std::string word;
    bool good = true;
    while (line >> word) {
      const std::size_t n =
          word.find_first_not_of("0123456789") == std::string::npos && word.size() < 6
              ? std::stoul(word)
              : 0;
      good = good && n >= 1 && n <= all.size();
      if (good) chosen.push_back(all[n - 1]);
    }
    if (!good) {
      fmt::print("expected numbers from 1 to {}\n", all.size());
      continue;
    }
    return chosen.empty() ? all : chosen;
  }
}

void show(const Draft& draft) {
  fmt::print("{:<16} {:>8} {:>8} {:>7} {:>10}\n", "joint", "range", "spread", "weight",
             "tolerance");
  for (std::size_t j = 0; j < kJointCount; ++j) {
    const auto& joint = draft.joints[j];
    if (joint.weight <= 0.0) continue;
    fmt::print("{:<16} {:4.0f} deg {:4.1f} deg {:7.1f} {:6.0f} deg{}\n",
               joint_name(static_cast<Joint>(j)), deg(joint.range), deg(joint.spread), joint.weight,
               deg(joint.tolerance), joint.weight >= authoring::kOfInterest ? "  of interest" : "");
  }
}

json describe(const authoring::Recipe& recipe, const std::vector<Chosen>& parts, const Draft& draft,
              const std::filesystem::path& folder) {
  json list = json::array(), joints = json::object();
  for (const Chosen& part : parts) {
    list.push_back(
        {{"take", part.take.id}, {"start_s", part.span.start}, {"end_s", part.span.end}});
  }
  for (std::size_t j = 0; j < kJointCount; ++j) {
    joints[std::string(joint_name(static_cast<Joint>(j)))] = {
        {"range_deg", deg(draft.joints[j].range)},
        {"spread_deg", deg(draft.joints[j].spread)},
        {"weight", recipe.weight[j]},
        {"tolerance_deg", deg(recipe.tolerance[j])}};
  }
  return {{"name", recipe.name},
          {"folder", folder.string()},
          {"duration_s", draft.mean.duration()},
          {"standing", recipe.standing},
          {"parts", std::move(list)},
          {"joints", std::move(joints)}};
}

void record(const RecordOptions& options) {
  const StopOnSignal signals;
  const Library library;
  authoring::require_reference_name(options.name);
  if (std::filesystem::exists(library.own_references() / options.name)) {
    throw std::runtime_error(fmt::format(
        "name '{}': a reference of this name exists already; choose another", options.name));
  }
  authoring::TakeStore store(library.own_takes(), library.joint_maps());
  std::vector<Chosen> parts;
  for (const TakeInfo& info : all_takes(options, library, store, signals.token())) {
    const Take take = store.load(info.id);
    for (const auto& part : info.parts) {
      parts.push_back({info, part.span, authoring::part_of(take.motion, part.span, "part")});
    }
  }
  if (interactive() && !options.json && parts.size() > 1) parts = choose(std::move(parts));

  auto recipe = authoring::plain_recipe(options.name, {});
  for (const Chosen& part : parts) recipe.performances.push_back(part.motion);
  const Draft draft = authoring::make_draft(recipe.performances, {},
                                            authoring::canonical_names(library.joint_maps()));
  recipe.description = options.description;
  recipe.origin = fmt::format("take {} of {}", parts.front().take.id, parts.front().take.source);
  recipe.standing = draft.standing;
  for (std::size_t j = 0; j < kJointCount; ++j) {
    recipe.weight[j] = draft.joints[j].weight;
    recipe.tolerance[j] = draft.joints[j].tolerance;
  }
  if (!options.json) show(draft);
  if (interactive() && !options.json &&
      !ask(fmt::format("Enter: save as '{}'; anything else: do not  ", options.name)).empty()) {
    fmt::print("not saved; the takes are kept\n");
    return;
  }
  const auto folder =
      authoring::save_reference(recipe, library.own_references(), library.joint_maps());
  if (options.json) {
    fmt::print("{}\n", describe(recipe, parts, draft, folder).dump(2));
    return;
  }
  fmt::print(
      "reference '{}', the mean of {} repetition{} ({:.2f} s), is in {}\n"
      "Train with it:  secondskin train --reference {} --learner SOURCE\n",
      recipe.name, parts.size(), parts.size() == 1 ? "" : "s", draft.mean.duration(),
      folder.string(), recipe.name);
}

}  // namespace

void add_reference_record(CLI::App& reference) {
  auto options = std::make_shared<RecordOptions>();
  auto* command = reference.add_subcommand(
      "record", "record takes, cut and average their repetitions, propose tolerances, save");
  command->footer(
      "Example:  secondskin reference record my_squat\n"
      "          secondskin reference record my_squat three_squats.bvh --json < /dev/null\n"
      "Without SOURCE it records whom the subject's capture server measures. A file is one take.\n"
      "Without a terminal it asks nothing: one take, all repetitions, as proposed.");
  command->add_option("name", options->name, "what to call it: letters, digits, '_' and '-'")
      ->required();
  command->add_option("source", options->source, kSourceHelp);
  command->add_option("--description", options->description, "a line for people");
  command->add_option("--takes", options->takes, "how many to record")
      ->check(CLI::Range(1, 20))
      ->capture_default_str();
  command->add_option("--countdown", options->countdown, "before each [s]")
      ->check(CLI::Range(0.0, authoring::kLongestCountdown))
      ->capture_default_str();
  command->add_option("--seconds", options->seconds, "a take lasts at most [s]")
      ->check(CLI::Range(1.0, authoring::kLongestRecording))
      ->capture_default_str();
  command->add_flag("--json", options->json, "ask nothing and say what was done as JSON");
  add_source_options(*command, options->from);
  add_bus_options(*command, options->bus);
  command->callback([options] { record(*options); });
}

}  // namespace secondskin::cli
