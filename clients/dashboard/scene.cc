#include "clients/dashboard/scene.h"

#include <algorithm>
#include <nlohmann/json.hpp>

#include "motion/body_shape.h"
#include "motion/kinematics.h"

namespace secondskin::dashboard {
namespace {

using Json = nlohmann::json;

struct Colour {
  double r, g, b, a;
};
// Okabe and Ito's, which the colour-blind tell apart.
constexpr Colour kLearner{0.90, 0.62, 0.00, 1.0};
constexpr Colour kExpert{0.34, 0.71, 0.91, 0.45};
constexpr Colour kQuiet{0.35, 0.35, 0.35, 0.9};
constexpr Colour kStrong{0.94, 0.89, 0.26, 1.0};
constexpr double kTactorSize = 0.03;     // [m]
constexpr double kTactorGrowth = 0.03;   // at full drive [m]
constexpr std::int64_t kLifetime_s = 1;  // what is not renewed goes away

Json json_of(std::int64_t time_ns) {
  return {{"sec", time_ns / 1'000'000'000}, {"nsec", time_ns % 1'000'000'000}};
}
Json json_of(const Eigen::Vector3d& v) { return {{"x", v.x()}, {"y", v.y()}, {"z", v.z()}}; }
Json json_of(const Eigen::Quaterniond& q) {
  return {{"x", q.x()}, {"y", q.y()}, {"z", q.z()}, {"w", q.w()}};
}
Json json_of(const Colour& c) { return {{"r", c.r}, {"g", c.g}, {"b", c.b}, {"a", c.a}}; }
Json pose_of(const Eigen::Vector3d& position, const Eigen::Quaterniond& orientation) {
  return {{"position", json_of(position)}, {"orientation", json_of(orientation)}};
}

Json sphere(const Eigen::Vector3d& centre, double diameter, const Colour& colour) {
  return {{"pose", pose_of(centre, Eigen::Quaterniond::Identity())},
          {"size", json_of(Eigen::Vector3d::Constant(diameter))},
          {"color", json_of(colour)}};
}

Json entity(const char* id, std::int64_t time_ns) {
  Json entity{{"timestamp", json_of(time_ns)},
              {"frame_id", "world"},
              {"id", id},
              {"lifetime", {{"sec", kLifetime_s}, {"nsec", 0}}},
              {"frame_locked", false}};
  for (const char* list : {"metadata", "arrows", "cubes", "spheres", "cylinders", "lines",
                           "triangles", "texts", "models"}) {
    entity[list] = Json::array();
  }
  return entity;
}

std::vector<Eigen::Isometry3d> placed(const Figure& figure) {
  std::vector<Eigen::Isometry3d> X_WB(figure.skeleton.size());
  forward_kinematics(figure.skeleton, figure.pose.p_WR, figure.pose.q_PB, X_WB);
  return X_WB;
}

Json body(const char* id, std::int64_t time_ns, const Figure& figure,
          std::span<const Eigen::Isometry3d> X_WB, const Colour& colour) {
  Json drawn = entity(id, time_ns);
  for (std::size_t j = 0; j < kJointCount; ++j) {
    const Capsule capsule = segment_capsule(figure.skeleton, static_cast<Joint>(j));
    const Eigen::Vector3d p_WA = X_WB[j] * capsule.p_BA;
    const Eigen::Vector3d axis = X_WB[j] * capsule.p_BE - p_WA;
    if (axis.norm() > 1e-6) {
      const auto along = Eigen::Quaterniond::FromTwoVectors(Eigen::Vector3d::UnitZ(), axis);
      const double diameter = 2.0 * capsule.radius;
      drawn["cylinders"].push_back(
          {{"pose", pose_of(p_WA + 0.5 * axis, along)},
           {"size", json_of(Eigen::Vector3d(diameter, diameter, axis.norm()))},
           {"bottom_scale", 1.0},
           {"top_scale", 1.0},
           {"color", json_of(colour)}});
    }
    drawn["spheres"].push_back(sphere(X_WB[j].translation(), 2.0 * capsule.radius, colour));
  }
  return drawn;
}

void add_transforms(Json& list, std::int64_t time_ns, const std::string& prefix,
                    const Figure& figure) {
  const auto& segments = figure.skeleton.segments();
  for (std::size_t j = 0; j < segments.size(); ++j) {
    const auto& parent = segments[j].parent;
    list.push_back({{"timestamp", json_of(time_ns)},
                    {"parent_frame_id", parent ? prefix + segments[*parent].name : "world"},
                    {"child_frame_id", prefix + segments[j].name},
                    {"translation", json_of(parent ? segments[j].p_PB : figure.pose.p_WR)},
                    {"rotation", json_of(figure.pose.q_PB[j])}});
  }
}

}  // namespace

std::array<double, wire::kTactorCount> levels(const wire::BoardState& state) noexcept {
  std::array<double, wire::kTactorCount> out{};
  const auto level = [&](std::size_t slot) { return wire::drive_of(state[slot]).level; };
  for (std::size_t t = 0; t < wire::kTactorCount; ++t) {
    out[t] = std::max({level(wire::continuous_slot(t)), level(wire::pulsed_slot(t)),
                       level(wire::saltation_slot(t / 4, false)),
                       level(wire::saltation_slot(t / 4, true))});
  }
  return out;
}

std::string frame_transforms(std::int64_t time_ns, const std::string& subject,
                             const Figure& learner, const Figure* expert) {
  Json list = Json::array();
  add_transforms(list, time_ns, subject + "/", learner);
  if (expert != nullptr) add_transforms(list, time_ns, subject + "/expert/", *expert);
  return Json{{"transforms", std::move(list)}}.dump();
}

std::string scene_update(std::int64_t time_ns, const Figure& learner, const Figure* expert,
                         std::span<const coach::Tactor> tactors,
                         const std::array<double, wire::kTactorCount>& levels) {
  const auto X_WB = placed(learner);
  Json entities = Json::array();
  entities.push_back(body("learner", time_ns, learner, X_WB, kLearner));
  if (expert != nullptr) {
    entities.push_back(body("expert", time_ns, *expert, placed(*expert), kExpert));
  }
  Json lit = entity("tactors", time_ns);
  for (const coach::Tactor& tactor : tactors) {
    const double level = levels[tactor.channel];
    const SkinPlace place =
        skin_place(learner.skeleton, tactor.segment, tactor.along, tactor.angle);
    const auto blend = [level](double a, double b) { return a + level * (b - a); };
    lit["spheres"].push_back(sphere(X_WB[index(tactor.segment)] * place.p_BS,
                                    kTactorSize + level * kTactorGrowth,
                                    {blend(kQuiet.r, kStrong.r), blend(kQuiet.g, kStrong.g),
                                     blend(kQuiet.b, kStrong.b), blend(kQuiet.a, kStrong.a)}));
  }
  entities.push_back(std::move(lit));
  return Json{{"deletions", Json::array()}, {"entities", std::move(entities)}}.dump();
}

}  // namespace secondskin::dashboard
