#include "clients/authoring/takes_json.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <numbers>
#include <numeric>

#include "clients/dashboard/json_answer.h"

namespace secondskin::authoring {

using nlohmann::json;

namespace {

constexpr std::size_t kCurves = 6;  // the joints that matter most

double deg(double radians) { return radians * 180.0 / std::numbers::pi; }
double rounded(double value, double per_unit) { return std::round(value * per_unit) / per_unit; }

json to_json(const Eigen::Vector3d& p) {
  return {rounded(p.x(), 1e4), rounded(p.y(), 1e4), rounded(p.z(), 1e4)};
}

json to_json(const Pose& pose) {
  json numbers = to_json(pose.p_WR);
  for (const auto& q : pose.q_PB) {
    for (const double c : {q.x(), q.y(), q.z(), q.w()}) numbers.push_back(rounded(c, 1e4));
  }
  return numbers;
}

// The movement that a joint goes through most.
std::size_t main_movement(const Motion& motion, Joint joint) {
  std::array<double, 3> least, most;
  least.fill(INFINITY);
  most.fill(-INFINITY);
  for (const Pose& pose : motion.poses) {
    const JointAngles angles = joint_angles(joint, pose.q_PB[index(joint)]);
    for (std::size_t m = 0; m < 3; ++m) {
      least[m] = std::min(least[m], angles[m]);
      most[m] = std::max(most[m], angles[m]);
    }
  }
  std::size_t best = 0;
  for (std::size_t m = 1; m < 3; ++m) {
    if (most[m] - least[m] > most[best] - least[best]) best = m;
  }
  return best;
}

json curve_of(const Draft& draft, std::size_t j, std::span<const std::size_t> frames) {
  const auto joint = static_cast<Joint>(j);
  const std::size_t m = main_movement(draft.mean, joint);
  const auto angle = [&](const Pose& pose) {
    return rounded(deg(joint_angles(joint, pose.q_PB[j])[m]), 10.0);
  };
  json mean = json::array(), spread = json::array(), parts = json::array();
  for (const std::size_t f : frames) {
    mean.push_back(angle(draft.mean.poses[f]));
    spread.push_back(rounded(deg(draft.spread[f][j]), 10.0));
  }
  for (std::size_t p = 0; p < draft.parts.size(); ++p) {
    json part = json::array();
    Pose pose(kJointCount);
    for (const std::size_t f : frames) {
      sample(draft.parts[p], draft.when[p][f], pose);
      part.push_back(angle(pose));
    }
    parts.push_back(std::move(part));
  }
  return {{"joint", joint_name(joint)},
          {"movement", kMovementNames[m]},
          {"mean", std::move(mean)},
          {"spread", std::move(spread)},
          {"parts", std::move(parts)}};
}

}  // namespace

json to_json(const RecorderState& state) {
  constexpr const char* kPhases[] = {"idle", "countdown", "recording"};
  return {{"phase", kPhases[static_cast<int>(state.phase)]},
          {"remaining", rounded(state.remaining, 100.0)},
          {"elapsed", rounded(state.elapsed, 100.0)},
          {"most", state.most},
          {"alive", state.alive},
          {"source", state.source},
          {"rate_hz", state.rate_hz},
          {"lost", state.lost},
          {"paused", state.paused},
          {"trouble", state.trouble},
          {"recorded", state.recorded}};
}

json to_json(const TakeInfo& take) {
  json parts = json::array();
  for (const Part& part : take.parts) {
    parts.push_back({{"start", rounded(part.span.start, 1e3)},
                     {"end", rounded(part.span.end, 1e3)},
                     {"chosen", part.chosen}});
  }
  return {{"id", take.id},
          {"recorded", dashboard::iso_time(take.recorded_ns)},
          {"source", take.source},
          {"faults", take.faults},
          {"duration", rounded(take.duration, 1e3)},
          {"rate_hz", take.rate_hz},
          {"moving", {{"start", take.cutting.moving.start}, {"end", take.cutting.moving.end}}},
          {"found", take.cutting.repetitions.size()},
          {"difference", rounded(take.cutting.difference, 100.0)},
          {"parts", std::move(parts)}};
}

json to_json(const Motion& motion) {
  json skeleton = json::array(), poses = json::array();
  for (const Segment& segment : motion.skeleton.segments()) {
    skeleton.push_back({{"name", segment.name},
                        {"parent", segment.parent ? static_cast<int>(*segment.parent) : -1},
                        {"offset", to_json(segment.p_PB)},
                        {"end", to_json(segment.p_BE)}});
  }
  const Motion drawn = motion.rate_hz > kDrawnRate + 1e-6 ? resample(motion, kDrawnRate) : motion;
  for (const Pose& pose : drawn.poses) poses.push_back(to_json(pose));
  return {
      {"rate_hz", drawn.rate_hz}, {"skeleton", std::move(skeleton)}, {"poses", std::move(poses)}};
}

json to_json(const Draft& draft) {
  std::vector<std::size_t> frames;
  const auto step = static_cast<std::size_t>(std::lround(coach::kReferenceRate / kDrawnRate));
  for (std::size_t f = 0; f < draft.mean.poses.size(); f += step) frames.push_back(f);

  json joints = json::array();
  for (std::size_t j = 0; j < kJointCount; ++j) {
    const JointProposal& joint = draft.joints[j];
    joints.push_back({{"name", joint_name(static_cast<Joint>(j))},
                      {"measured", joint.measured},
                      {"range_deg", rounded(deg(joint.range), 10.0)},
                      {"spread_deg", rounded(deg(joint.spread), 10.0)},
                      {"weight", joint.weight},
                      {"tolerance_deg", rounded(deg(joint.tolerance), 10.0)},
                      {"of_interest", joint.weight >= kOfInterest}});
  }
  std::array<std::size_t, kJointCount> order{};
  std::iota(order.begin(), order.end(), std::size_t{0});
  std::stable_sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) {
    return draft.joints[a].measured * draft.joints[a].range >
           draft.joints[b].measured * draft.joints[b].range;
  });
  json curves = json::array(), when = json::array();
  for (std::size_t k = 0; k < kCurves; ++k) curves.push_back(curve_of(draft, order[k], frames));
  for (const auto& times : draft.when) {
    json part = json::array();
    for (const std::size_t f : frames) part.push_back(rounded(times[f], 1e3));
    when.push_back(std::move(part));
  }
  return {{"experts", draft.parts.size()}, {"duration", rounded(draft.mean.duration(), 1e3)},
          {"standing", draft.standing},    {"mean", to_json(draft.mean)},
          {"when", std::move(when)},       {"joints", std::move(joints)},
          {"curves", std::move(curves)}};
}

}  // namespace secondskin::authoring
