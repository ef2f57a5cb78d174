#include "clients/history/pdf.h"

#include <fmt/format.h>
#include <signal.h>
#include <spawn.h>
#include <sys/mman.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <chrono>
#include <cstring>
#include <stdexcept>
#include <thread>

extern char** environ;

namespace secondskin::history {
namespace {

using namespace std::chrono_literals;

constexpr const char* kProgram = "weasyprint";
constexpr auto kLongest = 120s;
constexpr const char* kInstead = "The HTML report holds the same and can be printed from a browser";

/// A file without a name, gone with its last user: no pipe that may fill up.
class MemoryFile {
 public:
  explicit MemoryFile(const char* name) : fd_(::memfd_create(name, MFD_CLOEXEC)) {
    if (fd_ < 0) throw std::runtime_error(fmt::format("memfd_create: {}", std::strerror(errno)));
  }
  ~MemoryFile() { ::close(fd_); }
  MemoryFile(const MemoryFile&) = delete;
  MemoryFile& operator=(const MemoryFile&) = delete;

  void write(const std::string& bytes) const {
    for (std::size_t done = 0; done < bytes.size();) {
      const auto n = ::write(fd_, bytes.data() + done, bytes.size() - done);
      if (n < 0) throw std::runtime_error(fmt::format("report: {}", std::strerror(errno)));
      done += static_cast<std::size_t>(n);
    }
    ::lseek(fd_, 0, SEEK_SET);
  }

  std::string read() const {
    std::string bytes(static_cast<std::size_t>(::lseek(fd_, 0, SEEK_END)), '\0');
    const auto n = ::pread(fd_, bytes.data(), bytes.size(), 0);
    bytes.resize(n < 0 ? 0 : static_cast<std::size_t>(n));
    return bytes;
  }

  int fd() const { return fd_; }

 private:
  int fd_;
};

/// @returns its exit status as waitpid gives it; kills it when it takes too long.
int wait_for(pid_t child) {
  const auto end = std::chrono::steady_clock::now() + kLongest;
  int status = 0;
  while (::waitpid(child, &status, WNOHANG) == 0) {
    if (std::chrono::steady_clock::now() > end) {
      ::kill(child, SIGKILL);
      ::waitpid(child, &status, 0);
      throw std::runtime_error(fmt::format("{} took longer than {} s and was ended. {}", kProgram,
                                           kLongest.count(), kInstead));
    }
    std::this_thread::sleep_for(20ms);
  }
  return status;
}

}  // namespace

std::string pdf_of(const std::string& html) {
  const MemoryFile in("report.html"), out("report.pdf"), said("report.log");
  in.write(html);
  posix_spawn_file_actions_t actions;
  ::posix_spawn_file_actions_init(&actions);
  ::posix_spawn_file_actions_adddup2(&actions, in.fd(), 0);
  ::posix_spawn_file_actions_adddup2(&actions, out.fd(), 1);
  ::posix_spawn_file_actions_adddup2(&actions, said.fd(), 2);
  // Nothing of ours stays open in there: not the port, not the guardian's socket.
  ::posix_spawn_file_actions_addclosefrom_np(&actions, 3);
  // It may run beside a session, whose turn comes first.
  std::array<std::string, 8> words{"nice", "-n", "10", kProgram, "--encoding", "utf-8", "-", "-"};
  std::array<char*, words.size() + 1> argv{};
  std::transform(words.begin(), words.end(), argv.begin(), [](auto& word) { return word.data(); });
  pid_t child = -1;
  const int error = ::posix_spawnp(&child, argv[0], &actions, nullptr, argv.data(), environ);
  ::posix_spawn_file_actions_destroy(&actions);
  const auto missing = [] {
    return std::runtime_error(
        fmt::format("PDF: the program {0} is not there; install it (Debian: apt install {0}). {1}",
                    kProgram, kInstead));
  };
  if (error == ENOENT) throw missing();
  if (error != 0) throw std::runtime_error(fmt::format("{}: {}", kProgram, std::strerror(error)));
  const int status = wait_for(child);
  if (WIFEXITED(status) && WEXITSTATUS(status) == 127) throw missing();
  std::string pdf = out.read();
  if (!WIFEXITED(status) || WEXITSTATUS(status) != 0 || !pdf.starts_with("%PDF")) {
    throw std::runtime_error(
        fmt::format("{} made no PDF: {}. {}", kProgram, said.read().substr(0, 500), kInstead));
  }
  return pdf;
}

}  // namespace secondskin::history
