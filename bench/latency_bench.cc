// How long from a pose published to bytes at the tactor board's end, as one process and as several?
//
// The benchmark stands at both ends. It publishes a recorded learner's poses at 62.5 Hz, as the
// capture server does, each stamped as it is published; it reads the topic `tactors`, for the time
// at which the coach published each frame's command; and it holds the pseudo-terminal that the
// driver takes for its board. A frame's first byte is the first pair read after its command was
// published that sets a slot to a value in which that command differs from the one before; so only
// frames whose command changed have one. Narrow tolerances and many cues make it change often.
// docs/benchmarks.md quotes the output.

#include <fmt/core.h>
#include <poll.h>
#include <spdlog/spdlog.h>

#include <CLI/CLI.hpp>
#include <cmath>
#include <limits>
#include <map>
#include <mutex>
#include <nlohmann/json.hpp>
#include <optional>
#include <thread>

#include "bench/live_session.h"
#include "bus/pose_messages.h"
#include "bus/reader.h"
#include "bus/wait_set.h"
#include "bus/writer.h"
#include "clients/recorder/recorder_service.h"
#include "clients/tactor_driver/guardian.h"
#include "clients/tactor_driver/tactor_service.h"
#include "coach/coach_service.h"
#include "wire/pseudo_terminal.h"

namespace {

using namespace secondskin;
using namespace std::chrono_literals;
namespace msg = bus::msg;

struct Options {
  std::string reference = "low_block";
  std::size_t frames = 5000;
  std::size_t warm_up = 125;
  double tolerance_scale = 0.1;
  std::uint32_t max_cues = 16;
  std::uint32_t domain = 10 + static_cast<std::uint32_t>(::getpid()) % 90;
};

/// A command as it was heard on the topic.
struct HeardCommand {
  std::uint64_t frame;
  std::int64_t stamp_ns, publish_ns, heard_ns;
  wire::BoardState intensities;
};

/// A pair of bytes as it was read at the board's end.
struct ReadPair {
  std::int64_t read_ns;
  wire::Command command;
};

/// The far end of the driver's port.
class BoardEnd {
 public:
  BoardEnd() : thread_([this](std::stop_token stop) { read(stop); }) {}
  std::string port() const { return terminal_.path(); }
  std::vector<ReadPair> pairs() {
    thread_.request_stop();
    thread_.join();
    return std::move(pairs_);
  }
  /// Whether a driver has switched everything off, which is how it begins.
  bool met() const { return count_ >= wire::kSlotCount; }

 private:
  void read(std::stop_token stop) {
    wire::CommandParser parser;
    std::array<std::uint8_t, 256> bytes;
    while (!stop.stop_requested()) {
      pollfd news{terminal_.fd(), POLLIN, 0};
      if (::poll(&news, 1, 100) <= 0) continue;
      const std::size_t count = terminal_.read_some(bytes);
      const std::int64_t now = bus::now_ns();
      for (std::size_t i = 0; i < count; ++i) {
        const auto pair = parser.push(bytes[i], static_cast<double>(now) * 1e-9);
        if (pair) pairs_.push_back({now, *pair}), ++count_;
      }
    }
  }

  wire::PseudoTerminal terminal_;
  std::vector<ReadPair> pairs_;
  std::atomic<std::size_t> count_{0};
  std::jthread thread_;
};

/// What the machine itself takes meanwhile: a byte through another pseudo-terminal, from one thread
/// of the benchmark to another, midway between two frames.
class Control {
 public:
  Control()
      : fd_(::open(terminal_.path().c_str(), O_WRONLY | O_NOCTTY | O_CLOEXEC)),
        thread_([this](std::stop_token stop) { read(stop); }) {
    if (fd_ < 0) throw std::runtime_error("the control's pseudo-terminal cannot be opened");
  }
  ~Control() {
    thread_.request_stop();
    thread_.join();
    ::close(fd_);
  }
  void write() {
    const std::uint8_t byte = 0;
    written_ns_ = bus::now_ns();
    if (::write(fd_, &byte, 1) != 1) written_ns_ = 0;
  }
  std::vector<double> took() {
    const std::lock_guard lock(mutex_);
    return took_;
  }

 private:
  void read(std::stop_token stop) {
    std::array<std::uint8_t, 16> bytes;
    while (!stop.stop_requested()) {
      pollfd news{terminal_.fd(), POLLIN, 0};
      if (::poll(&news, 1, 100) <= 0 || terminal_.read_some(bytes) == 0) continue;
      const std::int64_t now = bus::now_ns();
      const std::lock_guard lock(mutex_);
      took_.push_back(static_cast<double>(now - written_ns_) * 1e-9);
    }
  }

  wire::PseudoTerminal terminal_;
  int fd_;
  std::atomic<std::int64_t> written_ns_{0};
  std::mutex mutex_;
  std::vector<double> took_;
  std::jthread thread_;
};

/// Listens to what the coach commands and the driver says of itself.
class Listener {
 public:
  explicit Listener(bus::Participant& participant)
      : commands_(participant, bus::Want::kEvery), health_(participant, bus::Want::kEvery) {
    news_.attach(commands_);
    news_.attach(health_);
    thread_ = std::jthread([this](std::stop_token stop) { listen(stop); });
  }
  void finish() {
    thread_.request_stop();
    thread_.join();
  }

  std::vector<HeardCommand> heard;
  /// The driver's count of each second: from a pose's stamp to its bytes written [s].
  std::vector<double> written_p50, written_p99;
  std::atomic<std::int64_t> count_from_ns{std::numeric_limits<std::int64_t>::max()};

 private:
  void listen(std::stop_token stop) {
    const std::stop_callback wake(stop, [this] { news_.wake(); });
    msg::TactorCommand command;
    msg::ServiceHealth health;
    while (!stop.stop_requested()) {
      news_.wait(1s);
      while (commands_.take(command)) {
        const auto& header = command.header();
        heard.push_back({header.frame(), header.stamp_ns(), header.publish_ns(), bus::now_ns(),
                         command.intensities()});
      }
      while (health_.take(health)) {
        if (health.service() != "tactors") continue;
        // A second that began before the counted frames, or one after them, does not count.
        if (health.publish_ns() < count_from_ns + 1'000'000'000 || health.rate_hz() < 1.0) continue;
        written_p50.push_back(health.latency_p50());
        written_p99.push_back(health.latency_p99());
      }
    }
  }

  bus::Reader<msg::TactorCommand> commands_;
  bus::Reader<msg::ServiceHealth> health_;
  bus::WaitSet news_;
  std::jthread thread_;
};

/// Coach, tactor driver and recorder, in whichever way.
class Services {
 public:
  virtual ~Services() = default;
  virtual void end() = 0;
};

class Threads final : public Services {
 public:
  Threads(bus::Participant& participant, const Options& options, const std::string& port,
          const std::string& recording)
      : recorder_(participant, {recording, bench::kRoot / "idl" / "secondskin_msgs.idl"}),
        tactors_(participant, {port}),
        coach_(participant, coach_options(options)) {
    threads_.emplace_back([this](std::stop_token stop) { recorder_.run(stop); });
    threads_.emplace_back([this](std::stop_token stop) { tactors_.run(stop); });
    threads_.emplace_back([this](std::stop_token stop) { coach_.run(stop); });
  }
  void end() override {
    while (!threads_.empty()) threads_.pop_back();
  }

 private:
  static coach::CoachServiceOptions coach_options(const Options& options) {
    coach::CoachServiceOptions result;
    result.references = {std::make_shared<const coach::Reference>(coach::load_reference(
        bench::kRoot / "reference_motions" / options.reference, bench::kRoot / "joint_maps"))};
    result.body_map = coach::BodyMap::load(bench::kRoot / "body_maps" / "full_body.toml");
    result.settings = {options.tolerance_scale, options.max_cues};
    return result;
  }

  recorder::RecorderService recorder_;
  tactor_driver::TactorService tactors_;
  coach::CoachService coach_;
  std::vector<std::jthread> threads_;
};

class Processes final : public Services {
 public:
  Processes(const Options& options, const std::string& subject, const std::string& port,
            const bench::Folder& folder) {
    const auto start = [&](std::vector<std::string> arguments) {
      const std::string log = folder / (arguments.front() + ".log");
      arguments.insert(arguments.end(),
                       {"--domain", std::to_string(options.domain), "--subject", subject});
      programs_.emplace_back(std::move(arguments), log);
    };
    start({"record", folder / "processes.mcap"});
    start({"tactors", "--port", port});
    start({"coach", "--reference", options.reference, "--tolerance-scale",
           std::to_string(options.tolerance_scale), "--max-cues",
           std::to_string(options.max_cues)});
  }
  void end() override {
    while (!programs_.empty()) {
      spdlog::debug("{}", programs_.back().end());
      programs_.pop_back();
    }
  }

 private:
  std::vector<bench::Program> programs_;
};

/// A first byte this long after its command was held up [s].
constexpr double kLate = 0.003;

/// One row: latencies of many frames [s].
struct Stage {
  std::string name;
  std::vector<double> values = {};
};

struct Result {
  std::string name;
  std::size_t frames = 0, without_command = 0, changed = 0, without_bytes = 0;
  std::vector<Stage> stages;
  double driver_p50 = 0.0, driver_worst = 0.0;
  double start_up_worst = 0.0;  ///< pose to command among the warm-up's frames [s]
};

/// What each frame's latencies were.
void analyse(const std::vector<std::int64_t>& stamps, std::size_t warm_up,
             const std::vector<HeardCommand>& heard, const std::vector<ReadPair>& pairs,
             Result& result) {
  constexpr auto kNever = std::numeric_limits<std::int64_t>::max();
  const auto seconds = [](std::int64_t ns) { return static_cast<double>(ns) * 1e-9; };
  Stage to_command{"pose published -> command published"};
  Stage to_listener{"command published -> at a subscriber"};
  Stage to_first_byte{"command published -> its first byte at the board"};
  Stage first_byte{"pose published -> first byte at the board"};
  Stage last_byte{"pose published -> last byte at the board"};

  // When each slot was read as each value, and when each slot's command changed.
  std::array<std::vector<ReadPair>, wire::kSlotCount> read;
  for (const ReadPair& pair : pairs) read[pair.command.slot].push_back(pair);
  std::array<std::vector<std::size_t>, wire::kSlotCount> changes;
  for (std::size_t k = 1; k < heard.size(); ++k) {
    for (std::size_t slot = 0; slot < wire::kSlotCount; ++slot) {
      if (heard[k].intensities[slot] != heard[k - 1].intensities[slot]) changes[slot].push_back(k);
    }
  }
  std::vector<std::int64_t> first(heard.size(), kNever), last(heard.size(), 0);
  std::vector<bool> changed(heard.size(), false);
  for (std::size_t slot = 0; slot < wire::kSlotCount; ++slot) {
    std::size_t p = 0;
    for (std::size_t c = 0; c < changes[slot].size(); ++c) {
      const std::size_t k = changes[slot][c];
      changed[k] = true;
      while (p < read[slot].size() && read[slot][p].read_ns < heard[k].publish_ns) ++p;
      // Until the slot is commanded otherwise; bytes still under way then carry the old value.
      const auto until =
          c + 1 < changes[slot].size() ? heard[changes[slot][c + 1]].publish_ns : kNever;
      for (std::size_t i = p; i < read[slot].size() && read[slot][i].read_ns < until; ++i) {
        if (read[slot][i].command.intensity != heard[k].intensities[slot]) continue;
        first[k] = std::min(first[k], read[slot][i].read_ns);
        last[k] = std::max(last[k], read[slot][i].read_ns);
        break;
      }
    }
  }

  std::map<std::uint64_t, std::size_t> by_frame;  // the first; an all-off repeats its frame
  for (std::size_t k = 0; k < heard.size(); ++k) by_frame.emplace(heard[k].frame, k);
  for (std::size_t i = 0; i < stamps.size(); ++i) {
    const auto found = by_frame.find(i + 1);
    if (i < warm_up) {
      if (found != by_frame.end()) {
        const auto& command = heard[found->second];
        result.start_up_worst =
            std::max(result.start_up_worst, seconds(command.publish_ns - command.stamp_ns));
      }
      continue;
    }
    ++result.frames;
    if (found == by_frame.end()) {
      ++result.without_command;
      continue;
    }
    const std::size_t k = found->second;
    to_command.values.push_back(seconds(heard[k].publish_ns - stamps[i]));
    to_listener.values.push_back(seconds(heard[k].heard_ns - heard[k].publish_ns));
    if (!changed[k]) continue;
    ++result.changed;
    if (first[k] == kNever) {
      ++result.without_bytes;
      continue;
    }
    const double wait = seconds(first[k] - heard[k].publish_ns);
    if (wait > kLate) {
      const auto other = std::count_if(pairs.begin(), pairs.end(), [&](const ReadPair& pair) {
        return pair.read_ns >= heard[k].publish_ns && pair.read_ns < first[k];
      });
      spdlog::debug("frame {}: first byte {:.1f} ms after the command, {} other pairs before it",
                    heard[k].frame, 1e3 * wait, other);
    }
    to_first_byte.values.push_back(wait);
    first_byte.values.push_back(seconds(first[k] - stamps[i]));
    last_byte.values.push_back(seconds(last[k] - stamps[i]));
  }
  result.stages = {to_command, to_listener, to_first_byte, first_byte, last_byte};
}

template <class Condition>
void wait_until(Condition done, const char* for_what) {
  const auto end = std::chrono::steady_clock::now() + 20s;
  while (!done()) {
    if (std::chrono::steady_clock::now() > end) {
      throw std::runtime_error(fmt::format("{} did not come", for_what));
    }
    std::this_thread::sleep_for(5ms);
  }
}

Result run(const Options& options, const Motion& learner, bool as_processes) {
  Result result;
  result.name = as_processes ? "as separate processes" : "as one process";
  const std::string subject = fmt::format("bench_{}_{}", ::getpid(), as_processes ? 2 : 1);
  const bench::Folder folder;
  BoardEnd board;
  bus::Participant participant({.subject = subject,
                                .domain = options.domain,
                                .qos_file = bench::kRoot / "idl" / "qos.xml",
                                .name = "secondskin_latency_bench"});
  Listener listener(participant);
  bus::Reader<msg::SessionState> states(participant);
  bus::Writer<msg::SkeletonPose> poses(participant);
  bus::Writer<msg::SkeletonDefinition> skeletons(participant);
  msg::SkeletonDefinition definition;
  bus::to_message(learner.skeleton, "latency_bench", bench::kRate, definition);
  skeletons.write(definition);

  std::unique_ptr<Services> services;
  if (as_processes) {
    services = std::make_unique<Processes>(options, subject, board.port(), folder);
  } else {
    services =
        std::make_unique<Threads>(participant, options, board.port(), folder / "threads.mcap");
  }
  msg::SessionState state;
  wait_until([&] { return states.take(state) && state.phase() == msg::SESSION_RUNNING; },
             "the session");
  wait_until([&] { return poses.counts().readers >= 2; }, "coach and recorder");
  wait_until([&] { return board.met(); }, "the tactor driver");

  Control control;
  std::vector<std::int64_t> stamps;
  stamps.reserve(options.warm_up + options.frames);
  const std::uint32_t id = bus::skeleton_id(learner.skeleton);
  StampedPose pose;
  msg::SkeletonPose message;
  const auto start = std::chrono::steady_clock::now() + 16ms;
  for (std::size_t i = 0; i < options.warm_up + options.frames; ++i) {
    pose.pose = learner.poses[i % learner.poses.size()];
    pose.frame = i + 1;
    bus::to_message(pose, id, message);
    std::this_thread::sleep_until(start + i * 16ms);
    const std::int64_t now = bus::now_ns();
    if (i == options.warm_up) listener.count_from_ns = now;
    message.header().stamp_ns(now);
    message.header().publish_ns(now);
    poses.write(message);
    stamps.push_back(now);
    if (i < options.warm_up) continue;
    std::this_thread::sleep_until(start + i * 16ms + 8ms);
    control.write();
  }
  std::this_thread::sleep_for(100ms);  // the last command
  listener.finish();
  services->end();
  analyse(stamps, options.warm_up, listener.heard, board.pairs(), result);
  result.stages.push_back({"control: a byte through a pseudo-terminal alone", control.took()});
  result.driver_p50 = bench::quantile(listener.written_p50, 0.5);
  result.driver_worst = bench::quantile(listener.written_p99, 1.0);
  return result;
}

void print(const Result& r) {
  fmt::print("{}: {} frames, {} without a command; {} commands changed, {} of them without bytes\n",
             r.name, r.frames, r.without_command, r.changed, r.without_bytes);
  fmt::print("{:<50} {:>6} {:>7} {:>7} {:>7}   ms\n", "", "count", "p50", "p99", "max");
  const auto row = [](const Stage& s) {
    fmt::print("{:<50} {:>6} {:>7.2f} {:>7.2f} {:>7.2f}\n", s.name, s.values.size(),
               1e3 * bench::quantile(s.values, 0.5), 1e3 * bench::quantile(s.values, 0.99),
               1e3 * bench::quantile(s.values, 1.0));
  };
  for (const Stage& stage : r.stages) row(stage);
  fmt::print("{:<50} {:>6} {:>7.2f} {:>7} {:>7.2f}\n",
             "pose published -> written, by the driver's count", "", 1e3 * r.driver_p50, "-",
             1e3 * r.driver_worst);
  fmt::print("{:<50} {:>6} {:>7} {:>7} {:>7.2f}\n\n",
             "start-up (not counted): pose -> command published", "", "", "",
             1e3 * r.start_up_worst);
}

nlohmann::json json_of(const Result& r) {
  nlohmann::json out{
      {"name", r.name},
      {"frames", r.frames},
      {"without_command", r.without_command},
      {"changed", r.changed},
      {"without_bytes", r.without_bytes},
      {"driver_written_ms", {{"p50", 1e3 * r.driver_p50}, {"max", 1e3 * r.driver_worst}}},
      {"start_up_max_ms", 1e3 * r.start_up_worst}};
  for (const Stage& s : r.stages) {
    out["stages_ms"].push_back({{"name", s.name},
                                {"count", s.values.size()},
                                {"p50", 1e3 * bench::quantile(s.values, 0.5)},
                                {"p99", 1e3 * bench::quantile(s.values, 0.99)},
                                {"max", 1e3 * bench::quantile(s.values, 1.0)}});
  }
  return out;
}

int measure(int argc, char** argv) {
  CLI::App app{"Latency from a pose published to bytes at the tactor board's end, at 62.5 Hz"};
  Options options;
  std::string as = "both";
  bool json = false, verbose = false;
  app.add_option("--frames", options.frames, "counted, each way")->capture_default_str();
  app.add_option("--warm-up", options.warm_up, "frames before them")->capture_default_str();
  app.add_option("--as", as, "one process, separate processes, or both")
      ->check(CLI::IsMember({"one", "processes", "both"}))
      ->capture_default_str();
  app.add_option("--reference", options.reference)->capture_default_str();
  app.add_option("--tolerance-scale", options.tolerance_scale)->capture_default_str();
  app.add_option("--max-cues", options.max_cues)->capture_default_str();
  app.add_option("--domain", options.domain)->capture_default_str();
  app.add_flag("-v,--verbose", verbose, "what the programs say");
  app.add_flag("--json", json);
  CLI11_PARSE(app, argc, argv);
  spdlog::set_level(verbose ? spdlog::level::debug : spdlog::level::warn);

  const Motion learner = bench::learner_of(options.reference);
  nlohmann::json out = nlohmann::json::array();
  for (const bool as_processes : {false, true}) {
    if (as == (as_processes ? "one" : "processes")) continue;
    const Result result = run(options, learner, as_processes);
    if (json) {
      out.push_back(json_of(result));
    } else {
      print(result);
    }
  }
  if (json) fmt::print("{}\n", out.dump(2));
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  // The tactor driver's guardian is this program again.
  if (argc == 4 && std::string_view(argv[1]) == tactor_driver::kGuardianCommand) {
    return tactor_driver::guardian_main(std::atoi(argv[3]));
  }
  try {
    return measure(argc, argv);
  } catch (const std::exception& error) {
    fmt::print(stderr, "latency_bench: {}\n", error.what());
    return 1;
  }
}
