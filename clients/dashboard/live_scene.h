#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <span>
#include <stop_token>
#include <string>
#include <vector>

#include "coach/reference.h"

/// What is drawn of a live session: the expert's ghost with each alignment; transforms and scene at
/// most kSceneRate times a second. Computed on a thread of its own, only while somebody looks.
namespace secondskin::dashboard {

inline constexpr double kSceneRate = 30.0;  ///< [Hz]

enum class Drawn : std::uint8_t { kExpert, kTransforms, kScene };

struct LiveSceneOptions {
  std::string subject;
  /// Null or an exception where there is none of that name.
  std::function<std::shared_ptr<const coach::Reference>(const std::string& name)> reference;
  std::function<bool(Drawn)> wanted;  ///< whether somebody looks; any thread
  std::function<void(Drawn, std::int64_t time_ns, std::vector<std::uint8_t> bytes)> publish;
};

class LiveScene {
 public:
  explicit LiveScene(LiveSceneOptions options);
  ~LiveScene();

  /// Notes a message of a topic (a place in bus::kTopics); only the newest of each counts. One
  /// thread; never waits for what is computed.
  void take(std::size_t topic, std::int64_t source_ns, std::span<const std::uint8_t> bytes);

  void run(std::stop_token stop);

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace secondskin::dashboard
