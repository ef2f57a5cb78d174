// How good is a calibration, and what does it cost? The virtual projectors (sim/optical) calibrated
// by the grid and by the wand, compared with their true geometry: noise-free values at points of
// the tracking volume (2.3), triangulated with each calibration. docs/projector-calibration.md
// quotes the output.

#include <fmt/core.h>

#include <CLI/CLI.hpp>
#include <Eigen/Geometry>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <functional>
#include <nlohmann/json.hpp>
#include <numbers>
#include <optional>
#include <random>
#include <vector>

#include "server/optical/calibrate/grid_calibration.h"
#include "server/optical/calibrate/projector_fit.h"
#include "server/optical/calibrate/triangulation.h"
#include "server/optical/calibrate/wand_calibration.h"
#include "sim/optical/calibration_scenes.h"
#include "sim/optical/virtual_rig.h"
#include "wire/photo_tag.h"

namespace {

using namespace secondskin;
using namespace secondskin::server;

constexpr std::size_t kProjectors = 16;

double now() {
  return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

double quantile(std::vector<double> sorted, double q) {
  if (sorted.empty()) return 0.0;
  std::sort(sorted.begin(), sorted.end());
  return sorted[static_cast<std::size_t>(q * static_cast<double>(sorted.size() - 1))];
}

double rms(const std::vector<double>& values) {
  double square = 0.0;
  for (const double v : values) square += v * v;
  return values.empty() ? 0.0 : std::sqrt(square / static_cast<double>(values.size()));
}

// A rig as somebody sets it up: no projector is quite where the drawing has it.
std::vector<sim::VirtualProjector> set_up(unsigned seed) {
  std::mt19937 random(seed);
  std::normal_distribution<double> normal;
  auto rig = sim::second_skin_rig();
  for (auto& p : rig) {
    p.X_WJ.translation() += 0.03 * Eigen::Vector3d(normal(random), normal(random), normal(random));
    p.X_WJ.rotate(Eigen::AngleAxisd(
        0.02 * normal(random),
        Eigen::Vector3d(normal(random), normal(random), normal(random)).normalized()));
    p.field *= 1.0 + 0.01 * normal(random);
  }
  return rig;
}

ProjectorRig true_rig(const std::vector<sim::VirtualProjector>& rig) {
  ProjectorRig out;
  for (const auto& p : rig) out.projectors.emplace_back(Projector{p.matrix()});
  return out;
}

RoughLayout layout_of(const std::vector<sim::VirtualProjector>& rig, unsigned seed) {
  std::mt19937 random(seed);
  std::normal_distribution<double> normal;
  const auto some = [&](double sigma) {
    return Eigen::Vector3d(sigma * normal(random), sigma * normal(random), sigma * normal(random));
  };
  RoughLayout layout;
  for (std::size_t i = 0; i < rig.size(); ++i) {
    const Eigen::Vector3d p = rig[i].X_WJ.translation();
    layout.places.push_back({p + some(0.2), Eigen::Vector3d(0.0, 0.0, p.z()) + some(0.2),
                             (i % 2 == 0 ? 0.0 : -0.5 * std::numbers::pi) + 0.15 * normal(random)});
  }
  return layout;
}

void run(sim::VirtualRig& rig, std::size_t detectors, double seconds,
         const std::function<void(const ProjectorFrame&)>& take) {
  const double cycle = 1e-9 * static_cast<double>(wire::cycle_ns(kProjectors));
  for (std::uint64_t k = 0; static_cast<double>(k) * cycle < seconds; ++k) {
    ProjectorFrame frame(detectors, kProjectors);
    frame.cycle = k;
    frame.stamp_ns = static_cast<std::int64_t>(k) * wire::cycle_ns(kProjectors);
    rig.cycle(static_cast<double>(k) * cycle, frame.values);
    take(frame);
  }
}

// All errors of one method over all seeds.
struct Method {
  std::string name;
  std::vector<double> world, shape, solve, add_us, predicted;
  std::size_t refused = 0;
};

// Errors of noise-free points that six projectors light, in the world and after the best rigid
// motion.
void compare(const std::vector<sim::VirtualProjector>& truth, const ProjectorRig& rig,
             Method& method) {
  std::mt19937 random(9);
  std::uniform_real_distribution<double> uniform;
  std::vector<Eigen::Vector3d> from, to;
  for (int k = 0; k < 3000; ++k) {
    const double r = 0.5 * 6.5 * 0.3048 * std::sqrt(uniform(random));
    const double a = 2.0 * std::numbers::pi * uniform(random);
    const Eigen::Vector3d p(r * std::cos(a), r * std::sin(a), 6.0 * 0.3048 * uniform(random));
    std::vector<Sighting> sightings;
    for (std::size_t i = 0; i < truth.size(); ++i) {
      if (rig.projectors[i] && truth[i].coordinate(p)) {
        sightings.push_back({i, Projector{truth[i].matrix()}.value(p)});
      }
    }
    if (sightings.size() < 6) continue;
    const auto found = triangulate(rig, sightings);
    if (!found) continue;
    from.push_back(found->p_W);
    to.push_back(p);
  }
  Eigen::Matrix3Xd A(3, static_cast<Eigen::Index>(from.size())), B(3, A.cols());
  for (std::size_t k = 0; k < from.size(); ++k) {
    A.col(static_cast<Eigen::Index>(k)) = from[k];
    B.col(static_cast<Eigen::Index>(k)) = to[k];
  }
  const Eigen::Matrix4d T = Eigen::umeyama(A, B, false);
  const Eigen::Matrix3Xd C = (T.topLeftCorner<3, 3>() * A).colwise() + T.topRightCorner<3, 1>();
  for (Eigen::Index k = 0; k < A.cols(); ++k) {
    method.world.push_back((A.col(k) - B.col(k)).norm());
    method.shape.push_back((C.col(k) - B.col(k)).norm());
  }
}

void calibrate_by_grid(const std::vector<sim::VirtualProjector>& rig,
                       const sim::OpticalNoise& noise, double height,
                       const std::vector<double>& heights, unsigned seed, Method* paper,
                       Method& ours) {
  CalibrationGrid grid;
  grid.heights = heights;
  std::optional<GridCalibration> session;
  double add = 0.0;
  std::size_t frames = 0;
  for (std::size_t h = 0; h < heights.size(); ++h) {
    sim::GridScene scene(height + grid.heights[h]);
    if (h == 0) {
      grid.p_W.assign(scene.positions().begin(), scene.positions().end());
      session.emplace(grid, kProjectors);
    }
    sim::VirtualRig hardware(rig, scene, noise, 100 * seed + h);
    run(hardware, 12, 16.0, [&](const ProjectorFrame& frame) {
      const double begin = now();
      session->add(frame, h);
      add += now() - begin;
      ++frames;
    });
  }
  if (paper != nullptr) {
    // The paper's least squares on the same readings, each a value as the tag sends it.
    const double begin = now();
    ProjectorRig rig_of_paper;
    for (std::size_t i = 0; i < kProjectors; ++i) {
      std::vector<Reading> readings;
      for (std::size_t h = 0; h < heights.size(); ++h) {
        for (std::size_t d = 0; d < grid.p_W.size(); ++d) {
          if (const auto v = session->value(d, i, h)) {
            readings.push_back(
                {grid.p_W[d] + heights[h] * Eigen::Vector3d::UnitZ(), std::round(*v)});
          }
        }
      }
      auto& place = rig_of_paper.projectors.emplace_back();
      if (const auto fit = fit_projector_algebraic(readings)) place = *fit;
    }
    paper->solve.push_back(now() - begin);
    compare(rig, rig_of_paper, *paper);
  }
  const double begin = now();
  const auto result = session->solve();
  ours.solve.push_back(now() - begin);
  ours.add_us.push_back(1e6 * add / static_cast<double>(frames));
  if (result) {
    compare(rig, result->rig, ours);
  } else {
    ++ours.refused;
  }
}

// The wand with detectors as on a suit, that all look to one side; laid down under balls again.
class FlatWand final : public sim::OpticalScene {
 public:
  FlatWand(sim::WandScene& wand, bool flat) : wand_(wand), flat_(flat) {}
  std::size_t detectors() const override { return wand_.detectors(); }
  void at(double time, std::span<sim::DetectorState> states) override {
    wand_.at(time, states);
    if (!flat_ || time > wand_.options().wave) return;
    const Eigen::Vector3d n_W =
        (states[1].p_W - states[0].p_W).cross(states[2].p_W - states[0].p_W).normalized();
    for (sim::DetectorState& state : states) state.n_W = n_W;
  }
  bool hidden(std::size_t, const Eigen::Vector3d&) const override { return false; }

 private:
  sim::WandScene& wand_;
  bool flat_;
};

void calibrate_by_wand(const std::vector<sim::VirtualProjector>& rig,
                       const sim::OpticalNoise& noise, double seconds, bool guess, bool flat,
                       unsigned seed, Method& method) {
  sim::WandOptions options;
  options.wave = seconds;
  sim::WandScene scene(options, seed);
  Wand wand;
  for (const Eigen::Vector3d& p_TD : options.p_TD) {
    wand.lying_W.push_back(p_TD + options.rest_height * Eigen::Vector3d::UnitZ());
  }
  WandSettings settings;
  if (guess) settings.layout = layout_of(rig, seed);
  WandSession session(wand, kProjectors, settings);
  FlatWand held(scene, flat);
  sim::VirtualRig hardware(rig, held, noise, 200 * seed);
  double add = 0.0;
  std::size_t frames = 0;
  run(hardware, wand.lying_W.size(), scene.rests_from() + 2.0, [&](const ProjectorFrame& frame) {
    const double begin = now();
    session.add(frame);
    add += now() - begin;
    ++frames;
  });
  const double begin = now();
  const auto result = session.solve();
  method.solve.push_back(now() - begin);
  method.add_us.push_back(1e6 * add / static_cast<double>(frames));
  if (!result) {
    ++method.refused;
    return;
  }
  method.predicted.push_back(result->predicted_error);
  compare(rig, result->rig, method);
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app{"Projector calibration by grid and wand against the truth, and its cost"};
  bool json = false;
  unsigned seeds = 5;
  double height = 0.35;
  sim::OpticalNoise noise;
  noise.wild_share = 0.02;
  app.add_flag("--json", json, "print JSON");
  app.add_option("--seeds", seeds, "rigs, noises and waves");
  app.add_option("--wild", noise.wild_share, "share of wild values");
  app.add_option("--sigma", noise.count_sigma, "noise of a stripe's edge [counts]");
  app.add_option("--grid-height", height, "of the grid's detectors in its low position [m]");
  CLI11_PARSE(app, argc, argv);

  std::vector<Method> methods(9);
  methods[0].name = "true P";
  methods[1].name = "grid, 2.2.2 as printed";
  methods[2].name = "grid";
  methods[3].name = "grid, a third height";
  methods[4].name = "wand 60 s, rough layout";
  methods[5].name = "wand 60 s, no guess";
  methods[6].name = "wand 30 s, no guess";
  methods[7].name = "wand 15 s, no guess";
  methods[8].name = "wand 90 s, one side";
  for (unsigned seed = 1; seed <= seeds; ++seed) {
    const auto rig = set_up(seed);
    compare(rig, true_rig(rig), methods[0]);
    const double raised = sim::GridScene::kRaised;
    calibrate_by_grid(rig, noise, height, {0.0, raised}, seed, &methods[1], methods[2]);
    calibrate_by_grid(rig, noise, height, {0.0, 0.5 * raised, raised}, seed, nullptr, methods[3]);
    calibrate_by_wand(rig, noise, 60.0, true, false, seed, methods[4]);
    calibrate_by_wand(rig, noise, 60.0, false, false, seed, methods[5]);
    calibrate_by_wand(rig, noise, 30.0, false, false, seed, methods[6]);
    calibrate_by_wand(rig, noise, 15.0, false, false, seed, methods[7]);
    calibrate_by_wand(rig, noise, 90.0, false, true, seed, methods[8]);
  }

  nlohmann::json all = nlohmann::json::array();
  if (!json) {
    fmt::print("{:<24} {:>9} {:>9} {:>9} {:>9} {:>9} {:>9} {:>9} {:>7}\n", "calibration",
               "world rms", "p95 mm", "shape rms", "p95 mm", "predicted", "solve s", "frame us",
               "refused");
  }
  for (const Method& m : methods) {
    const nlohmann::json row = {{"method", m.name},
                                {"world_rms_mm", 1e3 * rms(m.world)},
                                {"world_p95_mm", 1e3 * quantile(m.world, 0.95)},
                                {"shape_rms_mm", 1e3 * rms(m.shape)},
                                {"shape_p95_mm", 1e3 * quantile(m.shape, 0.95)},
                                {"predicted_mm", 1e3 * rms(m.predicted)},
                                {"solve_s", quantile(m.solve, 0.5)},
                                {"frame_us", quantile(m.add_us, 0.5)},
                                {"refused", m.refused}};
    all.push_back(row);
    if (json) continue;
    fmt::print("{:<24} {:>9.2f} {:>9.2f} {:>9.2f} {:>9.2f} {:>9.2f} {:>9.2f} {:>9.1f} {:>7}\n",
               m.name, row["world_rms_mm"].get<double>(), row["world_p95_mm"].get<double>(),
               row["shape_rms_mm"].get<double>(), row["shape_p95_mm"].get<double>(),
               row["predicted_mm"].get<double>(), row["solve_s"].get<double>(),
               row["frame_us"].get<double>(), m.refused);
  }
  if (json) fmt::print("{}\n", all.dump(2));
  return 0;
}
