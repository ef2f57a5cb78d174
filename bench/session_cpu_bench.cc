// What share of one processor core a live session takes at 62.5 Hz, as separate processes and as
// one: the real programs, a recorded learner who goes on and on, a virtual board. Processor time is
// the kernel's own count of each thread (/proc/PID/task/TID/schedstat, nanoseconds), taken at both
// ends of a stretch that begins when the session has run for a while. docs/benchmarks.md quotes the
// output.

#include <fmt/core.h>

#include <CLI/CLI.hpp>
#include <map>
#include <nlohmann/json.hpp>
#include <regex>

#include "bench/live_session.h"

namespace {

using namespace secondskin;
using namespace std::chrono_literals;

struct Options {
  std::string reference = "low_block";
  double seconds = 30.0;
  double warm_up = 8.0;
  std::uint32_t domain = 10 + static_cast<std::uint32_t>(::getpid()) % 90;

  /// A command that joins the session's bus.
  std::vector<std::string> on_bus(std::vector<std::string> command) const {
    command.insert(command.end(), {"--domain", std::to_string(domain), "--subject",
                                   "bench_" + std::to_string(::getpid())});
    return command;
  }
};

using ThreadTimes = std::map<pid_t, double>;  // by thread id [s]

ThreadTimes thread_times(pid_t pid) {
  ThreadTimes times;
  std::error_code error;
  const auto folder = std::filesystem::path("/proc") / std::to_string(pid) / "task";
  for (std::filesystem::directory_iterator it(folder, error), end; !error && it != end;
       it.increment(error)) {
    double on_cpu_ns = 0.0;
    if (std::ifstream(it->path() / "schedstat") >> on_cpu_ns) {
      times[std::stoi(it->path().filename().string())] = 1e-9 * on_cpu_ns;
    }
  }
  return times;
}

double total(const ThreadTimes& times) {
  double sum = 0.0;
  for (const auto& [id, time] : times) sum += time;
  return sum;
}

/// Children of a process, e.g. the tactor driver's guardian.
std::vector<pid_t> children_of(pid_t pid) {
  const auto id = std::to_string(pid);
  std::ifstream in("/proc/" + id + "/task/" + id + "/children");
  return {std::istream_iterator<pid_t>(in), {}};
}

struct Row {
  std::string name;
  double start_up = 0.0;  ///< processor time until the stretch began [s]
  double share = 0.0;     ///< of one core during it
  std::size_t threads = 0;
  ThreadTimes busiest;  ///< each thread's share
};

struct Result {
  std::string name;
  std::vector<Row> rows;
  double solver = 0.0;  ///< share of one core; part of the rows
  double corrections_per_second = 0.0;
};

double now() {
  return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

/// Watches programs over the stretch.
std::vector<Row> watch(const Options& options, const std::vector<bench::Program>& programs) {
  std::this_thread::sleep_for(std::chrono::duration<double>(options.warm_up));
  std::vector<std::pair<std::string, pid_t>> watched;
  for (const auto& program : programs) {
    watched.emplace_back(program.name(), program.pid());
    for (const pid_t child : children_of(program.pid())) watched.emplace_back("guardian", child);
  }
  std::vector<ThreadTimes> before;
  const double start = now();
  for (const auto& [name, pid] : watched) before.push_back(thread_times(pid));
  std::this_thread::sleep_for(std::chrono::duration<double>(options.seconds));
  const double duration = now() - start;
  std::vector<Row> rows;
  for (std::size_t i = 0; i < watched.size(); ++i) {
    const ThreadTimes after = thread_times(watched[i].second);
    if (after.empty()) throw std::runtime_error(watched[i].first + " ended before its time");
    Row row{watched[i].first, total(before[i]), 0.0, after.size(), {}};
    for (const auto& [id, time] : after) {
      const auto old = before[i].find(id);
      const double used = time - (old == before[i].end() ? 0.0 : old->second);
      row.busiest[id] = used / duration;
      row.share += used / duration;
    }
    rows.push_back(std::move(row));
  }
  return rows;
}

double number_in(const std::string& text, const char* pattern) {
  std::smatch match;
  if (!std::regex_search(text, match, std::regex(pattern))) {
    throw std::runtime_error(fmt::format("expected '{}' in:\n{}", pattern, text));
  }
  return std::stod(match[1]);
}

Result one_process(const Options& options, const bench::Folder& folder,
                   const std::string& learner) {
  Result result;
  result.name = "as one process (train, virtual board inside)";
  const double start = now();
  std::vector<bench::Program> programs;
  programs.emplace_back(
      options.on_bus({"train", "--loop", "--reference", options.reference, "--learner", learner,
                      "--recording", folder / "train.mcap"}),
      folder / "train.log");
  result.rows = watch(options, programs);
  const std::string summary = programs.front().end();
  const double poses = number_in(summary, R"(Session: (\d+) poses)");
  const double seconds = poses / bench::kRate;
  if (seconds < 0.9 * (now() - start - 4.0)) throw std::runtime_error("poses are missing");
  result.solver = number_in(summary, R"(closed form, ([\d.]+) s of processor time)") / seconds;
  result.corrections_per_second = number_in(summary, R"(Solver: (\d+) corrections)") / seconds;
  return result;
}

Result separate_processes(const Options& options, const bench::Folder& folder,
                          const std::string& learner) {
  Result result;
  result.name = "as separate processes";
  std::vector<bench::Program> programs;
  const auto start = [&](const std::vector<std::string>& command) {
    programs.emplace_back(command, folder / (command.front() + ".log"));
  };
  const std::string port = folder / "board";
  start({"virtual-board", "--link", port});
  start(options.on_bus({"tactors", "--port", port}));
  start(options.on_bus({"record", folder / "session.mcap"}));
  start(options.on_bus({"coach", "--reference", options.reference}));
  start(options.on_bus({"capture", learner, "--loop", "--wait-for", "2"}));
  result.rows = watch(options, programs);
  const std::size_t coach = 3;
  // The coach starts the solver's thread last.
  for (const Row& row : result.rows) {
    if (row.name == programs[coach].name()) result.solver = row.busiest.rbegin()->second;
  }
  const double poses = number_in(programs[4].end(), R"(capture: (\d+) poses)");
  result.corrections_per_second =
      number_in(programs[coach].end(), R"((\d+) corrections)") / (poses / bench::kRate);
  return result;
}

void print(const Result& result, bool threads) {
  fmt::print("{}\n{:<24} {:>7} {:>10} {:>12}\n", result.name, "", "threads", "% of core",
             "start-up [s]");
  Row all{"all", 0.0, 0.0, 0, {}};
  const auto row = [](const Row& r) {
    fmt::print("{:<24} {:>7} {:>10.2f} {:>12.2f}\n", r.name, r.threads, 100.0 * r.share,
               r.start_up);
  };
  for (const Row& r : result.rows) {
    row(r);
    if (threads) {
      for (const auto& [id, share] : r.busiest) fmt::print("  {:>8} {:>7.2f}\n", id, 100.0 * share);
    }
    all.share += r.share;
    all.start_up += r.start_up;
    all.threads += r.threads;
  }
  row(all);
  fmt::print("{:<24} {:>7} {:>10.2f}   {:.1f} corrections a second\n", "of it the solver", 1,
             100.0 * result.solver, result.corrections_per_second);
  fmt::print("{:<24} {:>7} {:>10.2f}\n\n", "without the solver", "",
             100.0 * (all.share - result.solver));
}

nlohmann::json json_of(const Result& result) {
  nlohmann::json out{{"name", result.name},
                     {"solver_share", result.solver},
                     {"corrections_per_second", result.corrections_per_second}};
  for (const Row& r : result.rows) {
    out["processes"].push_back(
        {{"name", r.name}, {"threads", r.threads}, {"share", r.share}, {"start_up_s", r.start_up}});
  }
  return out;
}

int measure(int argc, char** argv) {
  CLI::App app{"Processor share of one live session at 62.5 Hz"};
  Options options;
  std::string as = "both";
  bool json = false, threads = false;
  app.add_option("--seconds", options.seconds, "measured, each way")->capture_default_str();
  app.add_option("--warm-up", options.warm_up, "before them [s]")->capture_default_str();
  app.add_option("--as", as, "one process, separate processes, or both")
      ->check(CLI::IsMember({"one", "processes", "both"}))
      ->capture_default_str();
  app.add_option("--reference", options.reference)->capture_default_str();
  app.add_option("--domain", options.domain)->capture_default_str();
  app.add_flag("--threads", threads, "each thread's share too");
  app.add_flag("--json", json);
  CLI11_PARSE(app, argc, argv);

  const bench::Folder folder;
  const std::string learner = folder / "learner.bvh";
  write_bvh(bench::learner_of(options.reference), learner);
  std::vector<Result> results;
  if (as != "processes") results.push_back(one_process(options, folder, learner));
  if (as != "one") results.push_back(separate_processes(options, folder, learner));
  nlohmann::json out = nlohmann::json::array();
  for (const Result& result : results) {
    if (json) {
      out.push_back(json_of(result));
    } else {
      print(result, threads);
    }
  }
  if (json) fmt::print("{}\n", out.dump(2));
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  try {
    return measure(argc, argv);
  } catch (const std::exception& error) {
    fmt::print(stderr, "session_cpu_bench: {}\n", error.what());
    return 1;
  }
}
