#pragma once

#include <fcntl.h>
#include <fmt/format.h>
#include <signal.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <filesystem>
#include <fstream>
#include <sstream>
#include <stdexcept>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "motion/bvh.h"
#include "motion/retarget.h"

/// What the benchmarks of a whole session share: the learner that moves, and the real programs as
/// processes of the benchmark's own.
namespace secondskin::bench {

inline constexpr double kRate = 62.5;  ///< [Hz], Second Skin's capture rate

inline const std::filesystem::path kRoot = SECONDSKIN_SOURCE_DIR;

/// A reference's recorded learner at the session's rate.
inline Motion learner_of(const std::string& reference) {
  return resample(
      read_canonical(kRoot / "reference_motions" / reference / "learner.bvh", kRoot / "joint_maps"),
      kRate);
}

/// @returns the value at or above a share q of the others; 0 when there are none
inline double quantile(std::vector<double> values, double q) {
  if (values.empty()) return 0.0;
  std::sort(values.begin(), values.end());
  const auto last = static_cast<double>(values.size() - 1);
  return values[static_cast<std::size_t>(q * last + 0.5)];
}

/// Removed with all that is in it.
class Folder {
 public:
  Folder() {
    std::string name = (std::filesystem::temp_directory_path() / "secondskin_XXXXXX").string();
    if (::mkdtemp(name.data()) == nullptr) throw std::runtime_error("no temporary folder");
    path_ = name;
  }
  ~Folder() {
    std::error_code ignored;
    std::filesystem::remove_all(path_, ignored);
  }
  Folder(const Folder&) = delete;
  Folder& operator=(const Folder&) = delete;
  std::string operator/(const std::string& name) const { return (path_ / name).string(); }

 private:
  std::filesystem::path path_;
};

/// The program `secondskin` as a process; ends with the benchmark, whatever ends that.
class Program {
 public:
  Program(std::vector<std::string> arguments, std::string log_file)
      : name_(arguments.front()), log_file_(std::move(log_file)), pid_(::fork()) {
    if (pid_ < 0) throw std::runtime_error("no process for " + name_);
    if (pid_ > 0) return;
    ::prctl(PR_SET_PDEATHSIG, SIGTERM);
    const int out = ::open(log_file_.c_str(), O_CREAT | O_TRUNC | O_WRONLY, 0600);
    ::dup2(::open("/dev/null", O_RDONLY), 0);
    ::dup2(out, 1);
    ::dup2(out, 2);
    std::vector<char*> argv{const_cast<char*>(SECONDSKIN_PROGRAM)};
    for (auto& argument : arguments) argv.push_back(argument.data());
    argv.push_back(nullptr);
    ::execv(SECONDSKIN_PROGRAM, argv.data());
    ::_exit(127);
  }
  Program(Program&& other) noexcept
      : name_(std::move(other.name_)),
        log_file_(std::move(other.log_file_)),
        pid_(std::exchange(other.pid_, -1)) {}
  ~Program() { end(); }

  /// Asks it to end and waits. @returns what it said
  std::string end() {
    using namespace std::chrono_literals;
    const auto patience = std::chrono::steady_clock::now() + 10s;
    if (pid_ > 0) ::kill(pid_, SIGTERM);
    while (running()) {
      if (std::chrono::steady_clock::now() > patience) ::kill(pid_, SIGKILL);
      std::this_thread::sleep_for(2ms);
    }
    return log();
  }
  bool running() {
    if (pid_ > 0 && ::waitpid(pid_, nullptr, WNOHANG) == pid_) pid_ = -1;
    return pid_ > 0;
  }
  std::string log() const {
    std::ostringstream text;
    text << std::ifstream(log_file_).rdbuf();
    return text.str();
  }
  const std::string& name() const { return name_; }
  pid_t pid() const { return pid_; }

 private:
  std::string name_;
  std::string log_file_;
  pid_t pid_;
};

}  // namespace secondskin::bench
