#include <fmt/format.h>
#include <unistd.h>

#include <nlohmann/json.hpp>

#include "clients/cli/common.h"
#include "clients/study/experiment.h"
#include "clients/study/processes.h"
#include "clients/study/statistics.h"

/// Does touch help to learn? TIKL's question (Lieberman & Breazeal 2007), put to simulated people.
namespace secondskin::cli {
namespace {

using nlohmann::json;
using study::Curve;
using study::Group;
using study::Interval;
using study::Person;
using study::Protocol;

struct StudyOptions {
  std::string reference = "shoulder_abduction";
  std::string body_map = "right_arm";
  std::string joints = "worn";
  std::string schedule = "always";
  Protocol protocol;
  std::size_t people = 20;
  std::uint64_t seed = 1;
  unsigned processes = 2;
  bool sensitivity = false;
  bool json = false;
};

constexpr std::array<const char*, 3> kGroups{"visual", "visual + tactile", "visual + sham"};

/// The three groups; the same people in the same order in each.
struct Groups {
  std::array<std::vector<Curve>, 3> error, place_error;
  std::array<double, 3> cues{}, reactions{}, right{}, wrong{}, counted{};  ///< means over people
};

// The pipe between processes carries numbers only.
void flatten(const Person& person, std::vector<double>& out) {
  out.insert(out.end(), person.error.begin(), person.error.end());
  out.insert(out.end(), person.place_error.begin(), person.place_error.end());
  for (const auto number :
       {person.cues, person.reactions, person.right, person.wrong, person.counted}) {
    out.push_back(static_cast<double>(number));
  }
}

/// @param sham  whether the sham group takes part
Groups run(const Protocol& protocol, const StudyOptions& options, bool sham, const char* what) {
  const std::vector<Joint> among = study::served(protocol);
  const bool show = ::isatty(STDERR_FILENO) != 0;
  const auto results = study::in_processes(
      options.people, options.processes,
      [&](std::size_t i) {
        const std::uint64_t seed = options.seed * 10'000 + i;
        std::vector<double> out;
        flatten(study::run_person(protocol, Group::kVisual, seed), out);
        const Person cued = study::run_person(protocol, Group::kTactile, seed);
        flatten(cued, out);
        if (sham) {
          const auto cues = coach::shuffled(cued.given, among, seed);
          flatten(study::run_person(protocol, Group::kSham, seed, cues), out);
        }
        return out;
      },
      [&](std::size_t done) {
        if (show) fmt::print(stderr, "\r{}: {} of {} people", what, done, options.people);
      });
  if (show) fmt::print(stderr, "\r\x1b[K");
  Groups groups;
  const std::size_t n = protocol.repetitions();
  for (const auto& result : results) {
    auto at = result.begin();
    for (std::size_t g = 0; g < (sham ? 3u : 2u); ++g) {
      const auto take = [&] {
        Curve curve(at, at + static_cast<std::ptrdiff_t>(n));
        at += static_cast<std::ptrdiff_t>(n);
        return curve;
      };
      if (result.end() - at < static_cast<std::ptrdiff_t>(2 * n + 5)) {
        throw std::runtime_error("study: a person did not come to the end of the protocol");
      }
      groups.error[g].push_back(take());
      groups.place_error[g].push_back(take());
      for (auto* mean :
           {&groups.cues, &groups.reactions, &groups.right, &groups.wrong, &groups.counted}) {
        (*mean)[g] += *at++ / static_cast<double>(results.size());
      }
    }
  }
  return groups;
}

/// By how much the second group is better than the first: what TIKL reports.
struct Benefit {
  Interval performing, steady, learning, retention;
};

Benefit benefit(const std::vector<Curve>& control, const std::vector<Curve>& group,
                const Protocol& protocol, std::uint64_t seed) {
  const std::size_t from = protocol.before, to = from + protocol.practice;
  const auto less_error = [&](study::Range range) {
    return study::bootstrap(
        control, group,
        [range](auto a, auto b) {
          return 1.0 - study::mean_error(b, range) / study::mean_error(a, range);
        },
        seed);
  };
  Benefit result;
  result.performing = less_error({from, to});
  result.steady = less_error({to - std::max<std::size_t>(1, protocol.practice / 3), to});
  result.learning = study::bootstrap(
      control, group,
      [&](auto a, auto b) {
        return study::learning_rate(b, {from, to}) / study::learning_rate(a, {from, to}) - 1.0;
      },
      seed);
  result.retention = less_error({to, protocol.repetitions()});
  return result;
}

// A ratio to something that may be nothing has no interval worth the name.
std::string percent(const Interval& i) {
  if (i.low < -10.0 || i.high > 10.0) return "not determined";
  return fmt::format("{:+.1f} % [{:+.1f}, {:+.1f}]", 100 * i.estimate, 100 * i.low, 100 * i.high);
}

json to_json(const Interval& i) {
  return {{"estimate", i.estimate}, {"low", i.low}, {"high", i.high}};
}
json to_json(const Benefit& b) {
  return {{"performing", to_json(b.performing)},
          {"steady", to_json(b.steady)},
          {"learning_rate", to_json(b.learning)},
          {"retention", to_json(b.retention)}};
}

double mean_deg(const std::vector<Curve>& group, study::Range range) {
  std::vector<const Curve*> people;
  for (const Curve& curve : group) people.push_back(&curve);
  return deg(study::mean_error(people, range));
}

double rate(const std::vector<Curve>& group, study::Range range) {
  std::vector<const Curve*> people;
  for (const Curve& curve : group) people.push_back(&curve);
  return study::learning_rate(people, range);
}

struct Variation {
  std::string what;
  Protocol protocol;
};

std::vector<Variation> variations(const Protocol& usual) {
  std::vector<Variation> list;
  const auto vary = [&](std::string what, auto change) {
    list.push_back({std::move(what), usual});
    change(list.back().protocol);
  };
  for (const double scale : {0.5, 1.5, 2.0}) {
    vary(fmt::format("reaction time x {:g}", scale), [&](Protocol& p) {
      p.learner.reaction_time *= scale;
      p.learner.second_task *= scale;
    });
  }
  for (const double missed : {0.0, 0.3, 0.5}) {
    vary(fmt::format("missed cues {:.0f} %", 100 * missed),
         [&](Protocol& p) { p.learner.missed = missed; });
  }
  for (const double misread : {0.0, 0.2}) {
    vary(fmt::format("misread cues {:.0f} %", 100 * misread),
         [&](Protocol& p) { p.learner.misread = misread; });
  }
  vary("reckons with own corrections", [&](Protocol& p) { p.learner.predicts = true; });
  vary("cues without an end", [&](Protocol& p) { p.endless_cues = true; });
  for (const double scale : {0.2, 1.0}) {
    vary(fmt::format("tolerance x {:g}", scale),
         [&](Protocol& p) { p.settings.tolerance_scale = scale; });
  }
  for (const std::uint32_t cues : {1u, 3u, 4u}) {
    vary(fmt::format("K = {}", cues), [&](Protocol& p) { p.settings.max_cues = cues; });
  }
  return list;
}

// Which share of the corrections made while moving went towards what was missing then.
std::string right_way(const Groups& groups, std::size_t g) {
  const double all = groups.right[g] + groups.wrong[g];
  return all > 0.0 ? fmt::format("{:.0f} %", 100.0 * groups.right[g] / all) : "-";
}

void print_groups(const Groups& groups, const Protocol& protocol, std::size_t count) {
  const std::size_t from = protocol.before, to = from + protocol.practice;
  fmt::print("{:<18}{:>8}{:>11}{:>8}{:>11}{:>12}{:>8}{:>11}{:>12}\n", "error (deg RMS)", "before",
             "practice", "last", "retention", "rate/rep", "cues", "reactions", "right way");
  for (std::size_t g = 0; g < count; ++g) {
    const auto& error = groups.error[g];
    fmt::print("{:<18}{:>8.2f}{:>11.2f}{:>8.2f}{:>11.2f}{:>10.2f} %{:>8.0f}{:>11.0f}{:>12}\n",
               kGroups[g], mean_deg(error, {0, from}), mean_deg(error, {from, to}),
               mean_deg(error, {to - std::max<std::size_t>(1, protocol.practice / 3), to}),
               mean_deg(error, {to, protocol.repetitions()}), 100 * rate(error, {from, to}),
               groups.cues[g], groups.reactions[g], right_way(groups, g));
  }
}

void print_benefits(const std::vector<std::pair<std::string, Benefit>>& rows) {
  fmt::print("\n{:<34}{:<26}{:<26}{:<28}{}\n", "better than visual by", "while practising",
             "in its last third", "learning rate", "retention");
  for (const auto& [name, b] : rows) {
    fmt::print("{:<34}{:<26}{:<26}{:<28}{}\n", name, percent(b.performing), percent(b.steady),
               percent(b.learning), percent(b.retention));
  }
}

void run_study(const StudyOptions& options) {
  const Library library;
  Protocol protocol = options.protocol;
  protocol.reference = library.load_reference(options.reference);
  protocol.map = library.load_body_map(options.body_map);
  if (options.joints == "worn") {
    protocol.reference = study::of_worn_joints(*protocol.reference, protocol.map);
  }
  if (study::served(protocol).empty()) {
    throw std::runtime_error(
        fmt::format("study: no joint that body map '{}' can cue has a weight in "
                    "reference '{}'",
                    options.body_map, options.reference));
  }
  if (options.schedule == "fading") {
    protocol.schedule = {.kind = coach::FeedbackSchedule::Kind::kFading, .first = 1.0, .last = 0.0};
  }
  const Groups groups = run(protocol, options, true, "study");
  std::vector<std::pair<std::string, Benefit>> rows, of_place, sensitivity;
  for (const std::size_t g : {1u, 2u}) {
    rows.emplace_back(kGroups[g],
                      benefit(groups.error[0], groups.error[g], protocol, options.seed));
    of_place.emplace_back(
        fmt::format("{}, places", kGroups[g]),
        benefit(groups.place_error[0], groups.place_error[g], protocol, options.seed));
  }
  if (options.sensitivity) {
    for (const auto& [what, varied] : variations(protocol)) {
      const Groups other = run(varied, options, false, what.c_str());
      sensitivity.emplace_back(what, benefit(other.error[0], other.error[1], varied, options.seed));
      sensitivity.emplace_back(
          fmt::format("{}, places", what),
          benefit(other.place_error[0], other.place_error[1], varied, options.seed));
    }
  }
  if (options.json) {
    json out{{"reference", options.reference},
             {"body_map", options.body_map},
             {"joints", options.joints},
             {"schedule", options.schedule},
             {"people", options.people},
             {"seed", options.seed},
             {"before", protocol.before},
             {"practice", protocol.practice},
             {"retention", protocol.retention},
             {"rest_s", protocol.rest},
             {"tolerance_scale", protocol.settings.tolerance_scale},
             {"max_cues", protocol.settings.max_cues}};
    for (std::size_t g = 0; g < 3; ++g) {
      json curve = json::array(), places = json::array();
      for (std::size_t n = 0; n < protocol.repetitions(); ++n) {
        curve.push_back(mean_deg(groups.error[g], {n, n + 1}));
        places.push_back(mean_deg(groups.place_error[g], {n, n + 1}) / deg(1.0));
      }
      out["groups"][kGroups[g]] = {{"error_deg", curve},
                                   {"place_error_m", places},
                                   {"cues", groups.cues[g]},
                                   {"reactions", groups.reactions[g]},
                                   {"right_way", groups.right[g]},
                                   {"wrong_way", groups.wrong[g]},
                                   {"repetitions_counted", groups.counted[g]}};
    }
    for (const auto* list : {&rows, &of_place, &sensitivity}) {
      for (const auto& [name, b] : *list) {
        out[list == &sensitivity ? "sensitivity" : "benefit"][name] = to_json(b);
      }
    }
    fmt::print("{}\n", out.dump(2));
    return;
  }
  fmt::print(
      "{} simulated people in each group, '{}' with body map '{}', {} + {} + {} repetitions\n\n",
      options.people, options.reference, options.body_map, protocol.before, protocol.practice,
      protocol.retention);
  print_groups(groups, protocol, 3);
  rows.insert(rows.end(), of_place.begin(), of_place.end());
  print_benefits(rows);
  fmt::print("{:<34}{:<26}{:<26}{:<28}\n", "TIKL, 40 people, up to", "+27 %", "+27 %",
             "+23 % (report: +21 %)");
  if (!sensitivity.empty()) {
    fmt::print("\nvisual + tactile, if one thing were different:");
    print_benefits(sensitivity);
  }
  fmt::print(
      "\nPlaces: of hands, feet and head of the limbs that are cued; else angles of their joints.\n"
      "In brackets: 95 % by bootstrap over people. These are simulated people: docs/study.md\n"
      "says what that can tell and what not.\n");
}

}  // namespace

void add_study(CLI::App& app) {
  auto options = std::make_shared<StudyOptions>();
  Protocol& protocol = options->protocol;
  auto* command = app.add_subcommand(
      "study", "simulated people learn with and without touch, through the whole chain");
  command->footer(
      "Example:  secondskin study --people 10 --sensitivity\n"
      "          secondskin study --reference low_block --schedule fading --json");
  command->add_option("--reference", options->reference, "the motion: name, folder or file")
      ->join(kPerformances)
      ->capture_default_str();
  command->add_option("--body-map", options->body_map, "where the tactors sit: name or .toml file")
      ->capture_default_str();
  command
      ->add_option("--joints", options->joints,
                   "what is taught: those that wear tactors themselves, as TIKL, or all")
      ->check(CLI::IsMember({"worn", "all"}))
      ->capture_default_str();
  command->add_option("--people", options->people, "in each group")
      ->check(CLI::Range(2, 10'000))
      ->capture_default_str();
  command->add_option("--practice", protocol.practice, "repetitions with the expert in sight")
      ->check(CLI::Range(3, 1000))
      ->capture_default_str();
  command->add_option("--schedule", options->schedule, "when practice is cued")
      ->check(CLI::IsMember({"always", "fading"}))
      ->capture_default_str();
  add_cue_options(*command, protocol.settings);
  command->add_flag("--sensitivity", options->sensitivity,
                    "also with other reaction times, missed and misread cues, and K");
  command->add_option("--seed", options->seed, "another one draws other people")
      ->capture_default_str();
  command->add_option("--processes", options->processes, "that share the people among them")
      ->check(CLI::Range(1, 256))
      ->capture_default_str();
  command->add_flag("--json", options->json, "everything as JSON, with the curves");
  command->callback([options] { run_study(*options); });
}

}  // namespace secondskin::cli
