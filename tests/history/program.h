#pragma once

#include <fcntl.h>
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <filesystem>
#include <string>
#include <vector>

namespace secondskin::history {

/// One of this folder's programs as a real process; what it prints goes to a file. Killed by its
/// id.
class Program {
 public:
  Program(const std::string& name, std::vector<std::string> words, const std::string& output,
          void (*prepare)() = nullptr) {
    const std::string path =
        (std::filesystem::path(SECONDSKIN_PROGRAM).parent_path() / name).string();
    pid_ = ::fork();
    if (pid_ != 0) return;
    const int out = ::open(output.c_str(), O_CREAT | O_TRUNC | O_WRONLY, 0600);
    ::dup2(out, 1);
    ::dup2(out, 2);
    if (prepare != nullptr) prepare();
    words.insert(words.begin(), path);
    std::vector<char*> argv;
    for (std::string& word : words) argv.push_back(word.data());
    argv.push_back(nullptr);
    ::execv(path.c_str(), argv.data());
    ::_exit(127);
  }
  ~Program() { end(SIGKILL); }
  Program(const Program&) = delete;
  Program& operator=(const Program&) = delete;

  /// Sends the signal and waits for the end. @returns the status, as waitpid gives it
  int end(int signal) {
    int status = 0;
    if (pid_ > 0) {
      ::kill(pid_, signal);
      ::waitpid(pid_, &status, 0);
      pid_ = -1;
    }
    return status;
  }

 private:
  pid_t pid_ = -1;
};

}  // namespace secondskin::history
