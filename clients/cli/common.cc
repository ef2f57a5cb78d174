#include "clients/cli/common.h"

#include <fmt/chrono.h>
#include <fmt/format.h>
#include <fmt/ranges.h>
#include <poll.h>
#include <signal.h>
#include <sys/eventfd.h>
#include <sys/signalfd.h>
#include <unistd.h>

#include <algorithm>
#include <cstdlib>
#include <ctime>
#include <numbers>
#include <set>
#include <stdexcept>
#include <system_error>

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
  command.add_flag("--udp-only", config.udp_only, "no shared memory, e.g. between containers");
}

bus::Config BusOptions::configuration(std::string program) const {
  bus::Config result = config;
  result.qos_file = Library().qos();
  result.name = std::move(program);
  return result;
}

RetargetOptions FileOptions::retarget() const {
  RetargetOptions options;
  if (!up.empty()) options.up = up == "y" ? UpAxis::kY : UpAxis::kZ;
  options.metres_per_unit = metres_per_unit;
  return options;
}

void add_file_options(CLI::App& command, FileOptions& options) {
  command.add_option("--up", options.up, "the file's up axis (default: told from the poses)")
      ->check(CLI::IsMember({"y", "z"}));
  command
      .add_option("--metres-per-unit", options.metres_per_unit,
                  "the file's unit of length (default: told from the body's size)")
      ->check(CLI::PositiveNumber);
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

fs::path Library::own_references() const {
  const char* data = std::getenv("XDG_DATA_HOME");
  const char* home = std::getenv("HOME");
  const fs::path base = data != nullptr && *data != '\0' ? fs::path(data)
                        : home != nullptr                ? fs::path(home) / ".local" / "share"
                                                         : fs::current_path();
  return base / "secondskin" / "reference_motions";
}

std::vector<fs::path> Library::references() const {
  std::vector<fs::path> found;
  std::set<std::string> names;
  for (const fs::path& folder : {own_references(), root_ / "reference_motions"}) {
    std::set<fs::path> sorted;
    std::error_code error;
    for (fs::directory_iterator it(folder, error), end; !error && it != end; it.increment(error)) {
      if (fs::exists(it->path() / "motion.toml")) sorted.insert(it->path());
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

std::shared_ptr<const coach::Reference> Library::load_reference(
    const std::string& name_or_path) const {
  return std::make_shared<const coach::Reference>(
      coach::load_reference(find_reference(name_or_path), joint_maps()));
}

coach::BodyMap Library::load_body_map(const std::string& name_or_path) const {
  const fs::path shipped = root_ / "body_maps" / (name_or_path + ".toml");
  if (fs::exists(shipped)) return coach::BodyMap::load(shipped);
  if (fs::exists(name_or_path)) return coach::BodyMap::load(name_or_path);
  std::set<std::string> names;
  std::error_code error;
  for (fs::directory_iterator it(root_ / "body_maps", error), end; !error && it != end;
       it.increment(error)) {
    if (it->path().extension() == ".toml") names.insert(it->path().stem().string());
  }
  throw std::runtime_error(fmt::format("body map '{}': neither a known name ({}) nor a file",
                                       name_or_path, fmt::join(names, ", ")));
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

double deg(double radians) { return radians * 180.0 / std::numbers::pi; }

std::string milliseconds(double seconds) { return fmt::format("{:.1f} ms", seconds * 1e3); }

}  // namespace secondskin::cli
