#include "clients/dashboard/library_api.h"

#include <fmt/format.h>

#include <nlohmann/json.hpp>
#include <numbers>

#include "clients/dashboard/json_answer.h"

namespace secondskin::dashboard {
namespace {

using Json = nlohmann::json;

constexpr std::string_view kReferences = "/api/references/";

std::string_view words(coach::FeedbackSchedule::Kind kind) {
  using Kind = coach::FeedbackSchedule::Kind;
  switch (kind) {
    case Kind::kAlways:
      return "always";
    case Kind::kBandwidth:
      return "bandwidth";
    case Kind::kFading:
      return "fading";
    case Kind::kFadingByJoint:
      return "fading_by_joint";
    case Kind::kYoked:
      return "yoked";
    case Kind::kOff:
      break;
  }
  return "off";
}

Json json_of(const coach::SessionPlan& plan) {
  Json blocks = Json::array();
  for (const coach::Block& block : plan.blocks) {
    blocks.push_back({{"name", block.name},
                      {"repetitions", block.repetitions},
                      {"tempo", block.tempo},
                      {"schedule", words(block.schedule.kind)}});
  }
  return {{"name", plan.name}, {"description", plan.description}, {"blocks", std::move(blocks)}};
}

Json json_of(const coach::Reference& reference) {
  Json joints = Json::array();
  for (std::size_t j = 0; j < kJointCount; ++j) {
    joints.push_back({{"name", joint_name(static_cast<Joint>(j))},
                      {"weight", reference.weight[j]},
                      {"tolerance_deg", reference.tolerance[j] * 180.0 / std::numbers::pi}});
  }
  return {{"name", reference.name},
          {"description", reference.description},
          {"duration", reference.motion.duration()},
          {"joints", std::move(joints)}};
}

std::optional<HttpResponse> answer(const LibraryApi& api, const HttpRequest& request) {
  const bool reference = request.path.starts_with(kReferences);
  const bool body_maps = request.path == "/api/body_maps";
  if (request.path != "/api/info" && request.path != "/api/plans" && !body_maps && !reference) {
    return {};
  }
  if (request.method != "GET") {
    return error_response(405, fmt::format("{}: expected GET", request.path));
  }
  if (request.path == "/api/info") {
    return json_answer(200, {{"subject", api.subject},
                             {"version", api.version},
                             {"page_version", api.page_version()},
                             {"history", api.history}});
  }
  if (body_maps) return json_answer(200, api.body_maps());
  if (request.path == "/api/plans") {
    Json plans = Json::array();
    for (const auto& plan : api.plans()) plans.push_back(json_of(plan));
    return json_answer(200, plans);
  }
  try {
    return json_answer(200, json_of(*api.reference(request.path.substr(kReferences.size()))));
  } catch (const std::runtime_error& error) {
    return error_response(404, error.what());
  }
}

}  // namespace

HttpHandler handler(LibraryApi api) {
  return [api = std::move(api)](const HttpRequest& request) { return answer(api, request); };
}

}  // namespace secondskin::dashboard
