#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <nlohmann/json.hpp>

#include "clients/authoring/export_motion.h"
#include "clients/authoring/save.h"
#include "clients/cli/common.h"
#include "server/open_source.h"
#include "server/replay/motion_source.h"

namespace secondskin::cli {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

json describe(const coach::Reference& reference, const fs::path& folder) {
  json joints = json::object();
  for (std::size_t j = 0; j < kJointCount; ++j) {
    if (reference.weight[j] <= 0.0) continue;
    joints[std::string(joint_name(static_cast<Joint>(j)))] = {
        {"weight", reference.weight[j]}, {"tolerance_deg", deg(reference.tolerance[j])}};
  }
  return {{"name", reference.name},
          {"description", reference.description},
          {"duration_s", reference.motion.duration()},
          {"standing", reference.standing},
          {"origin", reference.origin},
          {"licence", reference.licence},
          {"folder", folder.string()},
          {"joints", joints}};
}

void list(bool as_json) {
  const Library library;
  json all = json::array();
  for (const auto& folder : library.references()) {
    try {
      const auto reference = library.load_reference(folder.string());
      all.push_back(describe(*reference, folder));
      if (!as_json) {
        fmt::print("{:<16} {:5.1f} s  {}\n", folder.filename().string(),
                   reference->motion.duration(), reference->description);
      }
    } catch (const std::exception& error) {  // one bad folder must not hide the others
      spdlog::warn("{}", error.what());
    }
  }
  if (as_json) fmt::print("{}\n", all.dump(2));
  if (all.empty() && !as_json)
    fmt::print("no references; add one with 'secondskin reference add'\n");
}

void show(const std::string& name, bool as_json) {
  const Library library;
  const auto reference = library.load_reference(name);
  const json out = describe(*reference, library.find_reference(name));
  if (as_json) {
    fmt::print("{}\n", out.dump(2));
    return;
  }
  fmt::print("{} - {}\n{:.2f} s at {:g} Hz{}\norigin: {}\nlicence: {}\n", reference->name,
             reference->description, reference->motion.duration(), reference->motion.rate_hz,
             reference->standing ? ", standing" : "", reference->origin, reference->licence);
  fmt::print("{:<16} {:>6} {:>10}\n", "joint", "weight", "tolerance");
  for (std::size_t j = 0; j < kJointCount; ++j) {
    if (reference->weight[j] > 0.0) {
      fmt::print("{:<16} {:6.2f} {:6.1f} deg\n", joint_name(static_cast<Joint>(j)),
                 reference->weight[j], deg(reference->tolerance[j]));
    }
  }
}

struct AddOptions {
  std::string source, name, description;
  double start = 0.0;
  std::optional<double> end;
  SourceOptions from;
};

void add(const AddOptions& options) {
  const Library library;
  const auto source = options.from.open(options.source, library);
  Motion motion = server::read_all(*source);
  const double end = options.end.value_or(motion.duration());
  if (!(options.start >= 0.0) || !(end > options.start) || end > motion.duration() + 1e-6) {
    throw std::runtime_error(fmt::format("--start {} --end {}: expected 0 <= start < end <= {:.2f}",
                                         options.start, end, motion.duration()));
  }
  const auto at = [&](double time) {
    return static_cast<std::size_t>(time * motion.rate_hz + 0.5);
  };
  motion = slice(motion, at(options.start), std::min(at(end) + 1, motion.poses.size()));

  const double duration = motion.duration();
  auto recipe = authoring::plain_recipe(options.name, {std::move(motion)});
  recipe.description = options.description;
  recipe.origin = options.source;
  const fs::path folder =
      authoring::save_reference(recipe, library.own_references(), library.joint_maps());
  fmt::print("reference '{}' ({:.2f} s) is in {}\n", options.name, duration, folder.string());
}

}  // namespace

void add_reference(CLI::App& app) {
  auto* command =
      app.add_subcommand("reference", "list, show, record, add and export reference motions");
  command->require_subcommand(1);
  command->footer("Example:  secondskin reference add my_squat.bvh --name squat --end 4.5");

  auto as_json = std::make_shared<bool>(false);
  auto* list_command = command->add_subcommand("list", "all that are known");
  list_command->footer("Example:  secondskin reference list");
  list_command->add_flag("--json", *as_json, "as JSON");
  list_command->callback([as_json] { list(*as_json); });

  auto name = std::make_shared<std::string>();
  auto* show_command = command->add_subcommand("show", "joints of interest, tolerances, origin");
  show_command->footer("Example:  secondskin reference show squat");
  show_command->add_option("name", *name, "name, folder or motion file")->required();
  show_command->add_flag("--json", *as_json, "as JSON");
  show_command->callback([name, as_json] { show(*name, *as_json); });

  auto options = std::make_shared<AddOptions>();
  auto* add_command = command->add_subcommand("add", "make one of a motion file or a recording");
  add_command->footer("Example:  secondskin reference add my_squat.bvh --name squat --end 4.5");
  add_command->add_option("source", options->source, kSourceHelp)->required();
  add_command->add_option("--name", options->name, "what to call it")->required();
  add_command->add_option("--description", options->description, "a line for people");
  add_command->add_option("--start", options->start, "cut from here [s]")->capture_default_str();
  add_command->add_option("--end", options->end, "cut to here [s] (default: the end)");
  add_source_options(*add_command, options->from);
  add_command->callback([options] { add(*options); });

  auto to = std::make_shared<fs::path>();
  auto* export_command = command->add_subcommand(
      "export", "the mean of a reference's performances as a file for other programs");
  export_command->footer("Example:  secondskin reference export squat --to squat.c3d");
  export_command->add_option("name", *name, "name, folder or motion file")->required();
  export_command
      ->add_option("--to", *to,
                   "FILE.bvh, FILE.csv, FILE.c3d, FILE.trc or FILE.mcap; c3d and trc "
                   "hold the joints' centres")
      ->required();
  export_command->callback([name, to] {
    const Library library;
    server::MotionSource source(library.load_reference(*name)->motion);
    authoring::export_source(source, "reference:" + *name, library.idl(), *to);
    spdlog::info("wrote {}", to->string());
  });

  add_reference_record(*command);
}

}  // namespace secondskin::cli
