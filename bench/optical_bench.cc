// How far are the detectors' points from the truth? A suit on bodies that move by real motions,
// seen by virtual projectors (sim/optical) with noise, wild values and partial codes, through the
// paper's chain (Second Skin, 2.2.3 to 2.2.6) with each stage off in turn and through ours; by
// calibration method, with faults; and what it costs. docs/optical-tracking.md quotes the output.

#include <fmt/core.h>
#include <time.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cmath>
#include <filesystem>
#include <functional>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>
#include <random>
#include <stdexcept>
#include <string>
#include <vector>

#include "motion/retarget.h"
#include "motion/suit.h"
#include "server/optical/calibrate/grid_calibration.h"
#include "server/optical/calibrate/projector_fit.h"
#include "server/optical/calibrate/wand_calibration.h"
#include "server/optical/track/body_tracker.h"
#include "server/optical/track/paper_chain.h"
#include "sim/optical/calibration_scenes.h"
#include "sim/optical/suit_scene.h"
#include "sim/optical/virtual_rig.h"
#include "wire/photo_tag.h"

namespace {

using namespace secondskin;
using namespace secondskin::server;
namespace fs = std::filesystem;

constexpr std::size_t kProjectors = 16;
constexpr double kCycle = 1e-9 * static_cast<double>(wire::cycle_ns(kProjectors));
constexpr std::size_t kWarmUp = 60;  // cycles that are not counted
constexpr double kVolumeRadius = 3.25 * 0.3048, kVolumeHeight = 6.0 * 0.3048;  // 2.3 [m]
constexpr double kWrong = 0.05;  // a point so far off is wrong, not inaccurate [m]

// Processor time of this thread [s]: what other processes do does not count.
double cpu_time() {
  timespec t{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
  return static_cast<double>(t.tv_sec) + 1e-9 * static_cast<double>(t.tv_nsec);
}

// What the detectors read over a motion, and where they were.
struct Recording {
  std::string name;
  std::vector<ProjectorFrame> frames;
  std::vector<std::vector<Eigen::Vector3d>> middle, end;  // of each cycle; by detector [m]
};

Recording record(const std::string& name, const Motion& motion, const Suit& suit, double seconds,
                 const sim::OpticalNoise& noise, unsigned seed) {
  sim::SuitScene scene(sim::recentred(motion), suit, sim::AtEnd::kThereAndBack);
  sim::VirtualRig rig(sim::second_skin_rig(), scene, noise, seed);
  Recording recording{name, {}, {}, {}};
  std::vector<sim::DetectorState> states(scene.detectors());
  const auto places = [&](double time) {
    scene.at(time, states);
    std::vector<Eigen::Vector3d> p_W;
    for (const auto& state : states) p_W.push_back(state.p_W);
    return p_W;
  };
  for (std::uint64_t k = 0; static_cast<double>(k) * kCycle < seconds; ++k) {
    const double time = static_cast<double>(k) * kCycle;
    ProjectorFrame frame(scene.detectors(), kProjectors);
    frame.cycle = k;
    frame.stamp_ns = static_cast<std::int64_t>(k) * wire::cycle_ns(kProjectors);
    rig.cycle(time, frame.values);
    recording.frames.push_back(std::move(frame));
    recording.middle.push_back(places(time + 0.5 * kCycle));
    recording.end.push_back(places(time + kCycle));
  }
  return recording;
}

// A way from values to points.
struct Method {
  std::string name;
  std::size_t delay = 0;     // cycles
  bool of_cycle_end = true;  // the instant its points belong to: the cycle's end or its middle
  std::function<void(const ProjectorFrame&, MarkerFrame&)> update;
};

Method paper(const std::string& name, const ProjectorRig& rig, std::size_t detectors,
             const std::function<void(PaperChainOptions&)>& change = {}) {
  PaperChainOptions options;
  if (change) change(options);
  auto chain = std::make_shared<PaperChain>(rig, detectors, options);
  return {name, chain->delay_frames(), false,
          [chain](const ProjectorFrame& frame, MarkerFrame& out) { chain->update(frame, out); }};
}

Method detector(const std::string& name, const ProjectorRig& rig, std::size_t detectors,
                const TrackerOptions& options = {}) {
  auto tracker = std::make_shared<DetectorTracker>(rig, detectors, options);
  return {name, 0, true,
          [tracker](const ProjectorFrame& f, MarkerFrame& out) { tracker->update(f, out); }};
}

Method body(const std::string& name, const ProjectorRig& rig,
            const std::vector<std::size_t>& segment_of, const BodyTrackerOptions& options = {}) {
  auto tracker = std::make_shared<BodyTracker>(rig, segment_of, options);
  return {name, 0, true,
          [tracker](const ProjectorFrame& f, MarkerFrame& out) { tracker->update(f, out); }};
}

struct Errors {
  std::vector<double> own;   // against the instant that the point belongs to [m]
  std::vector<double> live;  // against where the detector is when the point comes out [m]
  double normalised = 0.0;   // sum of (error / residual)^2, where a residual is given
  std::size_t residuals = 0;
  std::size_t seen = 0, tracked = 0;  // samples with four planes; of those with a point
  std::size_t samples = 0, points = 0;
  double cpu = 0.0;  // [s]
};

double rms(const std::vector<double>& v) {
  double sum = 0.0;
  for (const double x : v) sum += x * x;
  return v.empty() ? NAN : std::sqrt(sum / static_cast<double>(v.size()));
}

double quantile(std::vector<double> v, double q) {
  if (v.empty()) return NAN;
  const auto at = static_cast<std::size_t>(q * static_cast<double>(v.size() - 1));
  std::nth_element(v.begin(), v.begin() + static_cast<std::ptrdiff_t>(at), v.end());
  return v[at];
}

bool inside(const Eigen::Vector3d& p_W) {
  return p_W.head<2>().norm() <= kVolumeRadius && p_W.z() >= 0.0 && p_W.z() <= kVolumeHeight;
}

void run(const Recording& recording, Method& method, Errors& errors) {
  const std::size_t detectors = recording.frames.front().detectors;
  MarkerFrame out(detectors);
  for (std::size_t k = 0; k < recording.frames.size(); ++k) {
    const double begin = cpu_time();
    method.update(recording.frames[k], out);
    errors.cpu += cpu_time() - begin;
    errors.samples += detectors;
    if (k < kWarmUp) continue;
    const std::size_t of = k - method.delay;
    const auto& truth = method.of_cycle_end ? recording.end[of] : recording.middle[of];
    for (std::size_t d = 0; d < detectors; ++d) {
      if (!inside(truth[d])) continue;
      int planes = 0;
      for (std::size_t p = 0; p < kProjectors; ++p) {
        planes += recording.frames[of].value(d, p) != wire::kNoValue ? 1 : 0;
      }
      const bool seen = planes >= static_cast<int>(kFewestPlanes);
      errors.seen += seen ? 1 : 0;
      if (out.visible[d] == 0) continue;
      errors.tracked += seen ? 1 : 0;
      ++errors.points;
      const double error = (out.p_WM[d] - truth[d]).norm();
      errors.own.push_back(error);
      errors.live.push_back((out.p_WM[d] - recording.end[k][d]).norm());
      if (out.residual[d] > 0.0F) {
        const double ratio = error / static_cast<double>(out.residual[d]);
        errors.normalised += std::min(ratio * ratio, 25.0);
        ++errors.residuals;
      }
    }
  }
}

nlohmann::json report(const std::string& table, const Method& method, const Errors& e) {
  const auto wrong = std::count_if(e.own.begin(), e.own.end(), [](double x) { return x > kWrong; });
  return {{"table", table},
          {"method", method.name},
          {"delay_frames", method.delay},
          {"rms_mm", 1e3 * rms(e.own)},
          {"median_mm", 1e3 * quantile(e.own, 0.5)},
          {"p95_mm", 1e3 * quantile(e.own, 0.95)},
          {"p99_mm", 1e3 * quantile(e.own, 0.99)},
          {"max_mm", 1e3 * quantile(e.own, 1.0)},
          {"live_rms_mm", 1e3 * rms(e.live)},
          {"live_p95_mm", 1e3 * quantile(e.live, 0.95)},
          {"wrong_ppm", 1e6 * static_cast<double>(wrong) / static_cast<double>(e.own.size())},
          {"tracked", 100.0 * static_cast<double>(e.tracked) / static_cast<double>(e.seen)},
          {"points", e.points},
          {"normalised", e.residuals > 0 ? e.normalised / static_cast<double>(e.residuals) : NAN},
          {"cost_ns", 1e9 * e.cpu / static_cast<double>(e.samples)}};
}

void print_head(const std::string& title) {
  fmt::print("\n{}\n{:<34} {:>5} {:>7} {:>6} {:>6} {:>7} {:>8} {:>8} {:>9} {:>8} {:>7} {:>6}\n",
             title, "points in mm", "delay", "RMS", "median", "p95", "p99", "max", "now p95",
             ">50mm ppm", "tracked%", "(e/s)^2", "ns");
}

void print(const nlohmann::json& r) {
  fmt::print(
      "{:<34} {:>5} {:>7.2f} {:>6.2f} {:>6.2f} {:>7.1f} {:>8.1f} {:>8.1f} {:>9.0f} {:>8.1f} "
      "{:>7.2f} {:>6.0f}\n",
      r["method"].get<std::string>(), r["delay_frames"].get<int>(), r["rms_mm"].get<double>(),
      r["median_mm"].get<double>(), r["p95_mm"].get<double>(), r["p99_mm"].get<double>(),
      r["max_mm"].get<double>(), r["live_p95_mm"].get<double>(), r["wrong_ppm"].get<double>(),
      r["tracked"].get<double>(), r["normalised"].is_null() ? NAN : r["normalised"].get<double>(),
      r["cost_ns"].get<double>());
}

ProjectorRig true_rig() {
  ProjectorRig rig;
  for (const auto& projector : sim::second_skin_rig()) {
    rig.projectors.push_back(Projector{projector.matrix()});
  }
  return rig;
}

// Shows a scene to the projectors.
void show(sim::OpticalScene& scene, const sim::OpticalNoise& noise, double seconds, unsigned seed,
          const std::function<void(const ProjectorFrame&)>& take) {
  sim::VirtualRig rig(sim::second_skin_rig(), scene, noise, seed);
  ProjectorFrame frame(scene.detectors(), kProjectors);
  for (std::uint64_t k = 0; static_cast<double>(k) * kCycle < seconds; ++k) {
    rig.cycle(static_cast<double>(k) * kCycle, frame.values);
    frame.cycle = k;
    frame.stamp_ns = static_cast<std::int64_t>(k) * wire::cycle_ns(kProjectors);
    take(frame);
  }
}

// The grid at the paper's two heights; as the paper solves it, and as GridCalibration does.
std::pair<ProjectorRig, ProjectorRig> grid_rigs(const sim::OpticalNoise& noise) {
  constexpr double kLow = 0.35;  // the low grid's detectors over the floor [m]
  CalibrationGrid grid;
  grid.heights = {0.0, sim::GridScene::kRaised};
  std::optional<GridCalibration> session;
  for (std::size_t h = 0; h < grid.heights.size(); ++h) {
    sim::GridScene scene(kLow + grid.heights[h]);
    if (h == 0) {
      grid.p_W.assign(scene.positions().begin(), scene.positions().end());
      session.emplace(grid, kProjectors);
    }
    show(scene, noise, 16.0, 100 + static_cast<unsigned>(h),
         [&](const ProjectorFrame& frame) { session->add(frame, h); });
  }
  ProjectorRig paper;
  for (std::size_t p = 0; p < kProjectors; ++p) {
    std::vector<Reading> readings;
    for (std::size_t h = 0; h < grid.heights.size(); ++h) {
      for (std::size_t d = 0; d < grid.p_W.size(); ++d) {
        if (const auto value = session->value(d, p, h)) {
          readings.push_back(
              {grid.p_W[d] + grid.heights[h] * Eigen::Vector3d::UnitZ(), std::round(*value)});
        }
      }
    }
    auto& place = paper.projectors.emplace_back();
    if (const auto fit = fit_projector_algebraic(readings)) place = *fit;
  }
  const auto result = session->solve();
  if (!result) throw std::runtime_error("grid calibration: " + result.error().text);
  return {paper, result->rig};
}

ProjectorRig wand_rig(const sim::OpticalNoise& noise) {
  sim::WandScene scene;
  Wand wand;
  for (const Eigen::Vector3d& p_TD : scene.options().p_TD) {
    wand.lying_W.push_back(p_TD + scene.options().rest_height * Eigen::Vector3d::UnitZ());
  }
  WandSession session(wand, kProjectors);
  show(scene, noise, scene.rests_from() + 2.0, 200,
       [&](const ProjectorFrame& frame) { session.add(frame); });
  const auto result = session.solve();
  if (!result) throw std::runtime_error("wand calibration: " + result.error().text);
  return result->rig;
}

// All values of a share of the tags' sets are others', as if a torn set had been taken for a whole
// one; the decoder never gives such a set.
void tear(Recording& recording, const Suit& suit, double share) {
  std::mt19937 random(11);
  std::uniform_real_distribution<double> uniform;
  for (ProjectorFrame& frame : recording.frames) {
    for (std::size_t tag = 0; tag < suit.tags(); ++tag) {
      if (uniform(random) >= share) continue;
      // A byte was lost: from somewhere on every value stands one place early.
      std::vector<std::size_t> places;
      for (std::size_t d = 0; d < suit.detectors.size(); ++d) {
        if (suit.detectors[d].tag != tag) continue;
        for (std::size_t p = 0; p < kProjectors; ++p) places.push_back(d * kProjectors + p);
      }
      for (std::size_t i = random() % places.size(); i + 1 < places.size(); ++i) {
        frame.values[places[i]] = frame.values[places[i + 1]];
      }
    }
  }
}

}  // namespace

int main(int argc, char** argv) try {
  CLI::App app{"Detector accuracy against truth, by method, calibration and fault, and its cost"};
  fs::path repository = SECONDSKIN_SOURCE_DIR;
  fs::path data = repository / ".." / "shared" / "data";
  bool json = false, calibrations = true, faults = true;
  double seconds = 60.0;
  std::string suit_name = "full_body";
  sim::OpticalNoise noise;
  noise.wild_share = 0.02;
  app.add_flag("--json", json, "print JSON");
  app.add_flag("--calibrations,!--no-calibrations", calibrations, "grid and wand as well");
  app.add_flag("--faults,!--no-faults", faults, "torn sets, dark projector, swapped detectors");
  app.add_option("--seconds", seconds, "how long each motion goes on")->capture_default_str();
  app.add_option("--suit", suit_name, "under suits/")->capture_default_str();
  app.add_option("--wild", noise.wild_share, "share of wild values")->capture_default_str();
  app.add_option("--sigma", noise.count_sigma, "noise of a stripe's edge [counts]")
      ->capture_default_str();
  app.add_option("--data", data, "the folder with bvh/cmu");
  CLI11_PARSE(app, argc, argv);

  const Suit suit = Suit::load(repository / "suits" / (suit_name + ".toml"));
  const std::size_t detectors = suit.detectors.size();
  std::vector<std::size_t> segment_of;
  for (const auto& d : suit.detectors) segment_of.push_back(index(d.segment));
  std::vector<fs::path> files;
  for (const char* name :
       {"131_01", "135_05_gedanbarai", "135_07_mawashigeri", "135_09_oiduki", "13_26", "14_14"}) {
    const fs::path file = data / "bvh" / "cmu" / (std::string(name) + ".bvh");
    if (fs::exists(file)) files.push_back(file);
  }
  if (files.empty()) {
    fmt::print(stderr, "{} has no bvh/cmu; using the reference motions' learners\n", data.string());
    for (const auto& entry : fs::directory_iterator(repository / "reference_motions")) {
      if (fs::exists(entry.path() / "learner.bvh")) files.push_back(entry.path() / "learner.bvh");
    }
    std::sort(files.begin(), files.end());
  }
  std::vector<Recording> recordings;
  for (std::size_t f = 0; f < files.size(); ++f) {
    const Motion motion = read_canonical(files[f], repository / "joint_maps");
    recordings.push_back(record(files[f].stem().string(), motion, suit, seconds, noise,
                                20 + static_cast<unsigned>(f)));
  }

  nlohmann::json all = nlohmann::json::array();
  using Make = std::function<Method()>;
  const auto table = [&](const std::string& title, const std::vector<Recording>& over,
                         const std::vector<Make>& methods) {
    if (!json) print_head(title);
    for (const Make& make : methods) {
      Errors errors;
      std::optional<Method> method;
      for (const Recording& recording : over) {
        method.emplace(make());
        run(recording, *method, errors);
      }
      all.push_back(report(title, *method, errors));
      if (!json) print(all.back());
    }
  };

  const ProjectorRig truth = true_rig();
  const auto paper_without = [&](const std::string& name,
                                 const std::function<void(PaperChainOptions&)>& change) {
    return Make([&, name, change] { return paper(name, truth, detectors, change); });
  };
  TrackerOptions no_slots;
  no_slots.slot_times = false;
  BodyTrackerOptions body_no_slots;
  body_no_slots.detector.slot_times = false;
  BodyTrackerOptions strict;
  strict.detector.visible_sigma = 0.007;
  table("by method, true calibration", recordings,
        {paper_without("paper's chain", [](auto&) {}),
         paper_without("  no value filter", [](auto& o) { o.value_filter.reset(); }),
         paper_without("  no row removal", [](auto& o) { o.row_removal = false; }),
         paper_without("  no smoother", [](auto& o) { o.smoother.reset(); }),
         paper_without("  plain least squares",
                       [](auto& o) {
                         o.value_filter.reset();
                         o.row_removal = false;
                         o.smoother.reset();
                       }),
         paper_without("  limit 10", [](auto& o) { o.variance_limit = 10.0; }),
         paper_without("  limit 100 on |Ax-b| as printed",
                       [](auto& o) { o.variance_limit = 100.0 * 100.0; }),
         [&] { return detector("detector tracker", truth, detectors); },
         [&] { return detector("  slots' times ignored", truth, detectors, no_slots); },
         [&] { return body("body tracker", truth, segment_of); },
         [&] { return body("  slots' times ignored", truth, segment_of, body_no_slots); },
         [&] { return body("  given out to 7 mm only", truth, segment_of, strict); }});

  for (const Recording& recording : recordings) {
    table("by motion: " + recording.name, {recording},
          {[&] { return paper("paper's chain", truth, detectors); },
           [&] { return body("body tracker", truth, segment_of); }});
  }

  if (calibrations) {
    const auto [grid_paper, grid] = grid_rigs(noise);
    const ProjectorRig wand = wand_rig(noise);
    const auto with = [&](const std::string& how, const ProjectorRig& rig) {
      return std::vector<Make>{[&, how] { return paper("paper's chain, " + how, rig, detectors); },
                               [&, how] { return body("body tracker, " + how, rig, segment_of); }};
    };
    std::vector<Make> methods;
    for (const auto& [how, rig] : {std::pair<std::string, const ProjectorRig*>{"true P", &truth},
                                   {"grid as in 2.2.2", &grid_paper},
                                   {"grid", &grid},
                                   {"wand", &wand}}) {
      for (auto& make : with(how, *rig)) methods.push_back(make);
    }
    table("by calibration", recordings, methods);
  }

  if (faults) {
    const std::vector<Make> methods{[&] { return paper("paper's chain", truth, detectors); },
                                    [&] { return body("body tracker", truth, segment_of); }};
    for (const double share : {0.01, 0.1}) {
      std::vector<Recording> torn = recordings;
      for (Recording& recording : torn) tear(recording, suit, share);
      table(fmt::format("{:.0f} % of the sets torn and taken for whole", 100.0 * share), torn,
            methods);
    }
    std::vector<Recording> dark = recordings;
    for (Recording& recording : dark) {
      for (std::size_t k = recording.frames.size() / 2; k < recording.frames.size(); ++k) {
        for (std::size_t d = 0; d < detectors; ++d) {
          recording.frames[k].values[d * kProjectors + 5] = wire::kNoValue;
        }
      }
    }
    table("a projector dark from the middle on", dark, methods);
    // The first detectors of the two first tags exchanged, in the wires and so in the truth: what
    // is wrong is only what the tracker believes of their segments.
    std::vector<std::size_t> swapped = segment_of;
    const std::size_t first = 0;
    const std::size_t other = std::min<std::size_t>(wire::kDetectorsOnATag + 9, detectors - 1);
    std::swap(swapped[first], swapped[other]);
    table("two detectors swapped in the configuration", recordings,
          {[&] { return body("body tracker", truth, swapped); }});
  }

  const double frame_rate = 1.0 / kCycle;
  for (const char* name : {"paper's chain", "detector tracker", "body tracker"}) {
    const auto row = std::find_if(all.begin(), all.end(),
                                  [&](const nlohmann::json& r) { return r["method"] == name; });
    const double seconds_each = 1e-9 * (*row)["cost_ns"].get<double>();
    nlohmann::json cost{{"table", "cost"},
                        {"method", name},
                        {"ns_per_detector_frame", 1e9 * seconds_each},
                        {"share_of_a_core_72", 100.0 * 72.0 * frame_rate * seconds_each},
                        {"detectors_in_real_time", 1.0 / (frame_rate * seconds_each)}};
    if (!json) {
      if (std::string(name) == "paper's chain") fmt::print("\ncost at 62.5 Hz, 16 projectors\n");
      fmt::print(
          "{:<34} {:>6.0f} ns a detector and frame, 72 detectors {:.2f} % of a core, {:.0f} "
          "detectors in real time\n",
          name, cost["ns_per_detector_frame"].get<double>(),
          cost["share_of_a_core_72"].get<double>(), cost["detectors_in_real_time"].get<double>());
    }
    all.push_back(std::move(cost));
  }
  if (json) fmt::print("{}\n", all.dump(2));
  return 0;
} catch (const std::exception& error) {
  fmt::print(stderr, "optical_bench: {}\n", error.what());
  return 1;
}
