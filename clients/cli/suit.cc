#include <fmt/format.h>

#include <cmath>
#include <nlohmann/json.hpp>

#include "clients/cli/common.h"
#include "motion/suit.h"
#include "sim/optical/placement.h"
#include "sim/optical/suit_scene.h"

/// Where a suit's photodetectors sit, what they see over a motion, and where they should sit.
namespace secondskin::cli {
namespace {

using nlohmann::json;

struct SweepOptions {
  std::string motion, suit;
  SourceOptions from;
  std::vector<std::string> segments;
  std::size_t best = 6;
  bool as_json = false;
};

void sweep(const SweepOptions& options) {
  const Library library;
  const auto source = options.from.open(options.motion, library);
  const Motion motion = sim::recentred(server::read_all(*source));
  const auto rig = sim::second_skin_rig();
  sim::PlacementOptions settings;
  settings.best = options.best;
  std::vector<sim::PlacementScore> scores;
  if (!options.suit.empty()) {
    scores =
        sim::score_suit(motion, Suit::load(library.find_suit(options.suit)), rig, {}, settings);
  } else {
    sim::PlacementGrid grid;
    for (const auto& name : options.segments) {
      const auto joint = find_joint(name);
      if (!joint) throw std::runtime_error(fmt::format("--segment '{}': no canonical joint", name));
      grid.segments.push_back(*joint);
    }
    scores = sim::sweep_places(motion, grid, rig, {}, settings);
  }
  json all = json::array();
  if (!options.as_json) {
    fmt::print("{:<16} {:<16} {:>5} {:>9} {:>8} {:>7} {:>11} {:>5}\n", "detector", "segment",
               "along", "angle_deg", "visible", "planes", "sigma [mm]", "rank");
  }
  for (const auto& score : scores) {
    if (options.suit.empty() && score.rank == 0 && !options.as_json) continue;
    const std::string name = score.place.name.empty() ? "-" : score.place.name;
    if (options.as_json) {
      all.push_back({{"detector", score.place.name},
                     {"segment", joint_name(score.place.segment)},
                     {"along", score.place.along},
                     {"angle_deg", deg(score.place.angle)},
                     {"visible", score.visible},
                     {"planes", score.planes},
                     {"sigma_mm", std::isfinite(score.sigma) ? json(1e3 * score.sigma) : json()},
                     {"rank", score.rank}});
      continue;
    }
    fmt::print("{:<16} {:<16} {:5.2f} {:9.0f} {:6.0f} % {:7.1f} {:11.2f} {:>5}\n", name,
               joint_name(score.place.segment), score.place.along, deg(score.place.angle),
               100.0 * score.visible, score.planes, 1e3 * score.sigma,
               score.rank > 0 ? std::to_string(score.rank) : "-");
  }
  if (options.as_json) fmt::print("{}\n", all.dump(2));
}

}  // namespace

void add_suit(CLI::App& app) {
  auto* command = app.add_subcommand("suit", "where photodetectors sit and should sit");
  command->require_subcommand(1);
  command->footer("Example:  secondskin suit sweep learner.bvh --segment left_elbow");
  auto options = std::make_shared<SweepOptions>();
  auto* sweep_command = command->add_subcommand(
      "sweep", "try detector placements on a motion: how often seen, how well measured");
  sweep_command->footer(
      "Example:  secondskin suit sweep learner.bvh --segment left_elbow --best 4\n"
      "          secondskin suit sweep learner.bvh --of full_body");
  sweep_command->add_option("motion", options->motion, kSourceHelp)->required();
  sweep_command->add_option("--of", options->suit,
                            "report the detectors of this suit instead of trying places");
  sweep_command->add_option("--segment", options->segments,
                            "only these segments (default: all that full_body covers)");
  sweep_command->add_option("--best", options->best, "how many to choose on a segment")
      ->check(CLI::Range(1, 60))
      ->capture_default_str();
  sweep_command->add_flag("--json", options->as_json, "all tried places, as JSON");
  add_source_options(*sweep_command, options->from);
  sweep_command->callback([options] { sweep(*options); });
}

}  // namespace secondskin::cli
