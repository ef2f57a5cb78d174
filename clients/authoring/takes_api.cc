#include "clients/authoring/takes_api.h"

#include <fmt/format.h>

#include <algorithm>
#include <cctype>
#include <cmath>
#include <fstream>
#include <numbers>
#include <stdexcept>

#include "bus/participant.h"
#include "clients/authoring/draft.h"
#include "clients/authoring/save.h"
#include "clients/authoring/scratch.h"
#include "clients/authoring/takes_json.h"
#include "clients/dashboard/json_answer.h"

namespace secondskin::authoring {

namespace fs = std::filesystem;
using dashboard::error_response;
using dashboard::HttpRequest;
using dashboard::HttpResponse;
using dashboard::json_answer;
using dashboard::Refusal;
using nlohmann::json;

namespace {

constexpr std::string_view kTakes = "/api/takes";
constexpr double kDegree = std::numbers::pi / 180.0;
constexpr std::size_t kMostParts = 30;

HttpResponse nothing() {
  return {.status = 204, .content_type = "application/json", .body = {}, .file_name = {}};
}

void require_method(const HttpRequest& request, std::string_view expected) {
  if (request.method != expected) {
    throw Refusal{405, fmt::format("method: expected {}", expected)};
  }
}

/// The body's object, of which only these fields are known.
json body_of(const HttpRequest& request, std::initializer_list<std::string_view> fields) {
  json body = json::parse(request.body.empty() ? "{}" : request.body, nullptr, false);
  if (!body.is_object()) throw Refusal{400, "body: expected a JSON object"};
  for (const auto& [field, value] : body.items()) {
    if (std::find(fields.begin(), fields.end(), field) == fields.end()) {
      std::string known;
      for (const auto each : fields) known += fmt::format("{}{}", known.empty() ? "" : ", ", each);
      throw Refusal{400, fmt::format("{:.64}: expected one of {}", field, known)};
    }
  }
  return body;
}

double number(const json& object, const char* field, const std::string& name,
              std::optional<double> otherwise = {}) {
  const auto found = object.find(field);
  if (found == object.end() && otherwise) return *otherwise;
  if (found == object.end() || !found->is_number()) {
    throw Refusal{400, fmt::format("{}: expected a number", name)};
  }
  return found->get<double>();
}

std::string text(const json& object, const char* field, const char* expected) {
  const auto found = object.find(field);
  if (found == object.end()) return {};
  if (!found->is_string()) throw Refusal{400, fmt::format("{}: expected {}", field, expected)};
  return found->get<std::string>();
}

const json& parts_of(const json& body) {
  const auto found = body.find("parts");
  if (found == body.end() || !found->is_array() || found->size() > kMostParts) {
    throw Refusal{400, fmt::format("parts: expected a list of at most {}", kMostParts)};
  }
  for (std::size_t i = 0; i < found->size(); ++i) {
    if (!(*found)[i].is_object()) {
      throw Refusal{400, fmt::format("parts[{}]: expected an object", i)};
    }
  }
  return *found;
}

Span span_of(const json& part, std::size_t i) {
  return {number(part, "start", fmt::format("parts[{}].start", i)),
          number(part, "end", fmt::format("parts[{}].end", i))};
}

class Api {
 public:
  explicit Api(TakesApi from) : api_(std::move(from)), map_(canonical_names(api_.joint_maps)) {}

  HttpResponse takes(const HttpRequest& request, const std::string& what) {
    if (what.empty()) {
      require_method(request, "GET");
      return json_answer(200, state());
    }
    using Post = HttpResponse (Api::*)(const HttpRequest&);
    static constexpr std::pair<std::string_view, Post> kPosts[] = {{"record", &Api::record},
                                                                   {"stop", &Api::stop},
                                                                   {"import", &Api::import},
                                                                   {"draft", &Api::draft},
                                                                   {"save", &Api::save}};
    for (const auto& [name, post] : kPosts) {
      if (what != name) continue;
      require_method(request, "POST");
      return (this->*post)(request);
    }
    constexpr std::string_view kMotion = "/motion";
    if (what.ends_with(kMotion)) {
      require_method(request, "GET");
      return json_answer(
          200, to_json(api_.takes->load(what.substr(0, what.size() - kMotion.size())).motion));
    }
    if (request.method == "DELETE") {
      api_.takes->remove(what);
      return nothing();
    }
    if (request.method == "PUT") return json_answer(200, set_parts(request, what));
    throw Refusal{405, "method: expected PUT or DELETE"};
  }

 private:
  json state() {
    json takes = json::array();
    for (const TakeInfo& take : api_.takes->list()) takes.push_back(to_json(take));
    return {{"state", to_json(api_.recorder->state())}, {"takes", std::move(takes)}};
  }

  HttpResponse record(const HttpRequest& request) {
    const json body = body_of(request, {"countdown", "most_seconds"});
    const double countdown = number(body, "countdown", "countdown", 5.0);
    const double most = number(body, "most_seconds", "most_seconds", 60.0);
    try {
      api_.recorder->record(countdown, most);
    } catch (const std::runtime_error& error) {
      throw Refusal{409, error.what()};
    }
    return json_answer(202, state());
  }

  HttpResponse stop(const HttpRequest& request) {
    body_of(request, {});
    api_.recorder->stop();
    return json_answer(200, state());
  }

  HttpResponse import(const HttpRequest& request) {
    constexpr const char* kExpected =
        "a file's name that ends in .bvh, .c3d, .trc, .mcap, .txt or .txt.gz";
    const auto found = request.query.find("name");
    if (found == request.query.end())
      throw Refusal{400, fmt::format("name: expected {}", kExpected)};
    std::string name = fs::path(found->second).filename().string();
    if (name.size() > 100) name = name.substr(name.size() - 100);
    std::string kind;
    for (const char* each : {".bvh", ".c3d", ".trc", ".mcap", ".txt.gz", ".txt"}) {
      std::string lower = name;
      std::transform(lower.begin(), lower.end(), lower.begin(),
                     [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
      if (lower.ends_with(each) && kind.empty()) kind = each;
    }
    if (kind.empty()) {
      throw Refusal{400, fmt::format("name: '{}': expected {}", name, kExpected)};
    }
    if (request.body.empty()) throw Refusal{400, "body: expected the file's bytes"};
    const Scratch scratch;
    // The client's name is for people only.
    const fs::path file = scratch.folder() / ("import" + kind);
    std::ofstream out(file, std::ios::binary);
    out.write(request.body.data(), static_cast<std::streamsize>(request.body.size()));
    out.close();
    if (!out) throw Refusal{507, "the file cannot be kept: is the disk full?"};
    std::optional<Motion> motion;
    try {
      motion = api_.import(file);
    } catch (const std::exception& error) {
      std::string words = error.what();
      for (std::size_t at = 0; (at = words.find(file.string())) != std::string::npos;) {
        words.replace(at, file.string().size(), name);
      }
      throw Refusal{400, words};
    }
    return json_answer(201, to_json(api_.takes->add(*motion, "import:" + name, bus::now_ns())));
  }

  json set_parts(const HttpRequest& request, const std::string& id) {
    const json body = body_of(request, {"parts"});
    std::vector<Part> parts;
    for (const json& part : parts_of(body)) {
      const auto chosen = part.find("chosen");
      if (chosen != part.end() && !chosen->is_boolean()) {
        throw Refusal{400, fmt::format("parts[{}].chosen: expected true or false", parts.size())};
      }
      parts.push_back({span_of(part, parts.size()), chosen == part.end() || chosen->get<bool>()});
    }
    return to_json(api_.takes->set_parts(id, std::move(parts)));
  }

  // The poses of {parts: [{take, start, end}]}.
  std::vector<Motion> motions(const json& body) {
    const json& parts = parts_of(body);
    if (parts.empty()) throw Refusal{400, "parts: expected at least one"};
    std::map<std::string, Take> loaded;
    std::vector<Motion> all;
    for (const json& part : parts) {
      const std::string what = fmt::format("parts[{}]", all.size());
      const std::string id = text(part, "take", "a take's id");
      auto found = loaded.find(id);
      if (found == loaded.end()) found = loaded.emplace(id, api_.takes->load(id)).first;
      all.push_back(part_of(found->second.motion, span_of(part, all.size()), what));
    }
    return all;
  }

  // What {joints: {name: {weight, tolerance_deg}}} says; the rest stays as it is.
  static bool read_joints(const json& body, ByJoint& weight, ByJoint& tolerance) {
    const auto joints = body.find("joints");
    if (joints == body.end()) return false;
    if (!joints->is_object()) throw Refusal{400, "joints: expected an object by joint name"};
    for (const auto& [name, values] : joints->items()) {
      const auto joint = find_joint(name);
      if (!joint || !values.is_object()) {
        throw Refusal{400, fmt::format("joints.{:.64}: expected a canonical joint such as "
                                       "left_knee with weight and tolerance_deg",
                                       name)};
      }
      const std::size_t j = index(*joint);
      const double w = number(values, "weight", fmt::format("joints.{}.weight", name), weight[j]);
      const double t = number(values, "tolerance_deg", fmt::format("joints.{}.tolerance_deg", name),
                              tolerance[j] / kDegree);
      if (!(w >= 0.0 && w <= 1.0)) {
        throw Refusal{400, fmt::format("joints.{}.weight: expected 0 to 1", name)};
      }
      if (!(t >= 0.1 && t <= 180.0)) {
        throw Refusal{400, fmt::format("joints.{}.tolerance_deg: expected 0.1 to 180", name)};
      }
      weight[j] = w;
      tolerance[j] = t * kDegree;
    }
    return true;
  }

  HttpResponse draft(const HttpRequest& request) {
    const json body = body_of(request, {"parts", "joints"});
    const auto parts = motions(body);
    Draft made = make_draft(parts, {}, map_);
    ByJoint weight, tolerance;
    for (std::size_t j = 0; j < kJointCount; ++j) {
      weight[j] = made.joints[j].weight;
      tolerance[j] = made.joints[j].tolerance;
    }
    if (read_joints(body, weight, tolerance)) {
      const auto proposed = made.joints;
      made = make_draft(parts, weight, map_);
      made.joints = proposed;
    }
    return json_answer(200, to_json(made));
  }

  HttpResponse save(const HttpRequest& request) {
    const json body = body_of(request, {"name", "description", "parts", "standing", "joints"});
    Recipe recipe = plain_recipe(text(body, "name", "a text"), {});
    require_reference_name(recipe.name);
    recipe.description = text(body, "description", "a text");
    for (const fs::path& folder : api_.references()) {
      if (folder.filename() == recipe.name) {
        throw Refusal{409, fmt::format("name '{}': a reference of this name exists already; choose "
                                       "another",
                                       recipe.name)};
      }
    }
    const auto standing = body.find("standing");
    if (standing != body.end() && !standing->is_boolean()) {
      throw Refusal{400, "standing: expected true or false"};
    }
    read_joints(body, recipe.weight, recipe.tolerance);  // refused before anything is averaged
    const auto parts = motions(body);
    const Draft proposed = make_draft(parts, {}, map_);
    for (std::size_t j = 0; j < kJointCount; ++j) {
      recipe.weight[j] = proposed.joints[j].weight;
      recipe.tolerance[j] = proposed.joints[j].tolerance;
    }
    read_joints(body, recipe.weight, recipe.tolerance);
    recipe.standing = standing == body.end() ? proposed.standing : standing->get<bool>();
    recipe.origin = origin(body.at("parts"));
    recipe.performances = parts;
    save_reference(recipe, api_.own, api_.joint_maps);
    return json_answer(201, {{"name", recipe.name}, {"performances", parts.size()}});
  }

  std::string origin(const json& parts) {
    std::vector<std::string> named;
    std::string words;
    for (const json& part : parts) {
      const std::string id = part.at("take").get<std::string>();
      if (std::find(named.begin(), named.end(), id) != named.end()) continue;
      named.push_back(id);
    }
    for (const TakeInfo& take : api_.takes->list()) {
      if (std::find(named.begin(), named.end(), take.id) == named.end()) continue;
      const std::string one =
          fmt::format("{}take {} of {}", words.empty() ? "" : "; ", take.id, take.source);
      if (words.size() + one.size() < 400) words += one;
    }
    return words;
  }

  TakesApi api_;
  JointMap map_;
};

}  // namespace

dashboard::HttpHandler takes_api(TakesApi from) {
  return [api = std::make_shared<Api>(std::move(from))](
             const HttpRequest& request) -> std::optional<HttpResponse> {
    const bool below = request.path.starts_with(std::string(kTakes) + "/");
    if (request.path != kTakes && !below) return std::nullopt;
    try {
      return api->takes(request, below ? request.path.substr(kTakes.size() + 1) : "");
    } catch (const Refusal& refusal) {
      return error_response(refusal.status, refusal.words);
    } catch (const std::out_of_range& error) {
      return error_response(404, error.what());
    } catch (const std::invalid_argument& error) {
      return error_response(400, error.what());
    } catch (const std::system_error& error) {
      return error_response(507, error.what());
    }
  };
}

}  // namespace secondskin::authoring
