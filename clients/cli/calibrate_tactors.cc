#include <fmt/format.h>
#include <poll.h>
#include <termios.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <chrono>
#include <cmath>
#include <cstring>
#include <fstream>
#include <nlohmann/json.hpp>
#include <numbers>
#include <stdexcept>
#include <thread>

#include "bus/stop_state.h"
#include "clients/cli/common.h"
#include "clients/history/history.h"
#include "clients/history/profiles.h"
#include "clients/tactor_driver/driver_core.h"
#include "clients/tactor_driver/guardian.h"
#include "coach/tactile/calibration.h"
#include "sim/board/virtual_board_runner.h"
#include "wire/pseudo_terminal.h"
#include "wire/serial_port.h"

/// How each site of one learner's skin feels: threshold, comfort, and which one it was.
namespace secondskin::cli {
namespace {

using nlohmann::json;
using wire::kTactorCount;

constexpr double kLongestConnect = 5.0;  // [s]
constexpr double kRepeat = 0.020;        // between two commands [s]
constexpr double kLifetime = 0.080;      // so that a hang here is felt no longer [s]
constexpr double kLongestGoodbye = 0.1;  // [s]
constexpr double kPause = 0.6;           // before each presentation, of its duration

struct Options {
  BusOptions bus;
  std::string port = "virtual";
  unsigned baud_rate = wire::SerialPort::kBaudRate;
  std::string body_map = "full_body";
  std::filesystem::path out;
  std::string learner;
  std::vector<std::size_t> channels;
  double duration = 0.5;
  std::uint32_t presentations = 4;
  std::uint32_t seed = 1;
  bool as_json = false;
};

double monotonic() {
  return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

/// Somebody wants it to end.
struct Ended : std::runtime_error {
  using std::runtime_error::runtime_error;
};

/// Keys on a terminal; elsewhere the first letter of each line.
class Keys {
 public:
  explicit Keys(std::stop_token stop) : stop_(std::move(stop)), tty_(::isatty(STDIN_FILENO) != 0) {
    if (!tty_) return;
    ::tcgetattr(STDIN_FILENO, &before_);
    termios raw = before_;
    raw.c_lflag &= ~static_cast<tcflag_t>(ICANON | ECHO);
    ::tcsetattr(STDIN_FILENO, TCSANOW, &raw);
  }
  ~Keys() {
    if (tty_) ::tcsetattr(STDIN_FILENO, TCSANOW, &before_);
  }
  Keys(const Keys&) = delete;
  Keys& operator=(const Keys&) = delete;

  bool is_tty() const { return tty_; }
  /// A key that was pressed on a terminal; 0 for none. Never waits.
  char pressed() const {
    pollfd input{STDIN_FILENO, POLLIN, 0};
    char c = 0;
    if (!tty_ || ::poll(&input, 1, 0) <= 0 || ::read(STDIN_FILENO, &c, 1) != 1) return 0;
    return c;
  }
  /// Waits for one of `allowed`. @throws Ended on q, the end of the input, or a signal
  template <class Meanwhile>
  char ask(const std::string& question, std::string_view allowed, Meanwhile meanwhile) const {
    fmt::print(stderr, "{} ", question);
    for (;;) {
      meanwhile();
      if (stop_.stop_requested()) throw Ended("a signal");
      pollfd input{STDIN_FILENO, POLLIN, 0};
      if (::poll(&input, 1, 20) <= 0) continue;
      char c = 0;
      if (::read(STDIN_FILENO, &c, 1) != 1) throw Ended("there are no more answers");
      if (c == '\n' && !tty_) {
        line_begins_ = true;
        continue;
      }
      if (!line_begins_) continue;
      line_begins_ = tty_;
      if (c == 'q') throw Ended("key q");
      if (allowed.find(c) == std::string_view::npos) continue;
      fmt::print(stderr, "{}\n", c);
      return c;
    }
  }

 private:
  std::stop_token stop_;
  bool tty_;
  mutable bool line_begins_ = true;
  termios before_{};
};

/// The board for as long as this lives; off at its end, however that comes.
class Board {
 public:
  Board(const Options& options, const std::string& path, bus::StopState& stop,
        std::stop_token signals)
      : guardian_(tactor_driver::Guardian::start()),
        port_(path, options.baud_rate),
        core_(port_.byte_rate()),
        stop_(stop),
        signals_(std::move(signals)) {
    for (const double end = monotonic() + kLongestConnect; !port_.poll(monotonic());) {
      if (monotonic() > end) throw std::runtime_error(port_.last_error());
      if (signals_.stop_requested()) throw Ended("a signal");
      std::this_thread::sleep_for(std::chrono::milliseconds(20));
    }
    if (!guardian_.hold(port_.fd())) throw std::runtime_error("the guardian process is gone");
    core_.link_up(monotonic());
  }
  ~Board() { off(); }

  /// Vibrates one channel, and stops at once when a key is pressed.
  /// @returns the key, 0 for none
  char play(std::size_t channel, double level, double ceiling, double seconds, const Keys& keys) {
    wire::BoardState board{};
    std::uint8_t intensity = wire::intensity_for_level(level);
    while (intensity > 0 && wire::drive_of(intensity).level > ceiling) --intensity;
    if (level > 0.0) board[wire::continuous_slot(channel)] = intensity;
    const double end = monotonic() + seconds;
    char key = 0;
    for (double now = monotonic(), next = now; now < end && key == 0; now = monotonic()) {
      watch();
      if (now >= next) {
        next += kRepeat;
        (void)core_.push({board, ++number_, kLifetime, static_cast<std::uint64_t>(number_)}, now);
      }
      core_.pump(now, port_);
      key = keys.pressed();
      std::this_thread::sleep_for(std::chrono::milliseconds(2));
    }
    off();
    return key;
  }

  /// @throws Ended on an emergency stop or a signal, std::runtime_error when the port is gone
  void watch() {
    stop_.poll();
    if (stop_.active()) throw Ended(fmt::format("emergency stop: {}", stop_.reason()));
    if (signals_.stop_requested()) throw Ended("a signal");
    if (!port_.poll(monotonic())) throw std::runtime_error(port_.last_error());
    if (!guardian_.alive()) throw std::runtime_error("the guardian process is gone");
  }

 private:
  void off() {
    core_.stop(true, monotonic());
    for (const double end = monotonic() + kLongestGoodbye;
         monotonic() < end && !core_.all_off_sent();) {
      core_.pump(monotonic(), port_);
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
    }
    core_.stop(false, monotonic());
  }

  tactor_driver::Guardian guardian_;
  wire::SerialPort port_;
  tactor_driver::DriverCore core_;
  bus::StopState& stop_;
  std::stop_token signals_;
  std::int64_t number_ = 0;
};

std::string place_of(const coach::Tactor& tactor) {
  static constexpr std::array<const char*, 8> kSides{"front", "front left", "left",  "back left",
                                                     "back",  "back right", "right", "front right"};
  const double turns = tactor.angle / (2.0 * std::numbers::pi);
  const auto side =
      static_cast<std::size_t>(std::lround(8.0 * (turns - std::floor(turns)))) % kSides.size();
  std::string limb(joint_name(tactor.segment));
  std::replace(limb.begin(), limb.end(), '_', ' ');
  const auto name = [&](std::string_view joint, std::string_view segment) {
    if (const auto at = limb.find(joint); at != std::string::npos) {
      limb.replace(at, joint.size(), segment);
    }
  };
  name("elbow", "forearm");
  name("shoulder", "upper arm");
  name("hip", "thigh");
  name("knee", "shank");
  name("spine upper", "chest");
  return fmt::format("{}, {}", limb, kSides[side]);
}

/// The whole procedure. @throws Ended when somebody ends it: nothing is kept then
class Procedure {
 public:
  Procedure(const Options& options, const coach::BodyMap& map, Board& board, const Keys& keys)
      : options_(options), map_(map), board_(board), keys_(keys) {}

  coach::LearnerProfile run() {
    profile_.body_map = map_.name;
    std::vector<std::size_t> clear;
    for (const std::size_t channel : options_.channels) {
      const coach::Tactor& tactor = tactor_of(channel);
      coach::SiteProfile site;
      site.channel = channel;
      site.threshold = threshold(tactor);
      if (site.threshold <= tactor.ceiling) {
        site.ceiling = comfort(tactor, site.threshold);
        clear.push_back(channel);
      } else {
        site.threshold = 1.0;
        fmt::print(stderr, "{}: not felt, and not used\n", place_of(tactor));
      }
      profile_.sites.push_back(site);
    }
    which_one(clear);
    return profile_;
  }

 private:
  const coach::Tactor& tactor_of(std::size_t channel) const {
    return *std::find_if(map_.tactors.begin(), map_.tactors.end(),
                         [&](const coach::Tactor& t) { return t.channel == channel; });
  }

  char ask(const std::string& question, std::string_view allowed) {
    return keys_.ask(question, allowed, [&] { board_.watch(); });
  }

  /// @returns the answer: the key that stopped it if that is one, else what is answered after
  char present(const coach::Tactor& tactor, double level, double seconds,
               const std::string& question, std::string_view allowed) {
    board_.play(tactor.channel, 0.0, tactor.ceiling, kPause * options_.duration, keys_);
    const char key = board_.play(tactor.channel, level, tactor.ceiling, seconds, keys_);
    if (key == 'q') throw Ended("key q");
    if (key != 0 && allowed.find(key) != std::string_view::npos) {
      fmt::print(stderr, "{} {}\n", question, key);
      return key;
    }
    return ask(question, allowed);
  }

  double threshold(const coach::Tactor& tactor) {
    fmt::print(stderr, "\n{} (channel {}): did you feel it?\n", place_of(tactor), tactor.channel);
    const double floor = wire::drive_of(wire::kFaintestIntensity).level;
    if (tactor.ceiling < floor) return 1.0 + floor;
    coach::ThresholdStaircase staircase(floor, tactor.ceiling,
                                        options_.seed + static_cast<std::uint32_t>(tactor.channel));
    while (const auto level = staircase.next()) {
      staircase.answer(present(tactor, *level, options_.duration, "felt? y/n", "yn") == 'y');
    }
    if (3 * staircase.false_alarms() > staircase.catch_trials() && staircase.false_alarms() > 1) {
      fmt::print(stderr, "note: felt {} of {} presentations of nothing; better measured again\n",
                 staircase.false_alarms(), staircase.catch_trials());
    }
    return staircase.felt() ? staircase.threshold() : tactor.ceiling + floor;
  }

  double comfort(const coach::Tactor& tactor, double threshold) {
    if (keys_.is_tty()) fmt::print(stderr, "Now it grows: press any key when it is too strong\n");
    coach::ComfortRamp ramp(threshold, tactor.ceiling);
    while (const auto level = ramp.next()) {
      board_.play(tactor.channel, 0.0, tactor.ceiling, kPause * options_.duration, keys_);
      const char key =
          board_.play(tactor.channel, *level, tactor.ceiling, 2.0 * options_.duration, keys_);
      if (key == 'q') throw Ended("key q");
      const bool too_strong =
          keys_.is_tty() ? key != 0 : ask("too strong? s stop, g go on", "sg") == 's';
      ramp.answer(too_strong);
    }
    return ramp.comfortable();
  }

  void which_one(const std::vector<std::size_t>& channels) {
    if (channels.size() < 2 || options_.presentations == 0) return;
    static constexpr std::string_view kDigits = "0123456789abcdef";
    fmt::print(stderr, "\nWhich one was it? Answer with its sign:\n");
    std::string allowed;
    for (const std::size_t channel : channels) {
      fmt::print(stderr, "  {}  {}\n", kDigits[channel], place_of(tactor_of(channel)));
      allowed += kDigits[channel];
    }
    coach::WhichOneTest test(channels, options_.presentations, options_.seed);
    while (const auto channel = test.next()) {
      const auto site = std::find_if(profile_.sites.begin(), profile_.sites.end(),
                                     [&](const auto& s) { return s.channel == *channel; });
      const char named =
          present(tactor_of(*channel), coach::clear_level(site->threshold, site->ceiling),
                  options_.duration, fmt::format("which? ({} left)", test.left()), allowed);
      test.answer(kDigits.find(named));
    }
    for (auto& site : profile_.sites) site.named = test.confusion()[site.channel];
  }

  const Options& options_;
  const coach::BodyMap& map_;
  Board& board_;
  const Keys& keys_;
  coach::LearnerProfile profile_;
};

void report(const coach::LearnerProfile& profile, const coach::BodyMap& map,
            const Options& options) {
  if (options.as_json) {
    json sites = json::array();
    for (const auto& site : profile.sites) {
      sites.push_back({{"channel", site.channel},
                       {"threshold", site.threshold},
                       {"ceiling", site.ceiling},
                       {"recognition", coach::recognition(site)},
                       {"named", site.named}});
    }
    fmt::print(
        "{}\n",
        json{{"body_map", profile.body_map}, {"sites", sites}, {"profile", options.out.string()}}
            .dump(2));
    return;
  }
  fmt::print("\n{:<8}{:<28}{:>10}{:>10}{:>12}   named\n", "channel", "site", "threshold", "ceiling",
             "recognised");
  for (const auto& site : profile.sites) {
    const auto tactor = std::find_if(map.tactors.begin(), map.tactors.end(),
                                     [&](const auto& t) { return t.channel == site.channel; });
    std::string named;
    for (std::size_t c = 0; c < kTactorCount; ++c) {
      if (site.named[c] > 0) named += fmt::format(" {}:{}", c, site.named[c]);
    }
    fmt::print("{:<8}{:<28}{:>10.2f}{:>10.2f}{:>10.0f} %  {}\n", site.channel, place_of(*tactor),
               site.threshold, site.ceiling, 100.0 * coach::recognition(site), named);
  }
  fmt::print("the profile is in {}; use it with --learner-profile\n", options.out.string());
}

// Before somebody has answered for ten minutes. @throws std::runtime_error naming the file
void expect_writable(const std::filesystem::path& file) {
  std::error_code error;
  if (file.has_parent_path()) std::filesystem::create_directories(file.parent_path(), error);
  const bool was_there = std::filesystem::exists(file);
  const bool opens = !error && std::ofstream(file, std::ios::app).is_open();
  if (opens && !was_there) std::filesystem::remove(file, error);
  if (!opens) {
    throw std::runtime_error(fmt::format("--out {}: expected a file that can be written: {}",
                                         file.string(),
                                         error ? error.message() : std::strerror(errno)));
  }
}

void calibrate(Options& options) {
  StopOnSignal signals;
  const coach::BodyMap map = Library().load_body_map(options.body_map);
  if (options.channels.empty()) {
    for (const auto& tactor : map.tactors) options.channels.push_back(tactor.channel);
  }
  if (options.out.empty() == options.learner.empty()) {
    throw std::runtime_error("--out or --learner: expected one of them");
  }
  if (!options.learner.empty()) {
    const Library library;
    // One that the history does not know would leave a profile that no deletion finds.
    if (!std::filesystem::exists(library.own_history()) ||
        !history::History(library.own_history()).learner(options.learner)) {
      throw std::runtime_error(
          fmt::format("--learner '{:.64}': expected an id that 'secondskin history learners' "
                      "lists; 'secondskin history add' makes one",
                      options.learner));
    }
    options.out = history::profile_of(library.own_profiles(), options.learner);
  }
  expect_writable(options.out);
  std::sort(options.channels.begin(), options.channels.end());
  options.channels.erase(std::unique(options.channels.begin(), options.channels.end()),
                         options.channels.end());
  for (const std::size_t channel : options.channels) {
    if (std::none_of(map.tactors.begin(), map.tactors.end(),
                     [&](const auto& t) { return t.channel == channel; })) {
      throw std::runtime_error(
          fmt::format("--channels: body map '{}' has no channel {}", map.name, channel));
    }
  }
  std::optional<wire::PseudoTerminal> terminal;
  std::optional<sim::VirtualBoardRunner> virtual_board;
  std::jthread board_thread;
  std::string path = options.port;
  if (options.port == "virtual") {
    terminal.emplace();
    virtual_board.emplace(*terminal);
    board_thread = std::jthread([&](std::stop_token stop) { virtual_board->run(stop); });
    path = terminal->path();
  }
  bus::Participant participant(options.bus.configuration("secondskin_calibrate"));
  bus::StopState stop(participant);
  coach::LearnerProfile profile;
  try {
    const Keys keys(signals.token());
    Board board(options, path, stop, signals.token());
    if (keys.is_tty()) fmt::print(stderr, "Any key stops a vibration; q ends everything.\n");
    profile = Procedure(options, map, board, keys).run();
  } catch (const Ended& end) {
    throw std::runtime_error(
        fmt::format("the calibration was ended ({}): all is off, nothing was saved", end.what()));
  }
  profile.save(options.out);
  report(profile, map, options);
}

}  // namespace

void add_calibrate_tactors(CLI::App& app) {
  auto options = std::make_shared<Options>();
  auto* command = app.get_subcommand("calibrate")
                      ->add_subcommand("tactors", "what a learner feels, likes and tells apart");
  command->footer(
      "Example:  secondskin calibrate tactors --port /dev/ttyUSB0 --learner L-7K3M9Q\n"
      "Without a terminal the answers are read from standard input, a line each.");
  command->add_option("--port", options->port, "the tactor board's serial port, or 'virtual'")
      ->capture_default_str();
  command->add_option("--baud", options->baud_rate, "baud rate")->capture_default_str();
  command->add_option("--body-map", options->body_map, "where the tactors sit: name or .toml file")
      ->capture_default_str();
  command->add_option("--out", options->out, "the learner's profile to write (.toml)");
  command->add_option("--learner", options->learner,
                      "instead of --out: a learner of the history, with whom the profile is "
                      "deleted; --learner-profile takes the same name");
  command->add_option("--channels", options->channels, "only these (default: all of the map)")
      ->delimiter(',');
  command->add_option("--duration", options->duration, "of a presentation [s]")
      ->check(CLI::Range(0.02, 2.0))
      ->capture_default_str();
  command
      ->add_option("--presentations", options->presentations,
                   "of each site in the which-one-was-it test")
      ->check(CLI::Range(0, 20))
      ->capture_default_str();
  command->add_option("--seed", options->seed, "of the order of presentations")
      ->capture_default_str();
  command->add_flag("--json", options->as_json, "the result as JSON");
  add_bus_options(*command, options->bus);
  command->callback([options] { calibrate(*options); });
}

}  // namespace secondskin::cli
