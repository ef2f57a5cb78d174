#include "clients/cli/common.h"

#include <fmt/chrono.h>
#include <fmt/format.h>
#include <fmt/ranges.h>
#include <poll.h>
#include <signal.h>
#include <spdlog/spdlog.h>
#include <sys/eventfd.h>
#include <sys/signalfd.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <condition_variable>
#include <cstdlib>
#include <ctime>
#include <mutex>
#include <numbers>
#include <set>
#include <stdexcept>
#include <system_error>

#include "clients/cli/virtual_suit.h"
#include "server/optical/byte_recorder.h"
#include "server/optical/optical_topics.h"
#include "server/wearable/wearable_source.h"

namespace secondskin::cli {

namespace fs = std::filesystem;

void add_bus_options(CLI::App& command, BusOptions& options) {
  auto& config = options.config;
  command.add_option("--subject", config.subject, "who learns; part of every topic's name")
      ->capture_default_str();
  command.add_option("--domain", config.domain, "DDS domain, 0 to 232")->capture_default_str();
  command.add_flag_function(
      "--network", [&config](std::int64_t) { config.reach = bus::Reach::kNetwork; },
      "open the session to the local network (default: this machine only)");
}

bus::Config BusOptions::configuration(std::string program) const {
  bus::Config result = config;
  result.qos_file = Library().qos();
  result.name = std::move(program);
  return result;
}

RetargetOptions SourceOptions::retarget() const {
  RetargetOptions options;
  if (!up.empty()) options.up = up == "y" ? UpAxis::kY : UpAxis::kZ;
  options.metres_per_unit = metres_per_unit;
  return options;
}

server::SourceSettings SourceOptions::settings(const Library& library) const {
  server::SourceSettings settings;
  settings.joint_maps = library.joint_maps();
  settings.marker_sets = library.marker_sets();
  settings.retarget = retarget();
  settings.optical.suit = library.find_suit(suit);
  settings.optical.projectors =
      projectors.empty() ? library.own_optical() / "projectors.txt" : projectors;
  settings.optical.body = body;
  settings.optical.gray = gray;
  if (const auto own = library.own_optical() / "body.toml"; body.empty() && fs::exists(own)) {
    settings.optical.body = own;
  }
  settings.wearable.garment = garment.empty()       ? fs::path()
                              : fs::exists(garment) ? fs::path(garment)
                                                    : library.find_garment(garment);
  settings.wearable.calibration = wearable_calibration;
  settings.wearable.temperature = temperature;
  auto& start = settings.wearable.options.start;
  if (!wearer.empty()) {
    start.wearer = server::Wearer::load(wearer);
  } else {
    start.wearer.stature = stature;
  }
  start.movement = movement;
  settings.wearable.options.use_contacts = !no_contacts;
  settings.wearable.options.smooth = smooth;
  return settings;
}

std::unique_ptr<server::PoseSource> SourceOptions::open(const std::string& source,
                                                        const Library& library) const {
  constexpr std::string_view kSim = "sim:";
  auto settings = this->settings(library);
  const bool table = source.ends_with(".csv") || source.ends_with(".csv.gz");
  if (source.starts_with("wearable:") && !table) {
    auto& wearable = settings.wearable;
    if (wearable.garment.empty()) wearable.garment = library.find_garment("practical");
    const auto own = library.own_wearable() / wearable.garment.filename();
    if (wearable.calibration.empty() && fs::exists(own)) wearable.calibration = own;
  }
  if (!source.starts_with(kSim)) {
    auto opened = server::open_source(source, settings);
    const auto* worn = dynamic_cast<const server::WearableSource*>(opened.get());
    if (worn != nullptr && worn->started()) {
      for (const std::string& warning : worn->start().warnings) spdlog::warn("{}", warning);
      if (const auto trouble = worn->stream().trouble(); !trouble.empty())
        spdlog::warn("{}", trouble);
    }
    return opened;
  }
  const auto worn_by = server::open_source(source.substr(kSim.size()), settings);
  return std::make_unique<VirtualSuit>(server::read_all(*worn_by),
                                       Suit::load(settings.optical.suit));
}

void add_motion_options(CLI::App& command, SourceOptions& options) {
  command.add_option("--up", options.up, "the file's up axis (default: told from the poses)")
      ->check(CLI::IsMember({"y", "z"}));
  command
      .add_option("--metres-per-unit", options.metres_per_unit,
                  "the file's unit of length (default: told from the body's size)")
      ->check(CLI::PositiveNumber);
  command.add_option("--suit", options.suit, "optical: which suit is worn, name or .toml file")
      ->capture_default_str();
  command.add_option("--projectors", options.projectors,
                     "optical: the projectors' calibration (default: the last one made)");
  command.add_option("--body", options.body,
                     "optical: the wearer's body (default: the last one measured)");
  command.add_flag("--gray", options.gray, "optical: the tags send the Gray code as it is read");
}

void add_source_options(CLI::App& command, SourceOptions& options) {
  add_motion_options(command, options);
  command.add_option("--garment", options.garment,
                     "wearable: which garment is worn, name or .toml file (default: practical); of "
                     "a table its mapping (default: the .toml beside it)");
  command.add_option("--garment-calibration", options.wearable_calibration,
                     "wearable: the garment's calibration (default: the last one made)");
  command.add_option("--stature", options.stature, "wearable: the wearer's height [m]")
      ->check(CLI::Range(0.5, 2.5))
      ->capture_default_str();
  command.add_option("--wearer", options.wearer,
                     "wearable: a .toml file with the wearer's measures, instead of --stature");
  command
      .add_option("--movement", options.movement,
                  "wearable: seconds of movement after standing still that show how boards sit")
      ->check(CLI::Range(0.0, 60.0));
  command.add_option("--temperature", options.temperature,
                     "wearable: of the air in degrees Celsius (default: as the stream says)");
  command.add_flag("--smooth", options.smooth,
                   "wearable: of a recording, let what comes later correct what came earlier");
  command.add_flag("--no-contacts", options.no_contacts,
                   "wearable: do not take still feet as standing on the floor");
}

WearableOutputs::WearableOutputs(bus::Participant& participant, server::PoseSource& source)
    : source_(dynamic_cast<server::WearableSource*>(&source)) {
  if (source_ == nullptr) return;
  topics_ = std::make_unique<server::WearableTopics>(participant, *source_);
  source_->observe([topics = topics_.get()](const server::WearableSource& from, server::Next what) {
    topics->publish(from, what);
  });
}

WearableOutputs::~WearableOutputs() {
  if (source_ != nullptr) source_->observe({});
}

server::OpticalSource* optical_of(server::PoseSource& source) noexcept {
  if (auto* worn = dynamic_cast<VirtualSuit*>(&source)) return &worn->optical();
  return dynamic_cast<server::OpticalSource*>(&source);
}

struct OpticalOutputs::State {
  State(bus::Participant& participant, server::OpticalSource& source_)
      : source(source_), topics(participant, source.names()) {}

  server::OpticalSource& source;
  server::OpticalTopics topics;
  std::optional<server::ByteRecorder> recorder;
};

OpticalOutputs::OpticalOutputs(bus::Participant& participant, server::PoseSource& source,
                               const std::string& bytes) {
  server::OpticalSource* optical = optical_of(source);
  if (optical == nullptr) {
    if (!bytes.empty()) throw std::runtime_error("--save-bytes: the source is no optical one");
    return;
  }
  state_ = std::make_unique<State>(participant, *optical);
  if (!bytes.empty()) state_->recorder.emplace(bytes, optical->receiver().format());
  optical->observe([s = state_.get()](const server::OpticalSource& from, server::Next what) {
    s->topics.publish(from, what);
    if (s->recorder && what == server::Next::kPose) s->recorder->write(from.values());
  });
}

OpticalOutputs::~OpticalOutputs() {
  if (state_) state_->source.observe({});
}

void OpticalOutputs::report() const {
  if (!state_) return;
  const auto& receiver = state_->source.receiver();
  for (std::size_t i = 0; i < receiver.tags(); ++i) {
    const auto status = receiver.status(i);
    fmt::print("tag {}: {} sets, {} torn, {} missing, {} late\n", i, status.sets.sets,
               status.bytes.torn, status.sets.missing, status.sets.late);
  }
  if (!state_->recorder) return;
  if (!state_->recorder->error().empty()) throw std::runtime_error(state_->recorder->error());
  fmt::print("bytes are in {}\n", fmt::join(state_->recorder->files(), ", "));
}

bool enter_pressed() {
  pollfd input{STDIN_FILENO, POLLIN, 0};
  if (::poll(&input, 1, 0) <= 0 || (input.revents & POLLIN) == 0) return false;
  char c = 0;
  return ::read(STDIN_FILENO, &c, 1) == 1 && c == '\n';
}

bool wait_for_body(server::PoseSource& source, const std::string& name, std::stop_token stop) {
  if (!source.knows_body()) spdlog::info("waiting for the first pose of {}", name);
  StampedPose pose;
  std::string said;
  while (!source.knows_body()) {
    if (stop.stop_requested() || source.next(pose) == server::Next::kEnd) return false;
    const std::string trouble = source.trouble();
    if (!trouble.empty() && trouble != said) spdlog::warn("{}: {}", name, trouble);
    said = trouble;
  }
  return true;
}

void wait_for_stop(std::stop_token stop, double seconds) {
  std::mutex mutex;
  std::condition_variable_any alarm;
  std::unique_lock lock(mutex);
  const auto never = [] { return false; };
  if (std::isfinite(seconds)) {
    alarm.wait_for(lock, stop, std::chrono::duration<double>(seconds), never);
  } else {
    alarm.wait(lock, stop, never);
  }
}

Library::Library() {
  std::vector<std::string> candidates;
  if (const char* given = std::getenv("SECONDSKIN_DATA")) candidates.emplace_back(given);
  std::error_code error;
  const fs::path program = fs::read_symlink("/proc/self/exe", error);
  if (!error) candidates.push_back(program.parent_path().parent_path() / "share/secondskin");
  candidates.emplace_back(SECONDSKIN_SOURCE_DIR);
  for (const auto& candidate : candidates) {
    if (fs::exists(fs::path(candidate) / "idl" / "qos.xml", error)) {
      root_ = candidate;
      return;
    }
  }
  throw std::runtime_error(
      fmt::format("the program's data files are nowhere: expected idl/qos.xml in one of {}; set "
                  "SECONDSKIN_DATA",
                  fmt::join(candidates, ", ")));
}

namespace {

// The user's own files: $XDG_DATA_HOME/secondskin.
fs::path own_files() {
  const char* data = std::getenv("XDG_DATA_HOME");
  const char* home = std::getenv("HOME");
  const fs::path base = data != nullptr && *data != '\0' ? fs::path(data)
                        : home != nullptr                ? fs::path(home) / ".local" / "share"
                                                         : fs::current_path();
  return base / "secondskin";
}

}  // namespace

fs::path Library::own_history() const { return own_files() / "history.db"; }

fs::path Library::own_profiles() const { return own_files() / "learners"; }
fs::path Library::own_references() const { return own_files() / "reference_motions"; }
fs::path Library::own_takes() const { return own_files() / "takes"; }
fs::path Library::own_optical() const { return own_files() / "optical"; }
fs::path Library::own_wearable() const { return own_files() / "wearable"; }

fs::path Library::page() const {
  const fs::path installed = root_ / "dashboard";
  return fs::exists(installed / "index.html") ? installed
                                              : root_ / "clients" / "dashboard" / "web" / "dist";
}

std::vector<fs::path> Library::references() const {
  std::vector<fs::path> found;
  std::set<std::string> names;
  for (const fs::path& folder : {own_references(), root_ / "reference_motions"}) {
    std::set<fs::path> sorted;
    std::error_code error;
    for (fs::directory_iterator it(folder, error), end; !error && it != end; it.increment(error)) {
      const bool being_made = it->path().filename().string().starts_with('.');
      if (!being_made && fs::exists(it->path() / "motion.toml")) sorted.insert(it->path());
    }
    for (const auto& path : sorted) {
      if (names.insert(path.filename().string()).second) found.push_back(path);
    }
  }
  std::stable_partition(found.begin(), found.end(),
                        [](const fs::path& path) { return path.filename() == kDefaultReference; });
  return found;
}

fs::path Library::find_reference(const std::string& name_or_path) const {
  std::vector<std::string> names;
  for (const auto& folder : references()) {
    if (folder.filename() == name_or_path) return folder;
    names.push_back(folder.filename().string());
  }
  if (fs::exists(name_or_path)) return name_or_path;
  throw std::runtime_error(
      fmt::format("reference '{}': neither a known name ({}) nor a folder or motion file",
                  name_or_path, fmt::join(names, ", ")));
}

std::vector<fs::path> Library::find_references(const std::string& names_or_paths) const {
  if (fs::exists(names_or_paths) || names_or_paths.find(kPerformances) == std::string::npos) {
    return {find_reference(names_or_paths)};
  }
  std::vector<fs::path> found;
  for (std::size_t begin = 0; begin <= names_or_paths.size();) {
    const std::size_t end =
        std::min(names_or_paths.find(kPerformances, begin), names_or_paths.size());
    found.push_back(find_reference(names_or_paths.substr(begin, end - begin)));
    begin = end + 1;
  }
  return found;
}

std::shared_ptr<const coach::Reference> Library::load_reference(
    const std::string& names_or_paths) const {
  return std::make_shared<const coach::Reference>(
      coach::load_reference(find_references(names_or_paths), joint_maps()));
}

fs::path Library::find_file(const char* kind, const char* folder,
                            const std::string& name_or_path) const {
  const fs::path shipped = root_ / folder / (name_or_path + ".toml");
  if (fs::exists(shipped)) return shipped;
  if (fs::exists(name_or_path)) return name_or_path;
  std::set<std::string> names;
  std::error_code error;
  for (fs::directory_iterator it(root_ / folder, error), end; !error && it != end;
       it.increment(error)) {
    if (it->path().extension() == ".toml") names.insert(it->path().stem().string());
  }
  throw std::runtime_error(fmt::format("{} '{}': neither a known name ({}) nor a file", kind,
                                       name_or_path, fmt::join(names, ", ")));
}

fs::path Library::find_suit(const std::string& name_or_path) const {
  return find_file("suit", "suits", name_or_path);
}

fs::path Library::find_garment(const std::string& name_or_path) const {
  return find_file("garment", "garments", name_or_path);
}

fs::path Library::find_calibration_object(const std::string& name_or_path) const {
  return find_file("wand or grid", "calibration_objects", name_or_path);
}

coach::BodyMap Library::load_body_map(const std::string& name_or_path) const {
  return coach::BodyMap::load(find_file("body map", "body_maps", name_or_path));
}

coach::SessionPlan Library::load_plan(const std::string& name_or_path) const {
  if (name_or_path.empty()) return coach::SessionPlan::open();
  return coach::SessionPlan::load(
      find_file("session plan", "plans", name_or_path),
      [this](const fs::path& session) { return recorder::recorded_cues(session, for_replay()); });
}

std::vector<std::shared_ptr<const coach::Reference>> Library::load_references() const {
  std::vector<std::shared_ptr<const coach::Reference>> all;
  for (const auto& folder : references()) {
    try {
      all.push_back(load_reference(folder.string()));
    } catch (const std::exception& error) {
      spdlog::warn("reference left out: {}", error.what());
    }
  }
  return all;
}

void Library::answer_commands(coach::CoachServiceOptions& options) const {
  const auto named = [](const std::string& name) {
    const auto plain = [](unsigned char c) { return std::isalnum(c) || c == '_' || c == '-'; };
    if (!std::all_of(name.begin(), name.end(), plain)) {
      throw std::runtime_error(
          fmt::format("'{}' is no name: expected letters, digits, '_' and '-'", name));
    }
    return name;
  };
  options.find_plan = [*this, named](const std::string& name) { return load_plan(named(name)); };
  options.find_reference = [*this, named](const std::string& name) {
    return load_reference(named(name));
  };
}

recorder::ReplayLibrary Library::for_replay() const {
  return {.reference = [this](const std::string& name) { return load_reference(name); },
          .body_map = [this](const std::string& name) { return load_body_map(name); }};
}

StopOnSignal::StopOnSignal() {
  sigset_t signals;
  sigemptyset(&signals);
  sigaddset(&signals, SIGINT);
  sigaddset(&signals, SIGTERM);
  pthread_sigmask(SIG_BLOCK, &signals, nullptr);
  const int signal_fd = ::signalfd(-1, &signals, SFD_CLOEXEC);
  end_fd_ = ::eventfd(0, EFD_CLOEXEC);
  if (signal_fd < 0 || end_fd_ < 0) {
    throw std::system_error(errno, std::generic_category(), "signals cannot be watched");
  }
  thread_ = std::thread([this, signal_fd] {
    pollfd watched[2] = {{signal_fd, POLLIN, 0}, {end_fd_, POLLIN, 0}};
    while (::poll(watched, 2, -1) >= 0 || errno == EINTR) {
      if ((watched[1].revents & POLLIN) != 0) break;
      if ((watched[0].revents & POLLIN) != 0) {
        signalfd_siginfo info;
        if (::read(signal_fd, &info, sizeof info) == sizeof info) source_.request_stop();
      }
    }
    ::close(signal_fd);
  });
}

StopOnSignal::~StopOnSignal() {
  const std::uint64_t one = 1;
  (void)!::write(end_fd_, &one, sizeof one);
  thread_.join();
  ::close(end_fd_);
}

std::string default_recording_name(const std::string& reference) {
  const std::time_t now = std::time(nullptr);
  return fmt::format("recordings/{:%Y-%m-%d_%H-%M-%S}_{}.mcap", fmt::localtime(now), reference);
}

void add_cue_options(CLI::App& command, coach::CoachSettings& settings) {
  command.add_option("--max-cues", settings.max_cues, "joints cued at once")
      ->check(CLI::Range(1, 16))
      ->capture_default_str();
  command
      .add_option("--tolerance-scale", settings.tolerance_scale, "times the reference's tolerances")
      ->check(CLI::Range(0.1, 10.0))
      ->capture_default_str();
}

void add_plan_option(CLI::App& command, std::string& plan) {
  command.add_option("--plan", plan,
                     "the session's blocks and when they are cued: name under plans/ or .toml file "
                     "(default: always cued, without end)");
}

void print_blocks(const coach::CoachSummary& summary) {
  for (const auto& block : summary.blocks) {
    const auto mean = coach::mean_total(block, summary.repetitions);
    fmt::print("  block '{}' (tempo {:g}): {} repetitions, {}, {} cues\n", block.name, block.tempo,
               block.repetitions, mean ? fmt::format("mean score {:.1f}", *mean) : "no score",
               block.cues);
  }
}

double deg(double radians) { return radians * 180.0 / std::numbers::pi; }

std::string milliseconds(double seconds) { return fmt::format("{:.1f} ms", seconds * 1e3); }

}  // namespace secondskin::cli
