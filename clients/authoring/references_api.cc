#include "clients/authoring/references_api.h"

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <iterator>
#include <map>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>

#include "clients/authoring/export_motion.h"
#include "clients/authoring/scratch.h"
#include "clients/dashboard/json_answer.h"
#include "coach/reference.h"
#include "motion/whole_file.h"
#include "server/replay/motion_source.h"

namespace secondskin::authoring {

namespace fs = std::filesystem;
using dashboard::error_response;
using dashboard::HttpRequest;
using dashboard::HttpResponse;
using nlohmann::json;

namespace {

constexpr std::string_view kList = "/api/references", kExport = "/export";

class Api {
 public:
  explicit Api(ReferencesApi from) : api_(std::move(from)) {}

  // Loading averages the experts, so what is known of an unchanged folder is kept.
  json list() {
    json all = json::array();
    for (const fs::path& folder : api_.references()) {
      std::error_code error;
      const auto changed = fs::last_write_time(folder / "motion.toml", error);
      Known& known = known_[folder.string()];
      if (known.entry.is_null() || known.changed != changed) {
        known.changed = changed;
        try {
          const auto reference = coach::load_reference(folder, api_.joint_maps);
          known.entry = {{"name", folder.filename().string()},
                         {"description", reference.description},
                         {"duration", reference.motion.duration()},
                         {"performances", reference.experts},
                         {"own", folder.parent_path() == api_.own}};
        } catch (const std::exception& why) {  // one bad folder must not hide the others
          spdlog::warn("{}", why.what());
          known.entry = nullptr;
          continue;
        }
      }
      all.push_back(known.entry);
    }
    return all;
  }

  HttpResponse export_reference(const HttpRequest& request, const std::string& name) {
    static constexpr std::pair<const char*, const char*> kKinds[] = {
        {"bvh", "text/plain; charset=utf-8"},
        {"c3d", "application/octet-stream"},
        {"trc", "text/plain; charset=utf-8"},
        {"csv", "text/csv; charset=utf-8"},
        {"mcap", "application/octet-stream"}};
    const auto format = request.query.find("format");
    const auto* kind = std::find_if(std::begin(kKinds), std::end(kKinds), [&](const auto& each) {
      return format != request.query.end() && format->second == each.first;
    });
    if (kind == std::end(kKinds)) {
      return error_response(400, "format: expected bvh, c3d, trc, csv or mcap");
    }
    // By name only: who asks over the network must not make us read any file.
    const auto folders = api_.references();
    const auto folder = std::find_if(folders.begin(), folders.end(),
                                     [&](const fs::path& f) { return f.filename() == name; });
    if (folder == folders.end()) {
      return error_response(
          404, fmt::format("reference '{:.64}': expected the name of a known one", name));
    }
    const auto reference = coach::load_reference(*folder, api_.joint_maps);
    server::MotionSource source(reference.motion);
    const Scratch scratch;
    const fs::path file = scratch.folder() / fmt::format("export.{}", kind->first);
    export_source(source, "reference:" + name, api_.idl, file);
    return {.status = 200,
            .content_type = kind->second,
            .body = read_whole_file(file),
            .file_name = fmt::format("{}.{}", name, kind->first)};
  }

 private:
  struct Known {
    fs::file_time_type changed;
    json entry;
  };

  ReferencesApi api_;
  std::map<std::string, Known> known_;
};

}  // namespace

dashboard::HttpHandler references_api(ReferencesApi from) {
  return [api = std::make_shared<Api>(std::move(from))](
             const HttpRequest& request) -> std::optional<HttpResponse> {
    const bool list = request.path == kList;
    // What is known of one reference is another handler's.
    const bool file = !list && request.path.starts_with(std::string(kList) + "/") &&
                      request.path.ends_with(kExport);
    if (!list && !file) return std::nullopt;
    if (request.method != "GET") return error_response(405, "method: expected GET");
    if (file) {
      const std::size_t begin = kList.size() + 1;
      return api->export_reference(
          request, request.path.substr(begin, request.path.size() - kExport.size() - begin));
    }
    return HttpResponse{.body = api->list().dump(-1, ' ', false, json::error_handler_t::replace),
                        .file_name = {}};
  };
}

}  // namespace secondskin::authoring
