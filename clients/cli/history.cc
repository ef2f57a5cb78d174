#include <fmt/format.h>
#include <unistd.h>

#include <chrono>
#include <iostream>
#include <nlohmann/json.hpp>
#include <stdexcept>

#include "clients/cli/common.h"
#include "clients/history/history.h"
#include "clients/history/history_json.h"
#include "clients/history/pdf.h"
#include "clients/history/profiles.h"
#include "clients/history/report.h"
#include "clients/players/recordings.h"
#include "motion/whole_file.h"

/// Looks into the history of learners' sessions, and keeps it: `secondskin history`.
namespace secondskin::cli {
namespace {

namespace fs = std::filesystem;
using history::History;
using nlohmann::json;

struct HistoryOptions {
  fs::path database;  ///< empty: the user's own
  bool as_json = false, yes = false;
  std::string learner, note, reference, format;
  std::int64_t session = 0;
  fs::path to;
  fs::path recordings = "recordings";

  fs::path file() const { return database.empty() ? Library().own_history() : database; }

  // A misspelt --database must not make a new one.
  History open() const {
    if (!fs::exists(file())) {
      throw std::runtime_error(
          fmt::format("{}: there is no history yet; 'secondskin history add' or a session makes it",
                      file().string()));
    }
    return History(file());
  }

  history::Learner known_learner(History& from) const {
    if (auto found = from.learner(learner)) return std::move(*found);
    throw std::runtime_error(fmt::format(
        "LEARNER '{}': expected an id that 'secondskin history learners' lists", learner));
  }
};

void print(const json& value) {
  fmt::print("{}\n", value.dump(2, ' ', false, json::error_handler_t::replace));
}

std::string points(const std::optional<double>& total) {
  return total ? fmt::format("{:.1f}", *total) : "-";
}

// "2026-03-04 05:06"
std::string minute(std::int64_t ns) {
  std::string text = history::iso_time(ns).substr(0, 16);
  text[10] = ' ';
  return text;
}

// ---- what each command does

void add(const HistoryOptions& options) {
  History to(options.file());
  const auto learner = to.add_learner(options.note);
  if (options.as_json) return print(history::to_json(learner));
  fmt::print("{}\n", learner.id);
}

void list_learners(const HistoryOptions& options) {
  History from = options.open();
  json all = json::array();
  if (!options.as_json) {
    fmt::print("{:<12} {:>8}  {:<16} {}\n", "learner", "sessions", "last (UTC)", "note");
  }
  for (const auto& learner : from.learners()) {
    all.push_back(history::to_json(learner));
    if (options.as_json) continue;
    fmt::print("{:<12} {:>8}  {:<16} {}\n", learner.id, learner.sessions,
               learner.last_session_ns ? minute(*learner.last_session_ns) : "-", learner.note);
  }
  if (options.as_json) print(all);
}

void list_sessions(const HistoryOptions& options) {
  History from = options.open();
  if (!options.learner.empty()) options.known_learner(from);
  json all = json::array();
  if (!options.as_json) {
    fmt::print("{:>7} {:<12} {:<16} {:<20} {:<12} {:>11} {:>6} {:>5}\n", "session", "learner",
               "start (UTC)", "reference", "plan", "repetitions", "score", "cues");
  }
  for (const auto& session : from.sessions(options.learner)) {
    all.push_back(history::to_json(session, false));
    if (options.as_json) continue;
    fmt::print("{:>7} {:<12} {:<16} {:<20} {:<12} {:>11} {:>6} {:>5}\n", session.id,
               session.learner, minute(session.start_ns), session.reference.name,
               session.plan.empty() ? "-" : session.plan, session.repetitions,
               points(session.mean_total), session.cues);
  }
  if (options.as_json) print(all);
}

void show(const HistoryOptions& options) {
  History from = options.open();
  const auto session = from.session(options.session);
  if (!session) {
    throw std::runtime_error(fmt::format(
        "SESSION {}: expected a number that 'secondskin history sessions' lists", options.session));
  }
  if (options.as_json) return print(history::to_json(*session, true));
  fmt::print("session {} of {}, {} UTC, reference {}\n", session->id, session->learner,
             minute(session->start_ns), session->reference.name);
  for (const auto& block : session->blocks) {
    fmt::print("block {} '{}': {}, tempo {}\n", block.index + 1, block.name,
               block.schedule.empty() ? "schedule unknown" : block.schedule,
               block.tempo ? fmt::format("{:g}", *block.tempo) : "unknown");
    for (const auto& repetition : block.repetitions) {
      const history::JointFigures* worst = nullptr;
      for (const auto& joint : repetition.joints) {
        if (joint.measured && (worst == nullptr || joint.rms > worst->rms)) worst = &joint;
      }
      fmt::print("  {:>3}  score {:5.1f}  {:>3} cues{}\n", repetition.number, repetition.total,
                 repetition.cues,
                 worst == nullptr
                     ? std::string()
                     : fmt::format("  largest error {} {:.1f} deg", worst->joint, deg(worst->rms)));
    }
  }
}

void show_progress(const HistoryOptions& options) {
  History from = options.open();
  const auto course = from.course(options.known_learner(from).id);
  const auto names = history::practised_references(course);
  const std::string reference =
      options.reference.empty() && names.size() == 1 ? names.front() : options.reference;
  if (std::find(names.begin(), names.end(), reference) == names.end()) {
    std::string list;
    for (const auto& name : names) list += (list.empty() ? "" : ", ") + name;
    throw std::runtime_error(fmt::format("--reference '{}': {} practised {}", reference,
                                         options.learner, list.empty() ? "none yet" : list));
  }
  const auto progress = history::progress(course, reference);
  if (options.as_json) return print(history::to_json(progress, reference));
  fmt::print("{:<16} {:<20} {:<16} {:>5} {:>11} {:>6} {:>5}\n", "start (UTC)", "block", "schedule",
             "tempo", "repetitions", "score", "sd");
  for (const auto& point : progress.points) {
    fmt::print("{:<16} {:<20} {:<16} {:>5.2f} {:>11} {:>6.1f} {:>5}\n", minute(point.start_ns),
               point.name, point.schedule, point.tempo, point.repetitions, point.mean_total,
               points(point.sd_total));
  }
  for (const auto& entry : progress.retention) {
    fmt::print("{} without cues: {:.1f} after {:.1f} {} ({:+.1f})\n",
               minute(entry.retention.start_ns), entry.retention.mean_total,
               entry.practice.mean_total,
               entry.kind == history::Retention::Kind::kAfterCues
                   ? "in the cued block before it"
                   : fmt::format("on {}", minute(entry.practice.start_ns).substr(0, 10)),
               entry.change());
  }
  for (const auto& schedule : progress.schedules) {
    fmt::print(
        "schedule {}: {} sessions, first block {:.1f}, last {:.1f}, change without cues {}\n",
        schedule.schedule, schedule.sessions, schedule.first, schedule.last,
        schedule.retention ? fmt::format("{:+.1f}", *schedule.retention) : "-");
  }
}

// What is told of a learner is for nobody else's eyes.
void write_private(const fs::path& file, const std::string& text) {
  write_whole_file(file, text);
  fs::permissions(file, fs::perms::owner_read | fs::perms::owner_write);
  fmt::print(stderr, "{}: {} bytes\n", file.string(), text.size());
}

void report(const HistoryOptions& options) {
  const auto kind = options.to.extension();
  if (kind != ".html" && kind != ".pdf") {
    throw std::runtime_error(
        fmt::format("--to '{}': expected a name with .html or .pdf", options.to.string()));
  }
  History from = options.open();
  const auto learner = options.known_learner(from);
  const std::string html = history::report_html(learner, from.course(learner.id), bus::now_ns());
  write_private(options.to, kind == ".pdf" ? history::pdf_of(html) : html);
}

void export_history(const HistoryOptions& options) {
  const auto kind = options.to.extension();
  const bool csv = options.format.empty() ? kind == ".csv" : options.format == "csv";
  if (options.format.empty() && kind != ".csv" && kind != ".json") {
    throw std::runtime_error(
        "--to: expected a name with .csv or .json; or --format csv or json, to standard output");
  }
  History from = options.open();
  const auto learner = options.known_learner(from);
  const auto course = from.course(learner.id);
  const std::string text = csv ? history::export_csv(course)
                               : history::export_json(learner, course)
                                         .dump(2, ' ', false, json::error_handler_t::replace) +
                                     "\n";
  if (!options.to.empty()) return write_private(options.to, text);
  fmt::print("{}", text);
}

void forget(const HistoryOptions& options) {
  History from = options.open();
  const auto learner = options.known_learner(from);
  if (!options.yes) {
    if (::isatty(STDIN_FILENO) == 0) {
      throw std::runtime_error("history delete: expected --yes, since nobody can be asked");
    }
    fmt::print("Delete learner {} and {} sessions for good? [y/N] ", learner.id, learner.sessions);
    std::fflush(stdout);
    std::string said;
    std::getline(std::cin, said);
    if (said != "y" && said != "yes") {
      fmt::print("Nothing was deleted.\n");
      return;
    }
  }
  // First what the history leads to: if that fails, the learner is still there to try again.
  const auto recordings = players::Recordings(options.recordings).forget(learner.id);
  const auto profiles = history::remove_profile(Library().own_profiles(), learner.id);
  from.forget(learner.id);
  json kept = json::array();
  for (const auto& [name, why] : recordings.kept) kept.push_back({{"name", name}, {"why", why}});
  if (options.as_json) {
    return print({{"deleted", learner.id},
                  {"sessions", learner.sessions},
                  {"recordings", recordings.removed},
                  {"profiles", profiles},
                  {"kept", std::move(kept)}});
  }
  fmt::print("Deleted learner {} with {} sessions and {} recordings in {}.\n", learner.id,
             learner.sessions, recordings.removed.size(), options.recordings.string());
  for (const auto& name : profiles) fmt::print("Deleted {}\n", name);
  for (const auto& [name, why] : recordings.kept) fmt::print("Kept {}: {}\n", name, why);
  fmt::print(
      "What you saved elsewhere is not known here: exports, reports, backups, recordings, tactile "
      "profiles made with --out and the exposure files beside them. Delete those, too.\n");
}

}  // namespace

void add_history(CLI::App& app) {
  auto* history = app.add_subcommand("history", "learners, their sessions, progress and reports");
  history->require_subcommand(1);
  history->footer(
      "Learners are pseudonyms; who they are is yours to keep elsewhere. Example:\n"
      "  secondskin history add --note \"left knee\"      prints an id, say L-7K3M9Q\n"
      "  secondskin history report L-7K3M9Q --to file.pdf");
  auto options = std::make_shared<HistoryOptions>();
  const auto command = [&](const char* name, const char* what, const char* example,
                           void (*run)(const HistoryOptions&), bool reports = true) {
    auto* sub = history->add_subcommand(name, what);
    sub->footer(std::string("Example:\n  ") + example);
    sub->add_option("--database", options->database,
                    "the history's file (default: $XDG_DATA_HOME/secondskin/history.db)");
    if (reports) sub->add_flag("--json", options->as_json, "as JSON");
    sub->callback([options, run] { run(*options); });
    return sub;
  };
  const auto learner = [&](CLI::App* sub, bool required) {
    sub->add_option("LEARNER", options->learner, "a learner's id")->required(required);
    return sub;
  };
  command("learners", "list all learners", "secondskin history learners --json", list_learners);
  command("add", "a new learner; prints the pseudonym",
          "secondskin history add --note \"left knee, Tuesdays\"", add)
      ->add_option("--note", options->note, "what to remember; better no name");
  learner(command("sessions", "list sessions, the newest first",
                  "secondskin history sessions L-7K3M9Q", list_sessions),
          false);
  command("show", "a session's blocks and repetitions", "secondskin history show 12 --json", show)
      ->add_option("SESSION", options->session, "a session's number")
      ->required();
  learner(command("progress", "scores over weeks, retention, schedules",
                  "secondskin history progress L-7K3M9Q --reference squat", show_progress),
          true)
      ->add_option("--reference", options->reference,
                   "which motion (default: the only one practised)");
  learner(command("report", "a printable report for the patient's file",
                  "secondskin history report L-7K3M9Q --to report.pdf", report, false),
          true)
      ->add_option("--to", options->to, "FILE.html or FILE.pdf")
      ->required();
  auto* out =
      learner(command("export", "all figures of a learner",
                      "secondskin history export L-7K3M9Q --to figures.csv", export_history, false),
              true);
  out->add_option("--to", options->to, "FILE.csv or FILE.json (default: standard output)");
  out->add_option("--format", options->format, "csv or json, instead of the name's")
      ->check(CLI::IsMember({"csv", "json"}));
  auto* remove = learner(command("delete", "remove a learner and all that is kept of them",
                                 "secondskin history delete L-7K3M9Q --yes", forget),
                         true);
  remove->add_flag("--yes", options->yes, "do not ask");
  remove
      ->add_option("--recordings", options->recordings,
                   "the folder of the recordings, from which theirs go, too")
      ->capture_default_str();
}

}  // namespace secondskin::cli
