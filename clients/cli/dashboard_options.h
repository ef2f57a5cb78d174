#pragma once

#include <CLI/CLI.hpp>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "clients/authoring/takes_api.h"
#include "clients/cli/common.h"
#include "clients/dashboard/dashboard_service.h"
#include "clients/history/history_service.h"

/// Options of the commands that serve the dashboard.
namespace secondskin::cli {

struct PageOptions {
  std::uint16_t port = 8765;
  std::string bind = "127.0.0.1";
  std::string token;
  std::vector<std::string> allowed_origins;
  std::filesystem::path page;     ///< empty: Library::page()
  std::filesystem::path history;  ///< empty: Library::own_history(); kNoHistory
  static constexpr const char* kNoHistory = "none";
  std::filesystem::path recordings = "recordings";  ///< shown in the page

  /// Makes a token where one is needed and none was given.
  /// @param own  references that the library may not know, e.g. of a file on the command line
  dashboard::DashboardOptions prepare(
      const std::string& subject, const Library& library,
      const std::vector<std::shared_ptr<const coach::Reference>>& own = {}) const;
};

/// Books the subject's sessions into the options' history while it lives; nothing where none is
/// wanted.
class SessionHistory {
 public:
  SessionHistory(bus::Participant& participant, const PageOptions& options, const Library& library);
  ~SessionHistory();
  SessionHistory(const SessionHistory&) = delete;
  SessionHistory& operator=(const SessionHistory&) = delete;

  /// Ends the booking; what was heard is written.
  void end();

 private:
  std::unique_ptr<history::HistoryService> service_;
  std::jthread thread_;
};

/// Records references at the page: takes of whoever the subject's capture server measures.
class TakeRecording {
 public:
  TakeRecording(bus::Participant& participant, const Library& library);
  TakeRecording(const TakeRecording&) = delete;
  TakeRecording& operator=(const TakeRecording&) = delete;

  /// Answers while this lives.
  dashboard::HttpHandler handler() const { return handler_; }

 private:
  dashboard::HttpHandler handler_;
  std::jthread thread_;
};

/// @param port_option  "--port" where no other port is meant
void add_page_options(CLI::App& command, PageOptions& options, const std::string& port_option);

/// What to open in a browser.
std::string page_address(const dashboard::DashboardOptions& options, std::uint16_t port);

}  // namespace secondskin::cli
