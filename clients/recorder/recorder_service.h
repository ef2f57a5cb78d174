#pragma once

#include <chrono>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <stop_token>
#include <string>

#include "bus/participant.h"

/// Writes everything that travels about one subject into an MCAP file, as it travelled.
namespace secondskin::recorder {

struct RecorderOptions {
  std::filesystem::path file;
  std::filesystem::path idl;  ///< idl/secondskin_msgs.idl: the schema in every recording
};

struct RecorderCounts {
  std::uint64_t messages = 0;
  std::uint64_t bytes = 0;
  std::uint64_t lost = 0;  ///< messages that did not arrive, by the bus and by the poses' frames
  std::string error;       ///< why recording ended early; empty when it did not
};

class RecorderService {
 public:
  /// @throws std::system_error naming the file when it cannot be made.
  RecorderService(bus::Participant& participant, const RecorderOptions& options);
  ~RecorderService();

  /// Sleeps until so many topics have a writer, so that nothing that matters passes unheard; run()
  /// must be under way. @returns false when the time came first.
  bool wait_until_heard(std::size_t topics, std::chrono::nanoseconds at_most);

  /// Records until a stop is asked for or the disk refuses; what was stored stays whole. Never
  /// throws for a full disk: the session goes on, health and the counts say it.
  RecorderCounts run(std::stop_token stop);

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace secondskin::recorder
