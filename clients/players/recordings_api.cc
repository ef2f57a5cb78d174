#include "clients/players/recordings_api.h"

#include <fmt/format.h>

#include <algorithm>
#include <nlohmann/json.hpp>

#include "clients/dashboard/json_answer.h"
#include "clients/players/jobs.h"
#include "clients/players/recordings.h"
#include "recording/mcap_reader.h"

namespace secondskin::players {
namespace {

namespace fs = std::filesystem;
using dashboard::error_response;
using dashboard::HttpRequest;
using dashboard::HttpResponse;
using dashboard::iso_time;
using dashboard::json_answer;
using Json = nlohmann::json;

constexpr std::string_view kPath = "/api/recordings";
constexpr std::size_t kMostResults = 24, kMostStates = 200;  // files that are kept
constexpr const char* kMcap = "application/octet-stream";

HttpResponse file_response(const fs::path& file) {
  return {.content_type = kMcap, .body = {}, .file_name = {}, .file = file};
}

Json json_of(const RecordingInfo& info) {
  constexpr const char* kStates[] = {"finished", "being recorded", "unfinished", "damaged"};
  Json out{{"name", info.name},
           {"bytes", info.bytes},
           {"state", kStates[static_cast<int>(info.state)]},
           {"coached", info.coached},
           {"references", info.references},
           {"repetitions", info.repetitions}};
  if (!info.error.empty()) out["error"] = info.error;
  if (info.start_ns > 0) {
    out["subject"] = info.subject;
    out["start"] = iso_time(info.start_ns);
    out["duration"] = static_cast<double>(info.end_ns - info.start_ns) * 1e-9;
  }
  return out;
}

/// @throws std::runtime_error naming the field and what was expected
RerunSettings settings_of(const std::string& body) {
  const Json json = body.empty() ? Json::object() : Json::parse(body, nullptr, false);
  if (!json.is_object()) throw std::runtime_error("body: expected a JSON object");
  RerunSettings out;
  for (const auto& [key, value] : json.items()) {
    const auto text = [&, key = key, value = value] {
      if (!value.is_string()) throw std::runtime_error(fmt::format("{}: expected a name", key));
      return value.get<std::string>();
    };
    if (key == "reference") {
      out.reference = text();
    } else if (key == "plan") {
      out.plan = text();
    } else if (key == "body_map") {
      out.body_map = text();
    } else if (key == "tolerance_scale") {
      if (!value.is_number() || value < 0.1 || value > 10.0) {
        throw std::runtime_error("tolerance_scale: expected a number from 0.1 to 10");
      }
      out.tolerance_scale = value.get<double>();
    } else if (key == "max_cues") {
      if (!value.is_number_integer() || value < 1 || value > kJointCount) {
        throw std::runtime_error(fmt::format("max_cues: expected 1 to {}", kJointCount));
      }
      out.max_cues = value.get<std::uint32_t>();
    } else {
      throw std::runtime_error(fmt::format(
          "{:.64}: expected reference, tolerance_scale, max_cues, body_map or plan", key));
    }
  }
  return out;
}

class Api {
 public:
  explicit Api(RecordingsApi api)
      : api_(std::move(api)),
        recordings_(api_.folder),
        jobs_(recordings_.computed(), kMostResults),
        quick_(recordings_.states(), kMostStates) {}

  std::optional<HttpResponse> answer(const HttpRequest& request) {
    if (request.path == kPath) {
      if (request.method == "DELETE") return forget(request);
      if (request.method != "GET") return wrong_method(request, "GET or DELETE");
      Json all = Json::array();
      for (const auto& info : recordings_.list()) all.push_back(describe(info));
      return json_answer(200, all);
    }
    if (!request.path.starts_with(kPath) || request.path[kPath.size()] != '/') return {};
    const std::string rest = request.path.substr(kPath.size() + 1);
    constexpr std::string_view kRemovals = "removals/", kReruns = "reruns/";
    if (rest.starts_with(kRemovals)) {
      return request.method == "GET" ? removal(rest.substr(kRemovals.size()))
                                     : wrong_method(request, "GET");
    }
    // A name with an escaped "/" in it is none that find() takes.
    const auto slash = rest.find(".mcap/");
    const std::string name = slash == rest.npos ? rest : rest.substr(0, slash + 5);
    const std::string what = slash == rest.npos ? "" : rest.substr(slash + 6);
    const auto file = recordings_.find(name);
    if (!file) {
      return error_response(404,
                            fmt::format("recording '{:.100}': expected the name of a .mcap file "
                                        "in the recordings' folder",
                                        name));
    }
    const bool reads = request.method == "GET" || request.method == "HEAD";
    if (what == "rerun") {
      return request.method == "POST" ? rerun(*file, request.body) : wrong_method(request, "POST");
    }
    if (what == "repaired" && request.method == "POST") {
      const auto [key, status] = repair(*file);
      return json_answer(202, job_json(key, status));
    }
    if (!reads) return wrong_method(request, "GET");
    if (what.empty()) return json_answer(200, describe(recordings_.describe(*file)));
    if (what == "file") return file_response(*file);
    if (what == "states") return states(*file);
    if (what == "expert") return expert(*file);
    if (what == "repaired") {
      const auto [key, status] = repair(*file);
      return answer_of(key, status);
    }
    constexpr std::string_view kRepaired = "repaired/";
    if (what.starts_with(kRepaired)) return repaired(what.substr(kRepaired.size()));
    if (what.starts_with(kReruns)) return rerun_result(what.substr(kReruns.size()));
    return error_response(
        404, fmt::format("'{:.100}': expected file, states, expert, repaired, rerun or reruns/JOB",
                         what));
  }

 private:
  static HttpResponse wrong_method(const HttpRequest& request, const char* expected) {
    return error_response(
        405, fmt::format("{} {}: expected {}", request.method, request.path, expected));
  }

  Json job_json(const std::string& key, const JobStatus& status) const {
    constexpr const char* kStates[] = {"waiting", "running", "done", "failed"};
    Json out{{"job", key},
             {"state", kStates[static_cast<int>(status.state)]},
             {"progress", status.progress}};
    if (!status.error.empty()) out["error"] = recordings_.without_folder(status.error);
    if (!status.note.empty()) out["result"] = Json::parse(status.note);
    return out;
  }

  /// The file of a job that is done, else how far it is.
  HttpResponse answer_of(const std::string& key, const JobStatus& status) {
    if (status.state == JobStatus::State::kDone) return file_response(status.file);
    if (status.state != JobStatus::State::kFailed) return json_answer(202, job_json(key, status));
    const std::string why = recordings_.without_folder(status.error);
    if (!status.may_pass) return error_response(409, why);
    for (Jobs* jobs : {&jobs_, &quick_}) jobs->drop(key);  // who asks again begins again
    return error_response(503, why);
  }

  Json describe(const RecordingInfo& info) {
    if (!info.read) {
      const fs::path file = recordings_.folder() / info.name;
      quick_.ensure(Recordings::key_of(file, "scan"),
                    [this, file](const auto&, const auto&, std::stop_token) {
                      recordings_.scan(file);
                      return std::string();
                    });
    }
    return json_of(info);
  }

  HttpResponse forget(const HttpRequest& request) {
    const auto learner = request.query.find("learner");
    if (learner == request.query.end() || learner->second.empty()) {
      return error_response(400, "learner: expected the id of the learner whose recordings go");
    }
    const std::string key = "removal-" + Recordings::digest(learner->second);
    quick_.drop(key);  // what was done for them before
    const auto status = quick_.ensure(
        key, [this, id = learner->second](const auto&, const auto& progress, std::stop_token stop) {
          const auto pause = jobs_.pause();  // or it would write down again what is just removed
          const Forgotten forgotten = recordings_.forget(id, progress, stop);
          Json kept = Json::array();
          for (const auto& [name, why] : forgotten.kept)
            kept.push_back({{"name", name}, {"why", why}});
          return Json{{"removed", forgotten.removed}, {"kept", std::move(kept)}}.dump(
              -1, ' ', false, Json::error_handler_t::replace);
        });
    return json_answer(202, job_json(key, status));
  }

  HttpResponse removal(const std::string& key) {
    const auto status = key.starts_with("removal-") ? quick_.find(key) : std::nullopt;
    if (status) return json_answer(200, job_json(key, *status));
    return error_response(404, fmt::format("removal '{:.100}': expected the job of a DELETE", key));
  }

  HttpResponse states(const fs::path& file) {
    const std::string key = Recordings::key_of(file, "states");
    return answer_of(key, quick_.ensure(key, [file](const fs::path& part, const auto& progress,
                                                    std::stop_token stop) {
      write_states(file, part, progress, stop);
      return std::string();
    }));
  }

  HttpResponse expert(const fs::path& file) {
    const std::string key = Recordings::key_of(file, "expert");
    return answer_of(key, jobs_.ensure(key, [this, file](const fs::path& part, const auto& progress,
                                                         std::stop_token stop) {
      write_expert(file, api_.idl, api_.library.reference, part, progress, stop);
      return std::string();
    }));
  }

  /// A copy of the file as it is now.
  std::pair<std::string, JobStatus> repair(const fs::path& file) {
    const std::string key = Recordings::key_of(file, "repaired");
    return {key, jobs_.ensure(key, [file](const fs::path& part, const auto&, std::stop_token) {
              if (recording::repair(file, part) == 0) {
                throw std::runtime_error(
                    fmt::format("{}: holds no whole message", file.filename().string()));
              }
              return std::string();
            })};
  }

  /// That copy, and its states and expert, while the file itself may grow on.
  HttpResponse repaired(std::string key) {
    const auto slash = key.find('/');
    const std::string what = slash == key.npos ? "" : key.substr(slash + 1);
    key.resize(std::min(slash, key.size()));
    const auto status = jobs_.find(key);
    if (!status || !key.starts_with("repaired-")) {
      return error_response(404, fmt::format("copy '{:.100}': expected the job of a POST", key));
    }
    if (what.empty() || status->state != JobStatus::State::kDone) return answer_of(key, *status);
    if (what == "states") return states(status->file);
    if (what == "expert") return expert(status->file);
    return error_response(404, fmt::format("'{:.100}': expected states or expert", what));
  }

  HttpResponse rerun(const fs::path& file, const std::string& body) {
    RerunSettings settings;
    try {
      settings = settings_of(body);
      // So that a wrong name is told at once.
      if (!settings.reference.empty()) api_.library.reference(settings.reference);
      if (!settings.body_map.empty()) api_.library.body_map(settings.body_map);
      if (!settings.plan.empty() && settings.plan != "none") api_.library.plan(settings.plan);
    } catch (const std::exception& error) {
      return error_response(400, error.what());
    }
    const std::string key = Recordings::key_of(
        file, "rerun",
        fmt::format("{}|{}|{}|{}|{}", settings.reference, settings.tolerance_scale.value_or(0.0),
                    settings.max_cues.value_or(0), settings.body_map, settings.plan));
    if (const auto before = jobs_.find(key); before && before->may_pass) jobs_.drop(key);
    const auto status = jobs_.ensure(key, [this, file, settings](const fs::path& part,
                                                                 const auto& progress,
                                                                 std::stop_token stop) {
      const auto result = rerun_coach(file, api_.idl, api_.library, settings, part, progress, stop);
      Json totals = Json::array();
      for (const auto& score : result.repetitions) totals.push_back(score.total);
      return Json{{"frames", result.frames},
                  {"cues", result.cues},
                  {"totals", std::move(totals)},
                  {"remarks", result.remarks}}
          .dump(-1, ' ', false, Json::error_handler_t::replace);
    });
    return json_answer(202, job_json(key, status));
  }

  /// @param asked  JOB, JOB/file or JOB/states
  HttpResponse rerun_result(const std::string& asked) {
    const auto slash = std::min(asked.find('/'), asked.size());
    const std::string key = asked.substr(0, slash), what = asked.substr(slash);
    const auto status = key.starts_with("rerun-") ? jobs_.find(key) : std::nullopt;
    if (!status || (!what.empty() && what != "/file" && what != "/states")) {
      return error_response(404, fmt::format("re-run '{:.100}': expected the job of a POST, and "
                                             "file or states",
                                             asked));
    }
    if (what.empty()) return json_answer(200, job_json(key, *status));
    const bool done = status->state == JobStatus::State::kDone;
    return done && what == "/states" ? states(status->file) : answer_of(key, *status);
  }

  RecordingsApi api_;
  Recordings recordings_;
  // Last: their work uses the others. Two, since a re-run takes minutes: what is made at once by
  // reading, and waited for by whoever opens a recording or removes a learner, goes beside it.
  Jobs jobs_, quick_;
};

}  // namespace

dashboard::HttpHandler recordings_api(RecordingsApi api) {
  return [api = std::make_shared<Api>(std::move(api))](const HttpRequest& request) {
    return api->answer(request);
  };
}

}  // namespace secondskin::players
