#pragma once

#include <fcntl.h>
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <chrono>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <sstream>
#include <string>
#include <thread>
#include <vector>

namespace secondskin::session {

/// A folder of this test's own, removed with it.
class Folder {
 public:
  Folder() {
    std::string name = (std::filesystem::temp_directory_path() / "secondskin_XXXXXX").string();
    path_ = ::mkdtemp(name.data());
  }
  ~Folder() { std::filesystem::remove_all(path_); }
  std::string operator/(const std::string& name) const { return (path_ / name).string(); }

 private:
  std::filesystem::path path_;
};

inline std::string read_text(const std::string& file) {
  std::ifstream in(file);
  std::ostringstream text;
  text << in.rdbuf();
  return text.str();
}

/// The program as a real process; its output goes to a file. Ended by its id, and only it.
class Process {
 public:
  /// @param prepare  runs in the child before the program does
  Process(const std::vector<std::string>& arguments, const std::string& output_file,
          void (*prepare)() = nullptr)
      : output_file_(output_file) {
    pid_ = ::fork();
    if (pid_ == 0) {
      const int out = ::open(output_file.c_str(), O_CREAT | O_TRUNC | O_WRONLY, 0600);
      const int in = ::open("/dev/null", O_RDONLY);
      ::dup2(in, 0);
      ::dup2(out, 1);
      ::dup2(out, 2);
      if (prepare != nullptr) prepare();
      std::vector<char*> argv{const_cast<char*>(SECONDSKIN_PROGRAM)};
      for (const auto& argument : arguments) argv.push_back(const_cast<char*>(argument.c_str()));
      argv.push_back(nullptr);
      ::execv(SECONDSKIN_PROGRAM, argv.data());
      ::_exit(127);
    }
  }
  Process(Process&& other) noexcept
      : pid_(std::exchange(other.pid_, -1)), output_file_(std::move(other.output_file_)) {}
  ~Process() {
    if (pid_ > 0) {
      end(SIGTERM);
      if (!wait(std::chrono::seconds(10))) end(SIGKILL), wait(std::chrono::seconds(10));
    }
  }

  void end(int signal) const {
    if (pid_ > 0) ::kill(pid_, signal);
  }

  /// @returns whether it ended in that time; then exit_code() holds.
  bool wait(std::chrono::milliseconds at_most) {
    const auto until = std::chrono::steady_clock::now() + at_most;
    while (pid_ > 0) {
      int status = 0;
      if (::waitpid(pid_, &status, WNOHANG) == pid_) {
        exit_code_ = WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
        pid_ = -1;
        return true;
      }
      if (std::chrono::steady_clock::now() > until) return false;
      std::this_thread::sleep_for(std::chrono::milliseconds(2));
    }
    return true;
  }

  int exit_code() const { return exit_code_; }
  std::string output() const { return read_text(output_file_); }
  bool says(const std::string& words) const { return output().find(words) != std::string::npos; }

 private:
  pid_t pid_ = -1;
  int exit_code_ = -1;
  std::string output_file_;
};

}  // namespace secondskin::session
