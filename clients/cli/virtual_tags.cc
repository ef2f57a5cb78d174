#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <cmath>

#include "clients/cli/common.h"
#include "clients/cli/virtual_suit.h"
#include "server/markers/body_file.h"
#include "sim/optical/calibration_scenes.h"
#include "sim/optical/placement.h"

/// Virtual optical hardware as commands: tags on pseudo-terminals or in files, and where a suit's
/// detectors should sit.
namespace secondskin::cli {
namespace {

namespace fs = std::filesystem;

struct TagOptions {
  std::string scene;
  SourceOptions from;
  std::string ports, files;
  double seconds = 0.0;
  double jitter_ms = 10.0;
  double torn = 0.0;
  double wild = 0.0;
  std::vector<std::size_t> dark;
  std::uint64_t seed = 1;
  fs::path calibration, body;
};

/// The scene, what moves in it, and how long it is worth looking at.
struct Scene {
  std::unique_ptr<sim::OpticalScene> scene;
  std::vector<std::size_t> tag_sizes;
  double seconds = 0.0;
};

Scene make_scene(const TagOptions& options, const Library& library) {
  Scene out;
  if (options.scene == "wand") {
    auto wand = std::make_unique<sim::WandScene>();
    out.tag_sizes = {wand->detectors()};
    out.seconds = wand->rests_from() + 4.0;
    out.scene = std::move(wand);
  } else if (options.scene == "grid" || options.scene == "raised-grid") {
    auto grid =
        std::make_unique<sim::GridScene>(options.scene == "grid" ? 0.0 : sim::GridScene::kRaised);
    out.tag_sizes = {grid->detectors()};
    out.seconds = 20.0;
    out.scene = std::move(grid);
  } else {
    const Suit suit = Suit::load(options.from.settings(library).optical.suit);
    const auto source = options.from.open(options.scene, library);
    const Motion motion = sim::recentred(server::read_all(*source));
    auto worn = std::make_unique<sim::SuitScene>(motion, suit);
    if (!options.body.empty()) server::save_body(true_body(*worn, suit), options.body);
    out.tag_sizes = sim::tag_sizes(suit);
    out.seconds = motion.duration();
    out.scene = std::move(worn);
  }
  if (options.seconds > 0.0) out.seconds = options.seconds;
  return out;
}

void virtual_tags(const TagOptions& options) {
  StopOnSignal signals;
  const Library library;
  if (options.ports.empty() == options.files.empty()) {
    throw std::runtime_error("expected either --ports PREFIX or --files PREFIX");
  }
  Scene scene = make_scene(options, library);
  sim::OpticalNoise noise;
  noise.wild_share = options.wild;
  sim::VirtualRig rig(sim::second_skin_rig(), *scene.scene, noise, options.seed);
  if (!options.calibration.empty()) true_calibration(rig.projectors()).save(options.calibration);
  for (const std::size_t p : options.dark) {
    if (p >= rig.projectors().size()) {
      throw std::runtime_error(
          fmt::format("--dark {}: expected 0 to {}", p, rig.projectors().size() - 1));
    }
    rig.projectors()[p].dark = true;
  }
  sim::TagLink link;
  link.gray = options.from.gray;
  link.latency = 0.005;
  link.jitter = options.jitter_ms * 1e-3;
  link.torn_share = options.torn;

  std::vector<std::string> names;
  const std::string& prefix = options.ports.empty() ? options.files : options.ports;
  for (std::size_t tag = 0; tag < scene.tag_sizes.size(); ++tag) {
    names.push_back(fmt::format("{}{}{}", prefix, tag, options.ports.empty() ? ".tag" : ""));
  }
  if (!options.files.empty()) {
    sim::VirtualTags tags(rig, scene.tag_sizes, link, options.seed);
    const std::vector<fs::path> files(names.begin(), names.end());
    sim::write_tag_files(
        tags, static_cast<std::size_t>(std::lround(scene.seconds / tags.cycle_time())), files);
    fmt::print("{:.1f} s of {} are in", scene.seconds, options.scene);
    for (const auto& name : names) fmt::print(" {}", name);
    fmt::print("\n");
    return;
  }
  sim::VirtualTagsRunner runner(rig, scene.tag_sizes, link, options.seed, names);
  for (std::size_t tag = 0; tag < runner.tags(); ++tag)
    fmt::print("tag {} {}\n", tag, runner.path(tag));
  std::fflush(stdout);
  std::jthread thread([&runner](std::stop_token stop) { runner.run(stop); });
  wait_for_stop(signals.token(), options.seconds > 0.0 ? options.seconds : INFINITY);
  thread.request_stop();
  thread.join();
  const auto counters = runner.counters();
  fmt::print("virtual tags: {} cycles, {} bytes written, {} bytes nobody read\n", counters.cycles,
             counters.bytes, counters.dropped_bytes);
}

}  // namespace

void add_virtual_tags(CLI::App& app) {
  auto options = std::make_shared<TagOptions>();
  auto* command = app.add_subcommand(
      "virtual-tags", "photodetector tags and projectors of software, where none are attached");
  command->footer(
      "Example:  secondskin virtual-tags learner.bvh --ports /tmp/tag --calibration "
      "projectors.txt\n"
      "          secondskin virtual-tags wand --files /tmp/wand");
  command
      ->add_option("scene", options->scene,
                   "a SOURCE whose body wears the suit, or 'wand', 'grid', 'raised-grid'")
      ->required();
  command->add_option("--ports", options->ports, "serve pseudo-terminals PREFIX0, PREFIX1, ...");
  command->add_option("--files", options->files, "write PREFIX0.tag, PREFIX1.tag, ... instead");
  command->add_option("--seconds", options->seconds,
                      "for so long (default: the scene; ports: until stopped)");
  command->add_option("--jitter-ms", options->jitter_ms, "of the radio link, over its 5 ms")
      ->check(CLI::Range(0.0, 1000.0))
      ->capture_default_str();
  command->add_option("--torn", options->torn, "share of sets that lose bytes")
      ->check(CLI::Range(0.0, 1.0))
      ->capture_default_str();
  command->add_option("--wild", options->wild, "share of values that are any value")
      ->check(CLI::Range(0.0, 1.0))
      ->capture_default_str();
  command->add_option("--dark", options->dark, "projectors that show nothing");
  command->add_option("--seed", options->seed, "of all chance")->capture_default_str();
  command->add_option("--calibration", options->calibration,
                      "write the virtual projectors' true calibration here");
  command->add_option("--true-body", options->body, "write the body's true measures here");
  add_motion_options(*command, options->from);
  command->callback([options] { virtual_tags(*options); });
}

}  // namespace secondskin::cli
