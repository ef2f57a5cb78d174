// What the detectors of a suit see of the projectors over recorded motions, for the rig of the
// paper and for others, and what the virtual rig costs.

#include <fmt/core.h>
#include <time.h>

#include <CLI/CLI.hpp>
#include <cmath>
#include <map>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "bench/live_session.h"
#include "motion/retarget.h"
#include "sim/optical/placement.h"
#include "sim/optical/suit_scene.h"

namespace {

using namespace secondskin;

double cpu_time() {
  timespec t{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
  return static_cast<double>(t.tv_sec) + 1e-9 * static_cast<double>(t.tv_nsec);
}

struct Layout {
  std::string name;
  double height;           ///< of the pairs [m]
  double alternate = 0.0;  ///< every other pair so much higher, the others lower [m]
  double roll = 0.0;       ///< of every other pair about its axis [rad]
  double roll_all = 0.0;   ///< of all pairs [rad]
};

// Pairs on the paper's circle that look at its middle, 0.85 m high.
std::vector<sim::VirtualProjector> make_rig(const Layout& layout) {
  std::vector<sim::VirtualProjector> rig = sim::second_skin_rig();
  for (std::size_t i = 0; i < rig.size(); ++i) {
    const bool odd = (i / 2) % 2 == 1;
    Eigen::Isometry3d& X_WJ = rig[i].X_WJ;
    const Eigen::Vector3d middle(0.0, 0.0, X_WJ.translation().z());
    Eigen::Vector3d p = X_WJ.translation();
    const Eigen::Vector3d level = (middle - p).normalized();
    p.z() = layout.height + (odd ? layout.alternate : -layout.alternate);
    const Eigen::Quaterniond tilt =
        Eigen::Quaterniond::FromTwoVectors(level, (middle - p).normalized());
    X_WJ.linear() = tilt * X_WJ.linear();
    X_WJ.translation() = p;
    X_WJ.rotate(
        Eigen::AngleAxisd(layout.roll_all + (odd ? layout.roll : 0.0), Eigen::Vector3d::UnitZ()));
  }
  return rig;
}

struct Summary {
  double visible = 0.0, planes = 0.0, worst = 1.0;
  std::vector<double> sigmas;
  std::size_t count = 0;

  void add(const sim::PlacementScore& score) {
    visible += score.visible;
    planes += score.planes;
    worst = std::min(worst, score.visible);
    if (!std::isnan(score.sigma)) sigmas.push_back(score.sigma);
    ++count;
  }
  double mean_visible() const { return visible / static_cast<double>(count); }
  double mean_planes() const { return planes / static_cast<double>(count); }
  double sigma(double q) const { return bench::quantile(sigmas, q); }
  nlohmann::json json() const {
    return {{"visible", mean_visible()},
            {"planes", mean_planes()},
            {"sigma_m", sigma(0.5)},
            {"sigma_p95_m", sigma(0.95)},
            {"least_visible", worst}};
  }
  std::string row() const {
    return fmt::format("{:>8.1f} {:>8.2f} {:>9.1f} {:>9.1f} {:>9.1f}", 100.0 * mean_visible(),
                       mean_planes(), 1e3 * sigma(0.5), 1e3 * sigma(0.95), 100.0 * worst);
  }
};

constexpr std::string_view kColumns = "seen (%)   planes  median mm    p95 mm  worst (%)";

}  // namespace

int main(int argc, char** argv) {
  CLI::App app{"What a suit's detectors see of the projectors, and what the virtual rig costs"};
  std::vector<std::string> names{"squat",     "jumping_jack",   "wave_hello",
                                 "low_block", "stepping_punch", "roundhouse_kick"};
  double step = 0.1;
  int cycles = 2000;
  bool json = false, sweep = false;
  app.add_option("--reference", names, "whose experts' motions, recentred")->capture_default_str();
  app.add_option("--step", step, "between the instants looked at [s]")->capture_default_str();
  app.add_option("--cycles", cycles, "of the virtual rig, for its cost")->capture_default_str();
  app.add_flag("--sweep", sweep, "also try places all around each segment");
  app.add_flag("--json", json);
  CLI11_PARSE(app, argc, argv);

  std::map<std::string, Motion> motions;
  for (const std::string& name : names) {
    motions.emplace(name, sim::recentred(read_canonical(
                              bench::kRoot / "reference_motions" / name / "motion.bvh",
                              bench::kRoot / "joint_maps")));
  }
  const sim::OpticalNoise noise;
  sim::PlacementOptions options;
  options.step = step;
  const auto suit_of = [](const std::string& name) {
    return Suit::load(bench::kRoot / "suits" / (name + ".toml"));
  };

  nlohmann::json out;
  const auto print = [&](std::string_view text) {
    if (!json) fmt::print("{}\n", text);
  };

  for (const std::string suit_name : {"second_skin", "full_body"}) {
    const Suit suit = suit_of(suit_name);
    Summary all;
    std::map<std::size_t, Summary> by_segment;
    print(fmt::format("{}, {} detectors\n{:<24} {}", suit_name, suit.detectors.size(), "motion",
                      kColumns));
    for (const auto& [name, motion] : motions) {
      Summary summary;
      for (const auto& score :
           sim::score_suit(motion, suit, sim::second_skin_rig(), noise, options)) {
        summary.add(score);
        all.add(score);
        by_segment[index(score.place.segment)].add(score);
      }
      print(fmt::format("{:<24} {}", name, summary.row()));
      out["suits"][suit_name]["motions"][name] = summary.json();
    }
    print(fmt::format("{:<24} {}\n\n{:<24} {}", "all", all.row(), "segment", kColumns));
    out["suits"][suit_name]["all"] = all.json();
    for (const auto& [segment, summary] : by_segment) {
      const std::string name(joint_name(static_cast<Joint>(segment)));
      print(fmt::format("{:<24} {}", name, summary.row()));
      out["suits"][suit_name]["segments"][name] = summary.json();
    }
    print("");
  }

  const double quarter = std::numbers::pi / 4.0;
  const std::vector<Layout> layouts{
      {"0.85 m (shipped)", 0.85},
      {"0.75 m", 0.75},
      {"0.95 m", 0.95},
      {"1.20 m", 1.20},
      {"1.50 m", 1.50},
      {"2.00 m", 2.00},
      {"0.85 m, half rolled 45", 0.85, 0.0, quarter},
      {"0.85 m, all rolled 45", 0.85, 0.0, 0.0, quarter},
      {"0.85 m, +-0.5 m", 0.85, 0.5},
  };
  const Suit full = suit_of("full_body");
  print(fmt::format("{:<24} {}", "rig (full_body)", kColumns));
  for (const Layout& layout : layouts) {
    Summary summary;
    const auto rig = make_rig(layout);
    for (const auto& [name, motion] : motions) {
      for (const auto& score : sim::score_suit(motion, full, rig, noise, options)) {
        summary.add(score);
      }
    }
    print(fmt::format("{:<24} {}", layout.name, summary.row()));
    out["rigs"][layout.name] = summary.json();
  }

  if (sweep) {
    // By segment, then angle: over all places along the segment and all motions.
    std::map<std::size_t, std::map<int, Summary>> by_angle;
    for (const auto& [name, motion] : motions) {
      for (const auto& score :
           sim::sweep_places(motion, {}, sim::second_skin_rig(), noise, options)) {
        const int angle_deg =
            static_cast<int>(std::lround(score.place.angle * 180.0 / std::numbers::pi));
        by_angle[index(score.place.segment)][angle_deg].add(score);
      }
    }
    std::string row = fmt::format("\n{:<24}", "seen (%) at angle (deg)");
    for (const auto& [angle_deg, summary] : by_angle.begin()->second) {
      row += fmt::format(" {:>4}", angle_deg);
    }
    print(row);
    for (const auto& [segment, angles] : by_angle) {
      const std::string name(joint_name(static_cast<Joint>(segment)));
      row = fmt::format("{:<24}", name);
      for (const auto& [angle_deg, summary] : angles) {
        row += fmt::format(" {:>4.0f}", 100.0 * summary.mean_visible());
        out["sweep"][name][std::to_string(angle_deg)] = summary.json();
      }
      print(row);
    }
  }

  // The paper's load: four tags of eighteen.
  Suit four = full;
  four.detectors.resize(72);
  sim::SuitScene scene(motions.begin()->second, four, sim::AtEnd::kThereAndBack);
  sim::VirtualRig rig(sim::second_skin_rig(), scene, noise, 1);
  std::vector<std::uint8_t> values(four.detectors.size() * 16);
  std::uint64_t seen = 0;
  const double start = cpu_time();
  for (int i = 0; i < cycles; ++i) {
    rig.cycle(0.016 * i, values);
    for (const std::uint8_t value : values) seen += value > 0 ? 1 : 0;
  }
  const double ms = 1e3 * (cpu_time() - start) / cycles;
  print(
      fmt::format("\nvirtual rig, 72 detectors x 16 projectors: {:.3f} ms CPU a cycle, {:.0f} "
                  "times real time; {:.2f} values a detector",
                  ms, 16.0 / ms, static_cast<double>(seen) / cycles / 72.0));
  out["virtual_rig"] = {{"cpu_ms_per_cycle", ms}, {"times_real_time", 16.0 / ms}};
  if (json) fmt::print("{}\n", out.dump(2));
  return 0;
}
