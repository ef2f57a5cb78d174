#include <fmt/format.h>
#include <glob.h>
#include <spdlog/spdlog.h>
#include <unistd.h>

#include <cstring>
#include <nlohmann/json.hpp>

#include "bus/reader.h"
#include "bus/wait_set.h"
#include "bus/writer.h"
#include "clients/cli/common.h"
#include "coach/correct/correction.h"
#include "motion/anatomy.h"
#include "recording/mcap_reader.h"

/// Looks for what keeps a session from running, and says what to do.
namespace secondskin::cli {
namespace {

namespace fs = std::filesystem;
namespace msg = bus::msg;
using namespace std::chrono_literals;

struct Finding {
  std::string subject;
  bool good;
  std::string words;  ///< what was found; for a problem, what to do
};

Finding check_data() {
  const Library library;
  for (const fs::path& file : {library.qos(), library.idl(), library.joint_maps()}) {
    if (!fs::exists(file)) {
      return {"data files", false, fmt::format("{} is missing; install again", file.string())};
    }
  }
  return {"data files", true, library.root().string()};
}

Finding check_references() {
  const Library library;
  std::string bad;
  std::size_t good = 0;
  for (const auto& folder : library.references()) {
    try {
      (void)library.load_reference(folder.string());
      ++good;
    } catch (const std::exception& error) {
      bad = error.what();
    }
  }
  if (!bad.empty()) return {"references", false, bad};
  return {"references", good > 0, fmt::format("{} can be loaded", good)};
}

Finding check_bus(bus::Config config) {
  config.subject += fmt::format("_doctor{}", ::getpid());
  const std::string subject = "DDS on 127.0.0.1";
  try {
    bus::Participant here(config), there(config);
    bus::Writer<msg::EmergencyStop> writer(here);
    bus::Reader<msg::EmergencyStop> reader(there);
    bus::WaitSet news;
    news.attach(reader);
    msg::EmergencyStop message;
    message.active(true);
    writer.write(message);
    const auto begin = std::chrono::steady_clock::now();
    while (std::chrono::steady_clock::now() < begin + 5s) {
      news.wait(100ms);
      if (reader.take(message)) {
        return {subject, true,
                fmt::format("a message arrived {:.0f} ms after joining",
                            std::chrono::duration<double, std::milli>(
                                std::chrono::steady_clock::now() - begin)
                                .count())};
      }
    }
    return {subject, false, "no message arrived in 5 s: is the loopback interface up?"};
  } catch (const std::exception& error) {
    return {subject, false, error.what()};
  }
}

std::vector<Finding> check_ports(const std::string& port) {
  std::vector<std::string> paths;
  if (!port.empty()) {
    paths.push_back(port);
  } else {
    glob_t found{};
    for (const char* pattern : {"/dev/ttyUSB*", "/dev/ttyACM*", "/dev/rfcomm*"}) {
      ::glob(pattern, paths.empty() && found.gl_pathc == 0 ? 0 : GLOB_APPEND, nullptr, &found);
    }
    for (std::size_t i = 0; i < found.gl_pathc; ++i) paths.emplace_back(found.gl_pathv[i]);
    ::globfree(&found);
  }
  if (paths.empty()) {
    return {{"tactor port", true,
             "no serial port is attached; 'secondskin train' uses a virtual board"}};
  }
  std::vector<Finding> findings;
  for (const auto& path : paths) {
    const bool exists = ::access(path.c_str(), F_OK) == 0;
    const bool usable = exists && ::access(path.c_str(), R_OK | W_OK) == 0;
    findings.push_back({fmt::format("port {}", path), usable,
                        usable    ? "can be opened"
                        : !exists ? "is not there: plug the board in, or pair it (rfcomm bind)"
                                  : "not permitted: add yourself to the group dialout "
                                    "(sudo adduser $USER dialout) and log in again"});
  }
  return findings;
}

Finding check_solver() {
  try {
    Motion still{canonical_skeleton(), 60.0, {Pose(kJointCount), Pose(kJointCount)}};
    auto reference =
        std::make_shared<const coach::Reference>(coach::make_reference("still", still));
    coach::CorrectionSolver solver(reference, still.skeleton);
    coach::CorrectionProblem problem;
    problem.learner = Pose(kJointCount);
    problem.velocity.fill(Eigen::Vector3d::Zero());
    problem.learner.q_PB[index(Joint::kLeftElbow)] =
        joint_rotation(Joint::kLeftElbow, {1.0, 0.0, 0.0});
    const auto result = solver.solve(problem);
    const bool good = result.status == coach::SolverStatus::kConverged ||
                      result.status == coach::SolverStatus::kDeadline;
    return {"solver (Ipopt)", good,
            good ? fmt::format("a correction takes {}", milliseconds(result.solve_time))
                 : "does not solve a simple posture: install coinor-libipopt1v5 again"};
  } catch (const std::exception& error) {
    return {"solver (Ipopt)", false, error.what()};
  }
}

Finding check_disk() {
  const fs::path folder = fs::current_path();
  std::error_code error;
  const auto space = fs::space(folder, error);
  constexpr std::uintmax_t kEnough = 200u << 20;  // an hour of poses and commands is about 150 MB
  if (error || ::access(folder.c_str(), W_OK) != 0) {
    return {
        "recordings", false,
        fmt::format("{} cannot be written: change folder or give --recording", folder.string())};
  }
  return {"recordings", space.available > kEnough,
          fmt::format("{} MB free in {}{}", space.available >> 20, folder.string(),
                      space.available > kEnough ? "" : ": free some for a session of an hour")};
}

struct Options {
  BusOptions bus;
  std::string port;
  fs::path repair;
  fs::path to;
  bool json = false;
};

void mend(const Options& options) {
  fs::path to = options.to;
  if (to.empty()) {
    to = options.repair;
    to.replace_extension(".repaired.mcap");
  }
  const auto saved = recording::repair(options.repair, to);
  fmt::print("saved {} messages into {}\n", saved, to.string());
}

void examine(const Options& options) {
  std::vector<Finding> findings{check_data(), check_references(),
                                check_bus(options.bus.configuration("secondskin_doctor"))};
  for (auto& finding : check_ports(options.port)) findings.push_back(std::move(finding));
  findings.push_back(check_solver());
  findings.push_back(check_disk());
  bool all_good = true;
  nlohmann::json all = nlohmann::json::array();
  for (const auto& finding : findings) {
    all_good = all_good && finding.good;
    all.push_back({{"subject", finding.subject}, {"good", finding.good}, {"words", finding.words}});
    if (!options.json) {
      fmt::print("{} {:<46} {}\n", finding.good ? "ok     " : "PROBLEM", finding.subject,
                 finding.words);
    }
  }
  if (options.json) fmt::print("{}\n", all.dump(2));
  if (!all_good) throw CLI::RuntimeError(1);
}

}  // namespace

void add_doctor(CLI::App& app) {
  auto options = std::make_shared<Options>();
  auto* command = app.add_subcommand("doctor", "find what keeps a session from running; repair");
  command->footer(
      "Example:  secondskin doctor --port /dev/ttyUSB0\n"
      "          secondskin doctor --repair torn.mcap");
  command->add_option("--port", options->port, "check this port (default: all that are attached)");
  command->add_option("--repair", options->repair, "make a whole recording of a damaged one")
      ->check(CLI::ExistingFile);
  command->add_option("--to", options->to, "with --repair: the file to make");
  command->add_flag("--json", options->json, "as JSON");
  add_bus_options(*command, options->bus);
  command->callback([options] {
    if (!options->repair.empty()) {
      mend(*options);
    } else {
      examine(*options);
    }
  });
}

}  // namespace secondskin::cli
