// What the body maps can say of the corrections that learners need, how far saltation's felt path
// is from the real one, and what a frame of the mapper costs. docs/tactile.md quotes the output.

#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <chrono>
#include <cmath>
#include <map>
#include <nlohmann/json.hpp>
#include <set>
#include <string>
#include <vector>

#include "bench/live_session.h"
#include "coach/coach.h"
#include "coach/correct/simulated_source.h"
#include "coach/tactile/saltation.h"

namespace {

using namespace secondskin;
using namespace secondskin::coach;
using nlohmann::json;

std::vector<std::string> shipped_references() {
  std::set<std::string> names;
  for (const auto& entry :
       std::filesystem::directory_iterator(bench::kRoot / "reference_motions")) {
    if (std::filesystem::exists(entry.path() / "learner.bvh")) {
      names.insert(entry.path().filename().string());
    }
  }
  return {names.begin(), names.end()};
}

// A tactor on each limb: with it the coach asks for whatever it would like to ask for.
BodyMap everywhere() {
  BodyMap map;
  for (const Joint segment : {Joint::kSpineUpper, Joint::kHead, Joint::kLeftElbow,
                              Joint::kRightElbow, Joint::kLeftKnee, Joint::kRightKnee}) {
    map.tactors.push_back({.channel = map.tactors.size(), .segment = segment});
  }
  return map;
}

constexpr double kTold = 0.7071;  // within 45 degrees of what was asked

struct Asked {
  std::string group;
  Joint joint;
  Eigen::Vector3d target;
};

std::string group_of(Joint joint, const Eigen::Vector3d& target) {
  const auto& axes = canonical_anatomy()[index(joint)].axis;
  std::size_t largest = 0;
  for (std::size_t m = 1; m < axes.size(); ++m) {
    if (std::abs(target.dot(axes[m])) > std::abs(target.dot(axes[largest]))) largest = m;
  }
  std::string name(joint_name(joint));
  if (const auto side = name.find('_'); name.starts_with("left_") || name.starts_with("right_")) {
    name = name.substr(side + 1);
  } else if (name.starts_with("spine_")) {
    name = "spine";
  }
  return fmt::format("{} {}", name, kMovementNames[largest]);
}

/// Every correction that the coach would cue of the recorded learners, frame by frame; and what a
/// frame of the mapper took [s].
std::vector<Asked> asked_of(const std::vector<std::string>& references, const BodyMap& map,
                            std::vector<double>& time) {
  std::vector<Asked> asked;
  for (const std::string& name : references) {
    const auto reference = std::make_shared<const Reference>(
        load_reference(bench::kRoot / "reference_motions" / name, bench::kRoot / "joint_maps"));
    SimulatedSource solver(reference, canonical_skeleton(), {});
    Coach coach(reference, everywhere(), {}, solver);
    TactileMapper mapper(map);
    CoachOutput out;
    StampedPose pose;
    const Motion learner = bench::learner_of(name);
    for (const Pose& next : learner.poses) {
      pose.pose = next;
      pose.stamp_ns = 1'000'000'000 + static_cast<std::int64_t>(1e9 / bench::kRate *
                                                                static_cast<double>(pose.frame));
      ++pose.frame;
      coach.step(pose, out);
      coach.pose_problem();
      const bool enabled =
          out.alignment.phase == Phase::kMoving || out.alignment.phase == Phase::kPaused;
      const auto begin = std::chrono::steady_clock::now();
      (void)mapper.update(pose.stamp_ns, out.correction, out.error, coach.tolerance(), enabled);
      time.push_back(
          std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count());
      if (!enabled || out.correction.status == SolverStatus::kNone) continue;
      for (std::size_t j = 0; j < kJointCount; ++j) {
        const Eigen::Vector3d& target = out.correction.target[j];
        if (target.isZero() || !(out.error[j].norm() > 1.1 * coach.tolerance()[j])) continue;
        const auto joint = static_cast<Joint>(j);
        asked.push_back({group_of(joint, target), joint, target});
      }
    }
  }
  return asked;
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app{"What body maps can say, how far saltation is felt, what a frame costs"};
  std::vector<std::string> maps{"right_arm", "arms", "full_body", "limbs"};
  bool as_json = false;
  app.add_option("--body-map", maps, "names or .toml files")->capture_default_str();
  app.add_flag("--json", as_json, "the tables as JSON");
  CLI11_PARSE(app, argc, argv);

  std::vector<BodyMap> loaded;
  std::vector<TactileMapper> mappers;
  for (const std::string& name : maps) {
    const auto shipped = bench::kRoot / "body_maps" / (name + ".toml");
    loaded.push_back(BodyMap::load(std::filesystem::exists(shipped) ? shipped.string() : name));
    mappers.emplace_back(loaded.back());
  }
  std::vector<double> time;
  const std::vector<std::string> references = shipped_references();
  const std::vector<Asked> asked = asked_of(references, loaded.back(), time);

  // By joint and movement: how often asked, and told by each map.
  std::map<std::string, std::vector<std::size_t>> table;
  std::vector<std::size_t> total(maps.size() + 1);
  for (const Asked& a : asked) {
    auto& row = table[a.group];
    row.resize(maps.size() + 1);
    ++row[0], ++total[0];
    for (std::size_t m = 0; m < maps.size(); ++m) {
      const std::size_t told = mappers[m].tells(a.joint, a.target) > kTold ? 1 : 0;
      row[m + 1] += told, total[m + 1] += told;
    }
  }
  std::vector<std::pair<std::string, std::vector<std::size_t>>> rows(table.begin(), table.end());
  std::sort(rows.begin(), rows.end(),
            [](const auto& a, const auto& b) { return a.second[0] > b.second[0]; });
  rows.emplace_back("all", total);

  json out;
  if (!as_json) {
    fmt::print(
        "Corrections asked of the recorded learners of {} references, and the share that a "
        "map says within 45 degrees\n{:<22}{:>8}",
        references.size(), "joint and movement", "frames");
    for (const std::string& name : maps) {
      fmt::print("{:>14}", std::filesystem::path(name).stem().string());
    }
    fmt::print("\n");
  }
  for (const auto& [group, counts] : rows) {
    json row{{"movement", group}, {"frames", counts[0]}};
    if (!as_json) fmt::print("{:<22}{:>8}", group, counts[0]);
    for (std::size_t m = 0; m < maps.size(); ++m) {
      const double share =
          counts[0] == 0 ? 0.0
                         : static_cast<double>(counts[m + 1]) / static_cast<double>(counts[0]);
      row[maps[m]] = share;
      if (!as_json) fmt::print("{:>12.0f} %", 100.0 * share);
    }
    out["told"].push_back(row);
    if (!as_json) fmt::print("\n");
  }

  // Two rounds of a ring of four sites a length of 1 apart, each tapped twice.
  if (!as_json) {
    fmt::print(
        "\nSaltation after Goldreich 2007, forearm, two rounds of a ring\n{:>12}{:>20}{:>22}"
        "{:>26}\n",
        "tap (ms)", "felt/real, 2 taps", "felt/real, 2 rounds", "furthest from even (site)");
  }
  for (const double interval : {0.020, 0.030, 0.040, 0.050, 0.060, 0.080, 0.100, 0.120, 0.150}) {
    constexpr std::size_t kTaps = 16;
    std::array<double, kTaps> real{}, felt{};
    for (std::size_t i = 0; i < kTaps; ++i) real[i] = static_cast<double>(i / 2);
    felt_positions(real, interval, kForearmLambda, felt);
    const double length = felt.back() - felt.front();
    double uneven = 0.0;
    for (std::size_t i = 0; i < kTaps; ++i) {
      const double even = felt.front() + length * static_cast<double>(i) / (kTaps - 1);
      uneven = std::max(uneven, std::abs(felt[i] - even));
    }
    const double two = felt_distance_ratio(interval),
                 rounds = length / (real.back() - real.front());
    out["saltation"].push_back({{"tap_interval", interval},
                                {"felt_two_taps", two},
                                {"felt_two_rounds", rounds},
                                {"uneven_sites", uneven}});
    if (!as_json) {
      fmt::print("{:>12.0f}{:>20.3f}{:>22.2f}{:>26.2f}\n", 1e3 * interval, two, rounds, uneven);
    }
  }

  out["update"] = {{"frames", time.size()},
                   {"p50", bench::quantile(time, 0.5)},
                   {"p99", bench::quantile(time, 0.99)}};
  if (as_json) {
    fmt::print("{}\n", out.dump(2));
  } else {
    fmt::print("\nMapper, {} frames: p50 {:.1f} us, p99 {:.1f} us\n", time.size(),
               1e6 * bench::quantile(time, 0.5), 1e6 * bench::quantile(time, 0.99));
  }
}
