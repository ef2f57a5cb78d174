#pragma once

#include <filesystem>
#include <functional>
#include <memory>
#include <stop_token>
#include <string>
#include <vector>

#include "bus/participant.h"
#include "clients/dashboard/web_server.h"
#include "coach/reference.h"

/// The bridge: everything that travels about one subject, as it travels, to WebSocket clients in
/// the Foxglove protocol; and their session commands and emergency stops back.
///
/// Threads: run()'s reads the topics and hands over; the sockets' (web_server.h) writes commands
/// and stops to the bus; one computes what is drawn (live_scene.h), while somebody looks. None
/// waits for a client.
namespace secondskin::dashboard {

struct DashboardOptions {
  WebServerOptions web;
  std::filesystem::path idl;               ///< idl/secondskin_msgs.idl: the schema of the topics
  std::filesystem::path foxglove_schemas;  ///< a folder: FrameTransforms.json, SceneUpdate.json
  /// A reference by the name in session_state; null where it is not known here. Thread-safe.
  std::function<std::shared_ptr<const coach::Reference>(const std::string& name)> reference;
  std::vector<HttpHandler> handlers;  ///< under /api/
};

struct DashboardCounts {
  std::uint64_t messages = 0;  ///< that were handed to the sockets
  WebServerCounts web;
};

class DashboardService {
 public:
  /// Takes the port. @throws std::runtime_error naming the port or the file.
  DashboardService(bus::Participant& participant, DashboardOptions options);
  ~DashboardService();

  std::uint16_t port() const noexcept;

  /// Serves until a stop is asked for.
  DashboardCounts run(std::stop_token stop);

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace secondskin::dashboard
