#pragma once

#include <filesystem>
#include <functional>
#include <map>
#include <optional>
#include <string>

/// What answers an HTTP request of the dashboard's port, without knowing of sockets.
namespace secondskin::dashboard {

struct HttpRequest {
  std::string method;                        ///< "GET", "POST", ...
  std::string path;                          ///< decoded, without the query
  std::map<std::string, std::string> query;  ///< decoded
  std::string body;
};

struct HttpResponse {
  unsigned status = 200;
  std::string content_type = "application/json";
  std::string body;
  std::string file_name;  ///< offered for download; empty: shown
  /// Sent in the place of `body` where it is given: whole or the asked range, never held in memory.
  std::filesystem::path file = {};
};

/// Answers the requests that are its own; nothing for another's. Called on a worker thread, one at
/// a time, never on the thread that sends live data.
using HttpHandler = std::function<std::optional<HttpResponse>(const HttpRequest&)>;

}  // namespace secondskin::dashboard
