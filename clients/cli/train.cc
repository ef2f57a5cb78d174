#include <fmt/format.h>
#include <poll.h>
#include <spdlog/spdlog.h>
#include <termios.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <mutex>
#include <numeric>

#include "bus/reader.h"
#include "bus/wait_set.h"
#include "bus/writer.h"
#include "clients/cli/common.h"
#include "clients/cli/dashboard_options.h"
#include "clients/cli/tactile_options.h"
#include "clients/recorder/recorder_service.h"
#include "clients/tactor_driver/tactor_service.h"
#include "coach/coach_service.h"
#include "server/capture_service.h"
#include "server/open_source.h"
#include "sim/board/virtual_board_runner.h"

/// A whole session in one process: the same services as the separate commands, over the same
/// topics.
namespace secondskin::cli {
namespace {

namespace msg = bus::msg;
using namespace std::chrono_literals;

constexpr const char* kVirtualPort = "virtual";
constexpr auto kLongestStart = 20s;
constexpr auto kLongestDiscovery = 5s;
// All of bus::kTopics but points and raw, which only an optical system has.
constexpr std::size_t kTopicsOfASession = 11;
constexpr std::size_t kTopicsOfAnOpticalSession = 13;
// For the last pose to reach the coach, and its words the recorder.
constexpr auto kLastPose = 150ms;

struct TrainOptions {
  BusOptions bus;
  SourceOptions from;
  std::string reference = kDefaultReference;
  std::string learner;
  std::string port = kVirtualPort;
  unsigned baud_rate = 115'200;
  std::string body_map = "full_body";
  coach::CoachSettings settings;
  TactileOptions tactile;
  std::string plan;
  std::filesystem::path recording;
  PageOptions page;
  bool loop = false;
  double speed = 1.0;
};

/// What the live line shows, handed from the coach's thread to the terminal's. The coach never
/// waits for it.
struct LiveLine {
  std::mutex mutex;
  double reference_time = 0.0, duration = 0.0;
  double tempo = 0.0;
  coach::Phase phase = coach::Phase::kWaiting;
  std::uint32_t repetition = 0;
  std::string worst;
  double worst_error = 0.0;
  wire::BoardState tactors{};
  std::vector<coach::Cue> cues;
  double latency = 0.0;

  void take(const coach::CoachFrame& frame) {
    const std::unique_lock lock(mutex, std::try_to_lock);
    if (!lock) return;
    const auto& out = frame.output;
    const coach::Reference& reference = frame.reference;
    duration = reference.motion.duration();
    reference_time = out.alignment.reference_time;
    tempo = out.alignment.tempo;
    phase = out.alignment.phase;
    repetition = out.alignment.repetition;
    std::size_t joint = 0;
    for (std::size_t j = 1; j < kJointCount; ++j) {
      const auto rank = [&](std::size_t k) { return reference.weight[k] * out.error[k].norm(); };
      if (rank(j) > rank(joint)) joint = j;
    }
    worst = joint_name(static_cast<Joint>(joint));
    worst_error = out.error[joint].norm();
    tactors = out.tactors;
    cues.assign(frame.cues.begin(), frame.cues.end());
    latency = static_cast<double>(bus::now_ns() - frame.pose.stamp_ns) * 1e-9;
  }
};

std::string words(const coach::Cue& cue) {
  const auto movement = cue.movement;
  const char* direction = "";
  switch (movement) {
    case Movement::kFlexion:
      direction = cue.positive ? "flex" : "extend";
      break;
    case Movement::kAbduction:
      direction = cue.positive ? "abduct" : "adduct";
      break;
    case Movement::kRotation:
      direction = cue.positive ? "turn in" : "turn out";
      break;
  }
  if (movement == Movement::kRotation &&
      (cue.joint == Joint::kLeftElbow || cue.joint == Joint::kRightElbow)) {
    direction = cue.positive ? "pronate" : "supinate";
  }
  std::string joint(joint_name(cue.joint));
  std::replace(joint.begin(), joint.end(), '_', ' ');
  return fmt::format("{} {}", direction, joint);
}

/// The terminal while a session runs: a line that lives, and keys.
class Terminal {
 public:
  static bool is_there() { return ::isatty(STDIN_FILENO) != 0 && ::isatty(STDOUT_FILENO) != 0; }
  Terminal() : tty_(is_there()) {
    if (!tty_) return;
    ::tcgetattr(STDIN_FILENO, &before_);
    termios raw = before_;
    raw.c_lflag &= ~static_cast<tcflag_t>(ICANON | ECHO);
    ::tcsetattr(STDIN_FILENO, TCSANOW, &raw);
    fmt::print("keys: s stop all vibration (again: lift), p pause, q quit\n");
  }
  ~Terminal() {
    if (!tty_) return;
    ::tcsetattr(STDIN_FILENO, TCSANOW, &before_);
    fmt::print("\r\x1b[K");
    std::fflush(stdout);
  }
  bool is_tty() const { return tty_; }

  /// Waits a tenth of a second for a key. @returns 0 for none
  char key() const {
    pollfd input{STDIN_FILENO, POLLIN, 0};
    char c = 0;
    if (::poll(&input, 1, 100) > 0 && ::read(STDIN_FILENO, &c, 1) == 1) return c;
    return 0;
  }

  static void show(LiveLine& live, const std::string& block, bool stopped, bool paused) {
    static constexpr const char* kPhases[] = {"waiting", "moving", "paused", "finished", "lost"};
    const std::lock_guard lock(live.mutex);
    const bool following =
        live.phase == coach::Phase::kMoving || live.phase == coach::Phase::kPaused;
    const std::string worst =
        following ? fmt::format("worst {} {:.0f} deg", live.worst, deg(live.worst_error)) : "";
    std::string cues;
    for (const auto& cue : live.cues) {
      cues += fmt::format("{}{}", cues.empty() ? "" : ", ", words(cue));
    }
    const auto line = fmt::format(
        "{}{:5.2f}/{:.2f} s  x{:.2f}  {:<8} rep {}  {:<27} [{}]  {:.1f} ms{}", block,
        live.reference_time, live.duration, live.tempo, kPhases[static_cast<int>(live.phase)],
        live.repetition, worst, cues.empty() ? "no cue" : cues, live.latency * 1e3,
        stopped  ? "  STOPPED"
        : paused ? "  PAUSED"
                 : "");
    fmt::print("\r\x1b[K{:.140}", line);
    std::fflush(stdout);
  }

 private:
  bool tty_;
  termios before_{};
};

void print_summary(const coach::CoachSummary& coach, const coach::Reference& reference,
                   const tactor_driver::TactorSummary& tactors,
                   const server::CaptureCounts& capture, const recorder::RecorderCounts& recording,
                   const std::filesystem::path& file, bool with_plan) {
  fmt::print("\nSession: {} poses, {} coached, {} lost\n", capture.published, coach.frames,
             coach.lost);
  fmt::print("Reference: {} ({:.1f} s)\n", reference.name, reference.motion.duration());
  if (coach.repetitions.empty()) fmt::print("No repetition was completed.\n");
  for (const auto& score : coach.repetitions) {
    std::array<std::size_t, kJointCount> order{};
    std::iota(order.begin(), order.end(), 0u);
    const auto rank = [&](std::size_t j) { return reference.weight[j] * score.joints[j].rms; };
    std::sort(order.begin(), order.end(), [&](auto a, auto b) { return rank(a) > rank(b); });
    fmt::print("  repetition {}: score {:5.1f}  ({:.1f} s, {} cues)  worst:", score.repetition,
               score.total, static_cast<double>(score.end_ns - score.start_ns) * 1e-9, score.cues);
    for (std::size_t k = 0; k < 3; ++k) {
      fmt::print(" {} {:.0f} deg rms{}", joint_name(static_cast<Joint>(order[k])),
                 deg(score.joints[order[k]].rms), k < 2 ? "," : "\n");
    }
  }
  if (with_plan) print_blocks(coach);
  fmt::print("Cues: {} given", coach.cues);
  std::array<std::size_t, kJointCount> order{};
  std::iota(order.begin(), order.end(), 0u);
  std::sort(order.begin(), order.end(),
            [&](auto a, auto b) { return coach.cues_by_joint[a] > coach.cues_by_joint[b]; });
  const char* separator = " (";
  for (std::size_t k = 0; k < 5 && coach.cues_by_joint[order[k]] > 0; ++k) {
    fmt::print("{}{} {}", separator, joint_name(static_cast<Joint>(order[k])),
               coach.cues_by_joint[order[k]]);
    separator = ", ";
  }
  fmt::print("{}; {} commands to the board\n", *separator == ',' ? ")" : "",
             tactors.counters.pairs);
  fmt::print("Solver: {} corrections, {} by the closed form, {:.2f} s of processor time\n",
             coach.corrections, coach.fallbacks, coach.solver_cpu);
  if (tactors.counters.connections == 0) {
    fmt::print("Board: NEVER REACHED: {}\n", tactors.port_trouble);
  }
  fmt::print("Latency from measured pose to board: p50 {}, p99 {}, max {}\n",
             milliseconds(tactors.latency.quantile(0.5)),
             milliseconds(tactors.latency.quantile(0.99)), milliseconds(tactors.latency.max()));
  if (recording.error.empty()) {
    fmt::print("Recording: {} ({} messages)\n", file.string(), recording.messages);
  } else {
    fmt::print("Recording: ended early, {}; {} messages are in {}\n", recording.error,
               recording.messages, file.string());
  }
}

/// Where the session is in its plan; nothing without one.
std::string block_words(const msg::SessionState& state) {
  if (state.plan().size() == 0) return {};
  return fmt::format("{} {}/{}{}  ", state.block_name().to_string(), state.block_repetitions(),
                     state.block_planned(), state.resting() ? " after a rest" : "");
}

/// The page of the session; none when nobody wants it, and none when its port is taken: the session
/// is worth more.
std::unique_ptr<dashboard::DashboardService> serve_page(
    bus::Participant& participant, const TrainOptions& options, const Library& library,
    std::shared_ptr<const coach::Reference> reference, const std::optional<TakeRecording>& takes) {
  std::unique_ptr<dashboard::DashboardService> page;
  if (!takes) return page;
  PageOptions with = options.page;
  if (options.recording.has_parent_path()) with.recordings = options.recording.parent_path();
  auto prepared = with.prepare(options.bus.config.subject, library, {std::move(reference)});
  prepared.handlers.push_back(takes->handler());
  try {
    page = std::make_unique<dashboard::DashboardService>(participant, prepared);
    fmt::print("Dashboard: {}\n", page_address(prepared, page->port()));
    std::fflush(stdout);
  } catch (const std::runtime_error& error) {
    spdlog::warn("no page for this session: {}", error.what());
  }
  return page;
}

/// Waits until the coach says over the bus that a session runs.
void wait_for_session(bus::Reader<msg::SessionState>& states, std::stop_token stop) {
  bus::WaitSet news;
  news.attach(states);
  const std::stop_callback wake(stop, [&news] { news.wake(); });
  const auto end = std::chrono::steady_clock::now() + kLongestStart;
  msg::SessionState state;
  while (!stop.stop_requested()) {
    while (states.take(state)) {
      if (state.phase() == msg::SESSION_RUNNING) return;
    }
    const auto now = std::chrono::steady_clock::now();
    if (now > end) {
      throw std::runtime_error("the coach did not start a session; see 'secondskin doctor'");
    }
    news.wait(end - now);
  }
}

void train(TrainOptions& options) {
  StopOnSignal signals;
  const Library library;
  auto reference = library.load_reference(options.reference);
  if (options.learner.empty()) {
    const auto folder = library.find_references(options.reference).front();
    options.learner = (folder / "learner.bvh").string();
    if (!std::filesystem::exists(options.learner)) {
      throw std::runtime_error(
          fmt::format("reference '{}' comes with no learner's recording; give one with --learner",
                      options.reference));
    }
  }
  auto source = options.from.open(options.learner, library);
  if (!wait_for_body(*source, options.learner, signals.token())) return;
  coach::CoachServiceOptions coach_options;
  // What it begins with comes first; the others can be chosen by session commands.
  coach_options.references = library.load_references();
  std::erase_if(coach_options.references,
                [&](const auto& r) { return r->name == reference->name; });
  coach_options.references.insert(coach_options.references.begin(), reference);
  library.answer_commands(coach_options);
  coach_options.body_map = library.load_body_map(options.body_map);
  coach_options.settings = options.settings;
  coach_options.plan = library.load_plan(options.plan);
  coach_options.tactile = options.tactile.prepare(coach_options.body_map);
  const coach::BodyMap body_map = coach_options.body_map;
  if (options.recording.empty()) options.recording = default_recording_name(reference->name);

  // Each part on its own thread; leaving this function in any way stops and joins them, the board
  // last.
  std::optional<wire::PseudoTerminal> terminal;
  std::optional<sim::VirtualBoardRunner> board;
  std::jthread board_thread;
  if (options.port == kVirtualPort) {
    terminal.emplace();
    board.emplace(*terminal);
    board_thread = std::jthread([&board](std::stop_token stop) { board->run(stop); });
    options.port = terminal->path();
  }

  bus::Participant participant(options.bus.configuration("secondskin_train"));
  const OpticalOutputs optical(participant, *source);
  const WearableOutputs wearable(participant, *source);

  tactor_driver::TactorService tactors(participant, {options.port, options.baud_rate});
  coach::CoachService coach(participant, std::move(coach_options));
  recorder::RecorderService recorder(participant, {options.recording, library.idl()});
  bus::Reader<msg::SessionState> states(participant);
  bus::Writer<msg::SessionCommand> orders(participant);
  bus::Writer<msg::EmergencyStop> stops(participant);

  LiveLine live;
  std::stop_source plan_over;
  // At a terminal the session goes on until somebody ends it: the page can start another.
  const bool interactive = Terminal::is_there();
  coach.on_end([&] {
    if (!interactive) plan_over.request_stop();
  });
  coach.on_frame([&](const coach::CoachFrame& frame) { live.take(frame); });

  recorder::RecorderCounts recording;
  tactor_driver::TactorSummary tactor_summary;
  coach::CoachSummary coach_summary;
  server::CaptureCounts capture_counts;
  SessionHistory history(participant, options.page, library);  // hears the session from its start
  std::optional<TakeRecording> takes;
  if (options.page.port != 0) takes.emplace(participant, library);
  const auto page = serve_page(participant, options, library, reference, takes);
  std::jthread page_thread;
  if (page) page_thread = std::jthread([&page](std::stop_token stop) { page->run(stop); });
  std::jthread recorder_thread([&](std::stop_token stop) { recording = recorder.run(stop); });
  std::jthread tactor_thread([&](std::stop_token stop) { tactor_summary = tactors.run(stop); });
  std::jthread coach_thread([&](std::stop_token stop) { coach_summary = coach.run(stop); });

  // Readers beside the server's own: coach and recorder, and that of takes.
  server::CaptureService capture(participant, *source,
                                 {.source_name = options.learner,
                                  .speed = options.speed,
                                  .loop = options.loop || interactive,
                                  .wait_for_readers = takes ? 3U : 2U});
  wait_for_session(states, signals.token());
  if (!recorder.wait_until_heard(
          optical_of(*source) != nullptr ? kTopicsOfAnOpticalSession : kTopicsOfASession,
          kLongestDiscovery)) {
    spdlog::warn("the recorder does not hear every topic yet; the first moments may be missing");
  }

  fmt::print("Training '{}' with learner {} on {}\n", reference->name, options.learner,
             board ? fmt::format("a virtual board ({})", options.port) : options.port);
  std::atomic<bool> ended = false;
  {
    std::jthread capture_thread([&](std::stop_token stop) {
      capture_counts = capture.run(stop);
      ended = true;
    });
    const auto stop_capture = [&] { capture_thread.request_stop(); };
    const std::stop_callback end_capture(signals.token(), stop_capture);
    const std::stop_callback end_of_plan(plan_over.get_token(), stop_capture);
    Terminal screen;
    bool stopped = false, paused = false;
    std::string block;
    msg::SessionState state;
    while (screen.is_tty() && !ended) {
      while (states.take(state)) block = block_words(state);
      Terminal::show(live, block, stopped, paused);
      const char key = screen.key();
      if (key == 'q') capture_thread.request_stop();
      if (key == 's') {
        stopped = !stopped;
        msg::EmergencyStop stop;
        stop.publish_ns(bus::now_ns());
        stop.active(stopped);
        stop.reason("key in the terminal");
        stops.write(stop);
      }
      if (key == 'p') {
        paused = !paused;
        msg::SessionCommand order;
        order.publish_ns(bus::now_ns());
        order.action(paused ? msg::SESSION_PAUSE : msg::SESSION_RESUME);
        orders.write(order);
      }
    }
    capture_thread.join();
  }
  std::this_thread::sleep_for(kLastPose);
  coach_thread.request_stop();
  coach_thread.join();
  tactor_thread.request_stop();
  tactor_thread.join();
  options.tactile.keep(body_map, coach_summary.exposure);
  recorder_thread.request_stop();
  recorder_thread.join();
  history.end();
  print_summary(coach_summary, *reference, tactor_summary, capture_counts, recording,
                options.recording, !options.plan.empty());
  if (!recording.error.empty()) throw std::runtime_error(recording.error);
  if (tactor_summary.counters.connections == 0)
    throw std::runtime_error(tactor_summary.port_trouble);
}

}  // namespace

void add_train(CLI::App& app) {
  auto options = std::make_shared<TrainOptions>();
  auto* command = app.add_subcommand("train", "run a whole session in one process");
  command->footer(
      "Example:  secondskin train --reference squat --learner my_squats.bvh --port /dev/ttyUSB0\n"
      "          secondskin train --plan slow_first --loop\n"
      "Without --learner a recorded learner that comes with the reference moves; without --port a\n"
      "virtual board vibrates.");
  command
      ->add_option(
          "--reference", options->reference,
          "name under reference_motions/, a folder or a motion file; given more than once: "
          "several performances of one motion")
      ->join(kPerformances)
      ->capture_default_str();
  command->add_option("--learner", options->learner, "source of the learner's poses");
  command->add_option("--port", options->port, "the tactor board's serial port, or 'virtual'")
      ->capture_default_str();
  command->add_option("--baud", options->baud_rate, "baud rate")->capture_default_str();
  command->add_option("--body-map", options->body_map, "where the tactors sit: name or .toml file")
      ->capture_default_str();
  add_cue_options(*command, options->settings);
  command->add_option("--recording", options->recording,
                      "the file to record into (default: recordings/DATE_REFERENCE.mcap)");
  command->add_option("--speed", options->speed, "play the learner so many times as fast")
      ->check(CLI::Range(0.01, 100.0))
      ->capture_default_str();
  command->add_flag("--loop", options->loop,
                    "start the learner again at the end (at a terminal always)");
  add_plan_option(*command, options->plan);
  add_page_options(*command, options->page, "--dashboard-port");
  add_source_options(*command, options->from);
  add_tactile_options(*command, options->tactile);
  add_bus_options(*command, options->bus);
  command->callback([options] { train(*options); });
}

}  // namespace secondskin::cli
