#include <fmt/format.h>
#include <spdlog/spdlog.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <future>

#include "clients/cli/common.h"
#include "motion/marker_file.h"
#include "server/markers/body_file.h"
#include "server/markers/marker_body.h"
#include "server/open_source.h"
#include "server/optical/calibrate/grid_calibration.h"
#include "server/optical/calibrate/wand_calibration.h"

/// Setting the optical system up: the projectors with wand or grid, then the wearer's body.
namespace secondskin::cli {
namespace {

namespace fs = std::filesystem;
using Clock = std::chrono::steady_clock;
using server::Next;
using server::ProjectorFrame;

constexpr auto kRedraw = std::chrono::milliseconds(500);
// A solve takes seconds: one is begun whenever so much more has been waved.
constexpr double kSolveEvery = 15.0;  // [s]

/// A text that is drawn over itself on a terminal, and left out elsewhere.
class Screen {
 public:
  explicit Screen() : tty_(::isatty(STDOUT_FILENO) != 0) {}
  bool is_tty() const { return tty_; }
  bool due() const { return Clock::now() >= next_; }

  void draw(const std::string& text) {
    next_ = Clock::now() + kRedraw;
    if (!tty_) return;
    if (lines_ > 0) fmt::print("\x1b[{}A\r\x1b[J", lines_);
    fmt::print("{}", text);
    std::fflush(stdout);
    lines_ = std::count(text.begin(), text.end(), '\n');
  }

 private:
  bool tty_;
  Clock::time_point next_{};
  std::ptrdiff_t lines_ = 0;
};

std::string bar(double share, std::size_t width = 16) {
  const auto full = static_cast<std::size_t>(
      std::lround(std::clamp(share, 0.0, 1.0) * static_cast<double>(width)));
  return std::string(full, '#') + std::string(width - full, '.');
}

fs::path default_file(const Library& library, const char* name) {
  return library.own_optical() / name;
}

void make_folder_of(const fs::path& file) {
  if (file.has_parent_path()) fs::create_directories(file.parent_path());
}

/// The places of tags: "optical:A,B" or just "A,B".
std::vector<std::string> places_of(const std::string& source) {
  return server::optical_places(source.starts_with("optical:") ? source : "optical:" + source);
}

struct OpticalOptions {
  std::string source, object;
  std::size_t projectors = 16;
  bool gray = false;
  fs::path out;
  double height = 0.0;
  double seconds = 0.0;
  fs::path check;
};

void add_optical_options(CLI::App& command, OpticalOptions& options) {
  command.add_option("source", options.source, "its tag's port, or a recorded byte file")
      ->required();
  command.add_option("--count", options.projectors, "how many projectors there are")
      ->check(CLI::Range(1, 255))
      ->capture_default_str();
  command.add_flag("--gray", options.gray, "the tag sends the Gray code as it is read");
  command.add_option("--out", options.out,
                     "where to write the calibration (default: the one that 'capture' takes)");
  command.add_option("--seconds", options.seconds,
                     "end after so long (default: when it is enough, or at a key's Ctrl-C)");
}

void say_saved(const server::ProjectorRig& rig, const fs::path& file) {
  const auto calibrated = std::count_if(rig.projectors.begin(), rig.projectors.end(),
                                        [](const auto& p) { return p.has_value(); });
  fmt::print("calibration of {} of {} projectors is in {}\n", calibrated, rig.size(),
             file.string());
}

std::string describe(const server::WandProgress& progress, const server::WandResult* result) {
  std::string out = fmt::format("{} frames; laid down {} times{}\n", progress.frames,
                                progress.lay_downs, progress.still ? ", lying now" : "");
  for (std::size_t p = 0; p < progress.projectors.size(); ++p) {
    out += fmt::format("projector {:>2}  [{}] {:3.0f} % of its field", p,
                       bar(progress.projectors[p].share()), 100.0 * progress.projectors[p].share());
    if (result != nullptr && p < result->projectors.size()) {
      const auto& got = result->projectors[p];
      out += got.refused ? "  not calibrated yet"
                         : fmt::format("  residual {:.2f} counts", got.residual);
    }
    out += '\n';
  }
  return out;
}

void report(const server::WandResult& result) {
  fmt::print("{:>9} {:>10} {:>8} {:>16} {:>6}\n", "projector", "sightings", "fitting",
             "residual [counts]", "field");
  for (std::size_t p = 0; p < result.projectors.size(); ++p) {
    const auto& got = result.projectors[p];
    fmt::print("{:>9} {:>10} {:>6.1f} % {:>16.3f} {:>4.0f} %{}\n", p, got.sightings,
               100.0 * got.fitting, got.residual, 100.0 * got.field_share,
               got.refused ? "  REFUSED: " + got.refused->text : "");
  }
  fmt::print(
      "wand's lengths within {:.2f} mm rms; floor within {:.2f} mm; expected error of a point "
      "{:.2f} mm\n",
      1e3 * result.length_error, 1e3 * result.floor_rms, 1e3 * result.predicted_error);
}

void wand(const OpticalOptions& options) {
  StopOnSignal signals;
  const Library library;
  const auto object = server::Wand::load(library.find_calibration_object(options.object));
  const std::size_t detectors = object.lying_W.size();
  server::OpticalReceiver receiver(places_of(options.source),
                                   {{detectors}, options.projectors, options.gray});
  server::WandSession session(object, options.projectors);
  fmt::print(
      "Wave the wand slowly through the whole volume, in all directions, then lay it on the\n"
      "floor where the origin shall be{}.\n",
      object.on_a_line() ? ", at three places" : "");
  std::fflush(stdout);

  Screen screen;
  std::optional<server::WandResult> latest;
  std::string words;
  std::future<tl::expected<server::WandResult, server::Refusal>> solving;
  const double period = 1e-9 * static_cast<double>(wire::cycle_ns(options.projectors));
  double waved = 0.0, solved_at = 0.0;
  bool enough = false;
  const auto take = [&] {
    auto result = solving.get();
    if (result) {
      latest = *result;
      enough = latest->enough() && session.progress().lay_downs > 0;
      words = enough ? "it is enough" : latest->wishes.empty() ? "" : latest->wishes.front();
    } else {
      words = result.error().text;
    }
  };
  ProjectorFrame frame;
  bool ended = false;
  while (!ended && !enough && !signals.token().stop_requested()) {
    const Next next = receiver.next(frame);
    ended = next == Next::kEnd;
    if (next == Next::kPose) {
      session.add(frame);
      waved += period;
      ended = options.seconds > 0.0 && waved >= options.seconds;
    }
    if (receiver.live()) {
      if (!solving.valid() && waved - solved_at >= kSolveEvery) {
        solved_at = waved;
        solving = std::async(std::launch::async, [copy = session] { return copy.solve(); });
      }
      if (solving.valid() &&
          solving.wait_for(std::chrono::seconds(0)) == std::future_status::ready) {
        take();
      }
    }
    if (screen.due()) {
      std::string text = describe(session.progress(), latest ? &*latest : nullptr);
      if (next == Next::kSilence) words = "nothing comes from the tag";
      if (!words.empty()) text += words + '\n';
      screen.draw(text);
    }
  }
  if (solving.valid()) solving.wait();
  spdlog::info("solving with {} frames", session.progress().frames);
  const auto result = session.solve();
  if (!result) throw std::runtime_error(result.error().text);
  report(*result);
  for (const auto& wish : result->wishes) spdlog::warn("{}", wish);
  const fs::path out = options.out.empty() ? default_file(library, "projectors.txt") : options.out;
  make_folder_of(out);
  result->rig.save(out);
  say_saved(result->rig, out);
}

void grid(const OpticalOptions& options) {
  StopOnSignal signals;
  const Library library;
  const auto object =
      server::CalibrationGrid::load(library.find_calibration_object(options.object));
  // The sources are the heights, in their order: a port stays the same, files are one a height.
  const auto sources = places_of(options.source);
  const bool one_port = sources.size() == 1;
  if (!one_port && sources.size() != object.heights.size()) {
    throw std::runtime_error(
        fmt::format("{} sources for a grid at {} heights: expected one port, or "
                    "a file a height",
                    sources.size(), object.heights.size()));
  }
  server::GridCalibration calibration(object, options.projectors);
  Screen screen;
  for (std::size_t height = 0; height < object.heights.size(); ++height) {
    const std::string& source = sources[one_port ? 0 : height];
    server::OpticalReceiver receiver({source},
                                     {{object.p_W.size()}, options.projectors, options.gray});
    fmt::print("Height {:.3f} m: turn each detector slowly all the way round.{}\n",
               object.heights[height], receiver.live() ? " Enter when done." : "");
    std::fflush(stdout);
    ProjectorFrame frame;
    bool done = false;
    double seen = 0.0;
    const double period = 1e-9 * static_cast<double>(wire::cycle_ns(options.projectors));
    while (!done && !signals.token().stop_requested()) {
      const Next next = receiver.next(frame);
      if (next == Next::kEnd) break;
      if (next == Next::kPose) {
        calibration.add(frame, height);
        seen += period;
      }
      done = receiver.live() && (options.seconds > 0.0 ? seen >= options.seconds : enter_pressed());
      if (screen.due()) {
        std::string text;
        for (std::size_t p = 0; p < options.projectors; ++p) {
          std::size_t have = 0;
          for (std::size_t d = 0; d < object.p_W.size(); ++d) {
            have += calibration.value(d, p, height) ? 1 : 0;
          }
          const double share = static_cast<double>(have) / static_cast<double>(object.p_W.size());
          text += fmt::format("projector {:>2}  [{}] {} of {} detectors\n", p, bar(share), have,
                              object.p_W.size());
        }
        screen.draw(text);
      }
    }
    if (signals.token().stop_requested()) throw std::runtime_error("stopped; nothing was written");
  }
  const auto result = calibration.solve();
  if (!result) throw std::runtime_error(result.error().text);
  fmt::print("{:>9} {:>7} {:>8} {:>18} {:>14}\n", "projector", "points", "fitting",
             "residual [counts]", "residual [mm]");
  for (std::size_t p = 0; p < result->projectors.size(); ++p) {
    const auto& got = result->projectors[p];
    fmt::print("{:>9} {:>7} {:>8} {:>18.3f} {:>14.2f}{}\n", p, got.points, got.fitting,
               got.residual, got.residual_mm, got.refused ? "  REFUSED: " + got.refused->text : "");
  }
  const fs::path out = options.out.empty() ? default_file(library, "projectors.txt") : options.out;
  make_folder_of(out);
  result->rig.save(out);
  say_saved(result->rig, out);
}

struct SkeletonOptions {
  std::string source;
  SourceOptions from;
  double seconds = 20.0;
  fs::path standing;
  fs::path out;
};

void skeleton(const SkeletonOptions& options) {
  StopOnSignal signals;
  const Library library;
  std::optional<server::MarkerSet> set;
  MarkerMotion trial;
  if (options.source.starts_with("optical:")) {
    const auto settings = options.from.settings(library).optical;
    const Suit suit = Suit::load(settings.suit);
    const auto rig = server::ProjectorRig::load(settings.projectors);
    server::OpticalReceiver receiver(server::optical_places(options.source),
                                     server::format_of(suit, rig.size(), settings.gray));
    fmt::print(
        "Stand upright for a moment with the arms hanging, then move every joint through its\n"
        "range, for {:.0f} s.\n",
        options.seconds);
    std::fflush(stdout);
    Screen screen;
    trial = server::record_points(
        receiver, rig, suit, options.seconds, [&](double t, const MarkerFrame& points) {
          if (screen.due()) {
            const auto visible = std::count(points.visible.begin(), points.visible.end(), 1);
            screen.draw(fmt::format("[{}] {:.0f} s, {} of {} detectors seen\n",
                                    bar(t / options.seconds), t, visible, points.visible.size()));
          }
          return !signals.token().stop_requested();
        });
    if (signals.token().stop_requested()) throw std::runtime_error("stopped; nothing was written");
    if (trial.frames.empty()) throw std::runtime_error("no set of bytes came from the tags");
    set = server::MarkerSet::from_suit(suit, canonical_skeleton());
  } else {
    trial = read_markers(options.source, options.from.retarget().up);
    set = server::MarkerSet::choose(library.marker_sets(), trial.names);
  }
  std::optional<MarkerMotion> standing;
  if (!options.standing.empty())
    standing = read_markers(options.standing, options.from.retarget().up);
  const auto result = server::calibrate_body(*set, trial, standing ? &*standing : nullptr);
  fmt::print("{:<20} {:>8} {:>14}\n", "marker", "seen", "residual [mm]");
  for (const auto& marker : result.markers) {
    fmt::print("{:<20} {:>6.0f} % {:>14.1f}{}\n", marker.name, 100.0 * marker.visible,
               1e3 * marker.residual, marker.suspicion.empty() ? "" : "  " + marker.suspicion);
  }
  fmt::print("residual of all {:.1f} mm; zero of the angles from {}\n", 1e3 * result.residual,
             result.stood_upright ? "a moment of upright standing" : "an average body");
  const fs::path out = options.out.empty() ? default_file(library, "body.toml") : options.out;
  make_folder_of(out);
  server::save_body(result.body, out);
  fmt::print("the body is in {}\n", out.string());
}

}  // namespace

void add_calibrate(CLI::App& app) {
  auto* calibrate = app.add_subcommand("calibrate", "measure projectors and wearer");
  calibrate->require_subcommand(1);
  calibrate->footer("Example:  secondskin calibrate optical wand /dev/ttyUSB0");
  auto* optical = calibrate->add_subcommand("optical", "the projectors, with a wand or a grid");
  optical->require_subcommand(1);
  optical->footer("Example:  secondskin calibrate optical wand /dev/ttyUSB0");

  auto wand_options = std::make_shared<OpticalOptions>();
  wand_options->object = "set_square";
  auto* wand_command = optical->add_subcommand("wand", "wave a wand, then lay it down");
  wand_command->footer("Example:  secondskin calibrate optical wand /dev/ttyUSB0");
  add_optical_options(*wand_command, *wand_options);
  wand_command->add_option("--wand", wand_options->object, "which one: name or .toml file")
      ->capture_default_str();
  wand_command->callback([wand_options] { wand(*wand_options); });

  auto grid_options = std::make_shared<OpticalOptions>();
  grid_options->object = "grid_4ft";
  auto* grid_command =
      optical->add_subcommand("grid", "the grid of known points, at each of its heights");
  grid_command->footer(
      "Example:  secondskin calibrate optical grid /dev/ttyUSB0\n"
      "          secondskin calibrate optical grid low0.tag,raised0.tag");
  add_optical_options(*grid_command, *grid_options);
  grid_command->add_option("--grid", grid_options->object, "which one: name or .toml file")
      ->capture_default_str();
  grid_command->callback([grid_options] { grid(*grid_options); });

  auto skeleton_options = std::make_shared<SkeletonOptions>();
  auto* skeleton_command =
      calibrate->add_subcommand("skeleton", "the wearer's body and where the markers sit on it");
  skeleton_command->footer(
      "Example:  secondskin calibrate skeleton optical:/dev/ttyUSB0,/dev/ttyUSB1\n"
      "          secondskin calibrate skeleton trial.c3d --standing static.c3d --out body.toml");
  skeleton_command
      ->add_option("source", skeleton_options->source, "optical:PORT,PORT... or a marker file")
      ->required();
  skeleton_command->add_option("--seconds", skeleton_options->seconds, "how long to look at ports")
      ->check(CLI::Range(2.0, 600.0))
      ->capture_default_str();
  skeleton_command->add_option("--standing", skeleton_options->standing,
                               "a marker file of the same markers, standing upright");
  skeleton_command->add_option("--out", skeleton_options->out,
                               "where to write it (default: the one that 'capture' takes)");
  add_source_options(*skeleton_command, skeleton_options->from);
  skeleton_command->callback([skeleton_options] { skeleton(*skeleton_options); });
}

}  // namespace secondskin::cli
