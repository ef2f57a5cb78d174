#pragma once

#include "process.h"
#include "waveform.h"

namespace secondskin::session {

using namespace std::chrono_literals;

/// Waits for a condition on other processes, of which nothing else tells a test.
template <class Condition>
bool eventually(Condition done, std::chrono::milliseconds at_most) {
  const auto end = std::chrono::steady_clock::now() + at_most;
  while (!done()) {
    if (std::chrono::steady_clock::now() > end) return false;
    std::this_thread::sleep_for(2ms);
  }
  return true;
}

/// The parts of a session as processes, on a DDS domain and subject of this test's own.
class Session {
 public:
  std::vector<std::string> on_bus(std::vector<std::string> command) const {
    command.insert(command.end(), {"--domain", std::to_string(10 + ::getpid() % 90), "--subject",
                                   "test_" + std::to_string(::getpid())});
    return command;
  }
  Process start(const std::string& name, const std::vector<std::string>& command,
                void (*prepare)() = nullptr) const {
    return Process(command, folder / (name + ".log"), prepare);
  }
  Process board() const {
    return start("board", {"virtual-board", "--link", port(), "--waveform", waveform()});
  }
  Process tactors() const { return start("tactors", on_bus({"tactors", "--port", port()})); }
  // Narrow tolerances: something is cued nearly all the time.
  Process coach() const {
    return start("coach",
                 on_bus({"coach", "--reference", "low_block", "--tolerance-scale", "0.2"}));
  }
  Process capture() const {
    return start(
        "capture",
        on_bus({"capture", SECONDSKIN_SOURCE_DIR "/reference_motions/low_block/learner.bvh",
                "--loop"}));
  }
  std::string port() const { return folder / "board"; }
  std::string waveform() const { return folder / "waveform.csv"; }
  bool tactors_are_on() const { return is_on(waveform()); }

  Folder folder;
};

}  // namespace secondskin::session
