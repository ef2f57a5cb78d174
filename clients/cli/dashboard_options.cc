#include "clients/cli/dashboard_options.h"

#include <fmt/format.h>
#include <spdlog/spdlog.h>
#include <sys/random.h>

#include <algorithm>
#include <array>
#include <cctype>
#include <set>
#include <stdexcept>
#include <system_error>

#include "clients/authoring/references_api.h"
#include "clients/dashboard/library_api.h"
#include "clients/dashboard/static_files.h"
#include "clients/history/history_api.h"
#include "clients/players/recordings_api.h"

namespace secondskin::cli {
namespace {

constexpr const char* kNoPage =
    "<!doctype html><meta charset=\"utf-8\"><title>Second Skin</title>"
    "<h1>Second Skin</h1><p>The bridge runs, but the page has not been built. In the source tree:"
    "<pre>cd clients/dashboard/web\nnpm ci\nnpm run build</pre>"
    "<p>and load this page again. Foxglove and other programs connect to this port already.";

std::string random_token() {
  std::array<unsigned char, 16> bytes;
  if (::getrandom(bytes.data(), bytes.size(), 0) != static_cast<ssize_t>(bytes.size())) {
    throw std::system_error(errno, std::generic_category(), "no random numbers for a token");
  }
  std::string text;
  for (const unsigned char byte : bytes) text += fmt::format("{:02x}", byte);
  return text;
}

/// Of the .toml files in a folder that comes with the program.
std::set<std::string> names_in(const std::filesystem::path& folder) {
  std::set<std::string> names;
  std::error_code error;
  for (std::filesystem::directory_iterator it(folder, error), end; !error && it != end;
       it.increment(error)) {
    if (it->path().extension() == ".toml") names.insert(it->path().stem().string());
  }
  return names;
}

std::vector<coach::SessionPlan> all_plans(const Library& library) {
  std::vector<coach::SessionPlan> plans;
  for (const auto& name : names_in(library.root() / "plans")) {
    try {
      plans.push_back(library.load_plan(name));
    } catch (const std::exception& why) {
      spdlog::warn("{}", why.what());
    }
  }
  return plans;
}

/// Where sessions are booked; empty: nowhere.
std::filesystem::path database(const PageOptions& options, const Library& library) {
  if (options.history == PageOptions::kNoHistory) return {};
  return options.history.empty() ? library.own_history() : options.history;
}

/// As below, of a file under the library.
const std::string& plain_name(const char* field, const std::string& name) {
  const auto plain = [](unsigned char c) { return std::isalnum(c) || c == '_' || c == '-'; };
  if (name.empty() || !std::all_of(name.begin(), name.end(), plain)) {
    throw std::runtime_error(
        fmt::format("{} '{:.64}': expected a name of letters, digits, '_' and '-'", field, name));
  }
  return name;
}

/// By name only: who asks over the network must not make us read any file.
std::shared_ptr<const coach::Reference> known_reference(const Library& library,
                                                        const std::string& names) {
  const auto folders = library.references();
  for (std::size_t begin = 0; begin <= names.size();) {
    const std::size_t end = std::min(names.find(kPerformances, begin), names.size());
    const std::string name = names.substr(begin, end - begin);
    if (std::none_of(folders.begin(), folders.end(),
                     [&](const auto& folder) { return folder.filename() == name; })) {
      std::string known;
      for (const auto& folder : folders) {
        known += (known.empty() ? "" : ", ") + folder.filename().string();
      }
      throw std::runtime_error(fmt::format("reference '{:.64}': expected one of {}", name, known));
    }
    begin = end + 1;
  }
  return library.load_reference(names);
}

}  // namespace

dashboard::DashboardOptions PageOptions::prepare(
    const std::string& subject, const Library& library,
    const std::vector<std::shared_ptr<const coach::Reference>>& own) const {
  dashboard::DashboardOptions options;
  options.web.bind = bind;
  options.web.port = port;
  options.web.largest_body = authoring::kLargestImport;
  options.web.page = page.empty() ? library.page() : page;
  options.web.no_page = kNoPage;
  options.web.access = {token, allowed_origins};
  if (token.empty() && !dashboard::is_loopback(bind)) options.web.access.token = random_token();
  options.idl = library.idl();
  options.foxglove_schemas = library.root() / "idl" / "foxglove";
  options.reference = [library, own](const std::string& name) {
    for (const auto& reference : own) {
      if (reference->name.substr(0, 64) == name) return reference;
    }
    return known_reference(library, name);
  };
  options.handlers.push_back(
      authoring::references_api({.joint_maps = library.joint_maps(),
                                 .idl = library.idl(),
                                 .own = library.own_references(),
                                 .references = [library] { return library.references(); }}));
  options.handlers.push_back(dashboard::handler(
      {.subject = subject,
       .version = SECONDSKIN_VERSION,
       .page_version = [files =
                            dashboard::StaticFiles(options.web.page)] { return files.version(); },
       .history = !database(*this, library).empty(),
       .plans = [library] { return all_plans(library); },
       .body_maps =
           [library] {
             const auto names = names_in(library.root() / "body_maps");
             return std::vector<std::string>(names.begin(), names.end());
           },
       .reference = options.reference}));
  if (const auto file = database(*this, library); !file.empty()) {
    options.handlers.push_back(history::history_api(file, library.own_profiles()));
  }
  options.handlers.push_back(players::recordings_api(
      {.folder = recordings,
       .idl = library.idl(),
       .library = {.reference = options.reference,
                   .body_map =
                       [library](const std::string& name) {
                         return library.load_body_map(plain_name("body_map", name));
                       },
                   .plan =
                       [library](const std::string& name) {
                         return library.load_plan(plain_name("plan", name));
                       }}}));
  return options;
}

SessionHistory::SessionHistory(bus::Participant& participant, const PageOptions& options,
                               const Library& library) {
  const auto file = database(options, library);
  if (file.empty()) return;
  service_ = std::make_unique<history::HistoryService>(participant, file);
  thread_ = std::jthread([this](std::stop_token stop) { service_->run(stop); });
}

SessionHistory::~SessionHistory() = default;

void SessionHistory::end() {
  if (!thread_.joinable()) return;
  thread_.request_stop();
  thread_.join();
}

TakeRecording::TakeRecording(bus::Participant& participant, const Library& library) {
  auto takes = std::make_shared<authoring::TakeStore>(library.own_takes(), library.joint_maps());
  auto recorder = std::make_shared<authoring::TakeRecorder>(
      participant, [takes](const authoring::Recorded& take) {
        takes->add(take.motion, take.source, take.start_ns, take.faults);
      });
  handler_ = authoring::takes_api({.takes = takes,
                                   .recorder = recorder,
                                   .import =
                                       [library](const std::filesystem::path& file) {
                                         const auto source =
                                             SourceOptions().open(file.string(), library);
                                         return server::read_all(*source);
                                       },
                                   .joint_maps = library.joint_maps(),
                                   .own = library.own_references(),
                                   .references = [library] { return library.references(); }});
  thread_ = std::jthread([recorder](std::stop_token stop) { recorder->run(stop); });
}

void add_page_options(CLI::App& command, PageOptions& options, const std::string& port_option) {
  command
      .add_option(port_option, options.port,
                  port_option == "--port" ? "of the page and its WebSocket; 0: any that is free"
                                          : "of the dashboard's page; 0: no dashboard")
      ->capture_default_str();
  command
      .add_option("--bind", options.bind,
                  "the dashboard's address; another than 127.0.0.1 opens it to the network, with a "
                  "token")
      ->capture_default_str();
  command.add_option("--token", options.token,
                     "what the page asks for (default: none on this machine, else a random one)");
  command.add_option("--allow-origin", options.allowed_origins,
                     "a web page that may connect beside the dashboard's own, e.g. "
                     "https://app.foxglove.dev");
  command.add_option("--page", options.page, "the folder of another page");
  command
      .add_option("--recordings", options.recordings,
                  "the folder of the recordings that the page can open")
      ->capture_default_str();
  command.add_option("--history", options.history,
                     "the database that sessions are booked into, 'none': not at all (default: the "
                     "user's own, see 'secondskin history --help')");
}

std::string page_address(const dashboard::DashboardOptions& options, std::uint16_t port) {
  const auto& web = options.web;
  const bool any = web.bind == "0.0.0.0" || web.bind == "::";
  const std::string host = any                                       ? "localhost"
                           : web.bind.find(':') != std::string::npos ? "[" + web.bind + "]"
                                                                     : web.bind;
  return fmt::format("http://{}:{}/{}", host, port,
                     web.access.token.empty() ? "" : "?token=" + web.access.token);
}

}  // namespace secondskin::cli
