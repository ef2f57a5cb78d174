#include "clients/history/history_api.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cctype>
#include <charconv>
#include <chrono>
#include <memory>
#include <nlohmann/json.hpp>

#include "clients/dashboard/json_answer.h"
#include "clients/history/history.h"
#include "clients/history/history_json.h"
#include "clients/history/pdf.h"
#include "clients/history/profiles.h"
#include "clients/history/report.h"

namespace secondskin::history {
namespace {

using dashboard::error_response;
using dashboard::HttpRequest;
using dashboard::HttpResponse;
using dashboard::json_answer;
using dashboard::Refusal;
using nlohmann::json;

constexpr std::string_view kRoot = "/api/history/";
constexpr std::size_t kLongestNote = 2000;

std::string asked(const HttpRequest& request, const std::string& field, const std::string& what) {
  const auto found = request.query.find(field);
  if (found == request.query.end() || found->second.empty()) {
    throw Refusal{400, fmt::format("{}: expected {}", field, what)};
  }
  return found->second;
}

std::string choice(const HttpRequest& request, const std::string& first,
                   const std::string& second) {
  const auto words = fmt::format("\"{}\" or \"{}\"", first, second);
  const std::string value = asked(request, "format", words);
  if (value != first && value != second) {
    throw Refusal{400, fmt::format("format: expected {}, got \"{}\"", words, value)};
  }
  return value;
}

/// Of a file that is offered; an id that another program gave may hold anything.
std::string file_name(const char* what, const std::string& id, const char* kind) {
  std::string safe = id;
  std::replace_if(
      safe.begin(), safe.end(),
      [](unsigned char c) { return std::isalnum(c) == 0 && c != '-' && c != '_'; }, '_');
  return fmt::format("{}_{}.{}", what, safe, kind);
}

Learner known(History& history, const std::string& id) {
  if (auto learner = history.learner(id)) return std::move(*learner);
  throw Refusal{404, fmt::format("learner: expected the id of a known learner, got \"{}\"", id)};
}

Learner asked_learner(History& history, const HttpRequest& request) {
  return known(history, asked(request, "learner", "a learner's id"));
}

std::string note_of(const HttpRequest& request, bool needed) {
  constexpr const char* kWhat = R"(a JSON object {"note": "text"})";
  if (request.body.empty() && !needed) return {};
  const json body = json::parse(request.body, nullptr, false);
  if (!body.is_object()) throw Refusal{400, fmt::format("body: expected {}", kWhat)};
  for (const auto& [field, value] : body.items()) {
    if (field != "note") throw Refusal{400, fmt::format("{}: expected {} only", field, kWhat)};
  }
  if (!body.contains("note")) {
    if (needed) throw Refusal{400, fmt::format("note: expected {}", kWhat)};
    return {};
  }
  if (!body["note"].is_string() ||
      body["note"].get_ref<const std::string&>().size() > kLongestNote) {
    throw Refusal{400, fmt::format("note: expected a text of at most {} bytes", kLongestNote)};
  }
  return body["note"];
}

// ---- the requests

HttpResponse all_learners(History& history, const HttpRequest& request) {
  if (request.method == "POST") {
    return json_answer(201, to_json(history.add_learner(note_of(request, false))));
  }
  if (request.method != "GET") throw Refusal{405, "method: expected GET or POST"};
  json all = json::array();
  for (const Learner& learner : history.learners()) all.push_back(to_json(learner));
  return json_answer(200, all);
}

HttpResponse one_learner(History& history, const HttpRequest& request, const std::string& id,
                         const std::filesystem::path& profiles) {
  if (request.method == "GET") return json_answer(200, to_json(known(history, id)));
  if (request.method == "PATCH") {
    const std::string note = note_of(request, true);
    known(history, id);
    history.note(id, note);
    return json_answer(200, to_json(known(history, id)));
  }
  if (request.method == "DELETE") {
    known(history, id);
    remove_profile(profiles, id);  // first: if that fails, the learner is still there to try again
    history.forget(id);
    return {.status = 204, .content_type = "application/json", .body = {}, .file_name = {}};
  }
  throw Refusal{405, "method: expected GET, PATCH or DELETE"};
}

HttpResponse all_sessions(History& history, const HttpRequest& request) {
  const auto learner = request.query.find("learner");
  json all = json::array();
  const std::string whose =
      learner == request.query.end() ? std::string() : known(history, learner->second).id;
  for (const Session& session : history.sessions(whose)) all.push_back(to_json(session, false));
  return json_answer(200, all);
}

HttpResponse one_session(History& history, const std::string& text) {
  std::int64_t id = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), id);
  const bool number = error == std::errc() && end == text.data() + text.size();
  if (auto session = number ? history.session(id) : std::nullopt) {
    return json_answer(200, to_json(*session, true));
  }
  throw Refusal{404, fmt::format("session: expected the id of a known session, got \"{}\"", text)};
}

HttpResponse progress_of(History& history, const HttpRequest& request) {
  const Learner learner = asked_learner(history, request);
  const auto course = history.course(learner.id);
  const auto names = practised_references(course);
  const std::string what = names.empty() ? std::string("a reference; this learner practised none")
                                         : fmt::format("one of {}", fmt::join(names, ", "));
  const std::string reference = asked(request, "reference", what);
  return json_answer(200, to_json(progress(course, reference), reference));
}

HttpResponse report_of(History& history, const HttpRequest& request) {
  const bool pdf = choice(request, "html", "pdf") == "pdf";
  const Learner learner = asked_learner(history, request);
  const auto now = std::chrono::system_clock::now().time_since_epoch();
  const auto made_ns = std::chrono::duration_cast<std::chrono::nanoseconds>(now).count();
  std::string html = report_html(learner, history.course(learner.id), made_ns);
  if (!pdf) {
    return {.status = 200,
            .content_type = "text/html; charset=utf-8",
            .body = std::move(html),
            .file_name = {}};
  }
  try {
    return {.status = 200,
            .content_type = "application/pdf",
            .body = pdf_of(html),
            .file_name = file_name("report", learner.id, "pdf")};
  } catch (const std::exception& error) {
    throw Refusal{503, error.what()};
  }
}

HttpResponse export_of(History& history, const HttpRequest& request) {
  const bool csv = choice(request, "csv", "json") == "csv";
  const Learner learner = asked_learner(history, request);
  const auto course = history.course(learner.id);
  HttpResponse response = csv ? HttpResponse{.status = 200,
                                             .content_type = "text/csv; charset=utf-8",
                                             .body = export_csv(course),
                                             .file_name = {}}
                              : json_answer(200, export_json(learner, course));
  response.file_name = file_name("history", learner.id, csv ? "csv" : "json");
  return response;
}

HttpResponse dispatch(History& history, const HttpRequest& request, const std::string& what,
                      const std::filesystem::path& profiles) {
  constexpr std::string_view kLearner = "learners/", kSession = "sessions/";
  if (what == "learners") return all_learners(history, request);
  if (what.starts_with(kLearner)) {
    return one_learner(history, request, what.substr(kLearner.size()), profiles);
  }
  using Read = HttpResponse (*)(History&, const HttpRequest&);
  static constexpr std::pair<std::string_view, Read> kReads[] = {{"sessions", all_sessions},
                                                                 {"progress", progress_of},
                                                                 {"report", report_of},
                                                                 {"export", export_of}};
  const auto* read = std::find_if(std::begin(kReads), std::end(kReads),
                                  [&](const auto& entry) { return entry.first == what; });
  const bool session = what.starts_with(kSession);
  if (read == std::end(kReads) && !session) {
    throw Refusal{404, fmt::format("path: expected {}learners, sessions, progress, report or "
                                   "export, got \"{}\"",
                                   kRoot, what)};
  }
  if (request.method != "GET") throw Refusal{405, "method: expected GET"};
  return session ? one_session(history, what.substr(kSession.size()))
                 : read->second(history, request);
}

}  // namespace

dashboard::HttpHandler history_api(std::filesystem::path database, std::filesystem::path profiles) {
  return [file = std::move(database), profiles = std::move(profiles),
          history = std::shared_ptr<History>()](
             const HttpRequest& request) mutable -> std::optional<HttpResponse> {
    if (!request.path.starts_with(kRoot)) return std::nullopt;
    try {
      if (!history) history = std::make_shared<History>(file);
      return dispatch(*history, request, request.path.substr(kRoot.size()), profiles);
    } catch (const Refusal& refusal) {
      return error_response(refusal.status, refusal.words);
    } catch (const std::exception& error) {
      history.reset();  // opened anew with the next request
      return error_response(503, fmt::format("history: {}", error.what()));
    }
  };
}

}  // namespace secondskin::history
