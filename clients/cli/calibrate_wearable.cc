#include <fmt/format.h>
#include <spdlog/spdlog.h>
#include <unistd.h>

#include <functional>
#include <numbers>

#include "clients/cli/common.h"
#include "server/wearable/calibrate/inertial_calibration.h"
#include "server/wearable/calibrate/source_offsets.h"
#include "server/wearable/signal/board_signals.h"
#include "server/wearable/signal/slot_source.h"
#include "sim/wearable/calibration_scenes.h"
#include "sim/wearable/garment_signal.h"

/// Measuring a garment (Practical Motion Capture, 4.3): its ultrasonic sources, accelerometers and
/// gyroscopes.
namespace secondskin::cli {
namespace {

namespace fs = std::filesystem;
using server::Next;

constexpr double kRpm = 2.0 * std::numbers::pi / 60.0;
constexpr const char* kVirtual = "virtual";
constexpr std::size_t kVirtualPlacements = 5;
constexpr std::size_t kLookEvery = 125;    // slots: a second
constexpr double kOtherTemperature = 5.0;  // [K]

struct Options {
  std::vector<std::string> sources;
  std::string garment = "practical";
  fs::path out, distances;
  std::optional<double> temperature;
  double seconds = 0.0;
  double rpm = 45.0;
  bool six = false, still = false;
  std::uint64_t seed = 1;

  bool is_virtual() const { return sources.size() == 1 && sources[0] == kVirtual; }
};

/// Slots of one source of any kind, with what their boards' signals say.
class Signals {
 public:
  explicit Signals(const Garment& garment) : garment_(garment), signals_(garment) {}

  /// Goes on until the source ends, `look` returns false, or so many seconds of it are over.
  /// @returns false when a stop was asked for
  bool run(server::SlotSource& source, double seconds, std::stop_token stop,
           const std::function<bool(const wire::GarmentSlot&, const server::BoardSignals&)>& look) {
    double passed = 0.0;
    bool told = false;
    while (!stop.stop_requested()) {
      const wire::GarmentSlot* slot = nullptr;
      const Next next = source.next(slot);
      if (next == Next::kEnd) return true;
      if (next == Next::kSilence) {
        if (!told) {
          spdlog::warn("nothing comes from {} {}", source.place(), source.trouble());
        }
        told = true;
        continue;
      }
      server::check_stream(*source.header(), garment_, source.place());
      temperature = source.header()->temperature;
      signals_.process(*slot);
      if (!look(*slot, signals_)) return true;
      passed += garment_.slot();
      if (seconds > 0.0 && passed >= seconds) return true;
    }
    return false;
  }

  void run(const sim::GarmentScene& scene, std::uint64_t seed, std::stop_token stop,
           const std::function<bool(const wire::GarmentSlot&, const server::BoardSignals&)>& look) {
    sim::GarmentSignal signal(scene, seed);
    wire::GarmentSlot slot;
    slot.samples.resize(garment_.boards.size() * garment_.slot_samples);
    for (std::uint32_t k = 0; k < signal.slots() && !stop.stop_requested(); ++k) {
      signal.next(slot.samples);
      slot.sequence = k;
      slot.source = k % garment_.sources.size();
      signals_.process(slot);
      if (!look(slot, signals_)) return;
    }
  }

  std::optional<double> temperature;  ///< as the newest header says [deg C]

 private:
  const Garment& garment_;
  server::BoardSignals signals_;
};

void say(const std::string& line) {
  fmt::print("{}\n", line);
  std::fflush(stdout);
}

fs::path out_file(const Options& options, const Library& library, const Garment& garment) {
  return options.out.empty() ? library.own_wearable() / (garment.name + ".toml") : options.out;
}

// What is known already: the file that is to be written, if it is there.
server::WearableCalibration known(const fs::path& file, const Garment& garment) {
  return fs::exists(file) ? server::WearableCalibration::load(file, garment)
                          : server::WearableCalibration::nominal(garment);
}

void save(const server::WearableCalibration& calibration, const fs::path& file,
          const Garment& garment) {
  if (file.has_parent_path()) fs::create_directories(file.parent_path());
  calibration.save(file, garment);
  say(fmt::format("the calibration is in {}", file.string()));
}

[[noreturn]] void stopped() { throw std::runtime_error("stopped; nothing was written"); }

// Records every placement.
std::vector<server::PlacementArrivals> record_placements(const Options& options,
                                                         const Garment& garment, std::size_t count,
                                                         double& temperature) {
  StopOnSignal signals;
  std::vector<server::PlacementArrivals> placements;
  const bool files = options.sources.size() > 1 || fs::is_regular_file(options.sources[0]);
  if (files && options.sources.size() != count) {
    throw std::runtime_error(
        fmt::format("{} recordings of {} placements: expected a recording a placement, or one port",
                    options.sources.size(), count));
  }
  std::optional<server::SlotSource> port;
  for (std::size_t p = 0; p < count; ++p) {
    server::PlacementArrivals placement(garment.sources.size(), garment.boards.size());
    const auto look = [&](const wire::GarmentSlot& slot, const server::BoardSignals& boards) {
      if (slot.source) placement.add(*slot.source, boards.arrivals());
      return true;
    };
    Signals boards(garment);
    if (files) {
      server::SlotSource source(options.sources[p]);
      if (!boards.run(source, options.seconds, signals.token(), look)) stopped();
    } else {
      if (!port) port.emplace(options.sources[0]);
      if (::isatty(STDIN_FILENO) != 0) {
        say(fmt::format("Placement {}: Enter when sources and boards stand.", p));
        Signals waiting(garment);
        if (!waiting.run(*port, 0.0, signals.token(),
                         [](const auto&, const auto&) { return !enter_pressed(); })) {
          stopped();
        }
      }
      const double seconds = options.seconds > 0.0 ? options.seconds : 3.0;
      if (!boards.run(*port, seconds, signals.token(), look)) stopped();
    }
    if (boards.temperature) temperature = *boards.temperature;
    placements.push_back(std::move(placement));
  }
  return placements;
}

void calibrate_sources(const Options& options) {
  const Library library;
  const Garment garment = Garment::load(library.find_garment(options.garment));
  const fs::path file = out_file(options, library, garment);
  auto calibration = known(file, garment);
  std::vector<server::KnownSourceDistance> distances;
  std::vector<server::PlacementArrivals> placements;
  double temperature = 20.0;
  if (options.is_virtual()) {
    StopOnSignal signals;
    for (std::size_t p = 0; p < kVirtualPlacements; ++p) {
      const sim::StandScene scene(garment, sim::WornErrors{}, p);
      placements.emplace_back(garment.sources.size(), garment.boards.size());
      Signals(garment).run(scene, options.seed, signals.token(),
                           [&](const auto& slot, const auto& boards) {
                             placements.back().add(*slot.source, boards.arrivals());
                             return true;
                           });
      for (std::size_t s = 0; s < garment.sources.size(); ++s) {
        for (std::size_t b = 0; b < garment.boards.size(); ++b) {
          distances.push_back({p, s, b, scene.distance(s, b)});
        }
      }
    }
    if (signals.token().stop_requested()) stopped();
  } else {
    if (options.distances.empty()) {
      throw std::runtime_error("--distances is missing: a file placement,source,board,distance_m");
    }
    distances = server::read_source_distances(options.distances, garment);
    std::size_t count = 0;
    for (const auto& entry : distances) count = std::max(count, entry.placement + 1);
    placements = record_placements(options, garment, count, temperature);
  }
  temperature = options.temperature.value_or(temperature);
  const auto result = server::solve_source_offsets(garment, placements, distances, temperature);
  if (!result) throw std::runtime_error(result.error().text);
  fmt::print("{:<20} {:>10} {:>17} {:>22}\n", "source", "distances", "offset [samples]",
             "strength [counts m]");
  for (std::size_t s = 0; s < garment.sources.size(); ++s) {
    const auto& got = result->sources[s];
    fmt::print("{:<20} {:>10} {:>17.2f} {:>22.0f}\n", garment.sources[s].name, got.distances,
               got.calibration.offset, std::sqrt(got.calibration.strength));
    calibration.sources[s] = got.calibration;
  }
  fmt::print(
      "leave-one-out error {:.2f} +- {:.2f} mm; by the distances the air has {:.1f} +- "
      "{:.1f} deg C\n",
      1e3 * result->left_out_mean, 1e3 * result->left_out_sd, result->implied_temperature,
      result->implied_sigma);
  if (result->unheard > 0) {
    spdlog::warn("over {} of {} distances nothing was heard", result->unheard, distances.size());
  }
  if (std::abs(result->implied_temperature - temperature) >
      kOtherTemperature + 2.0 * result->implied_sigma) {
    spdlog::warn("the air was said to have {:.1f} deg C: measure temperature and distances again",
                 temperature);
  }
  calibration.temperature = temperature;
  save(calibration, file, garment);
}

using Fit = std::function<tl::expected<server::AxesFit, server::WearableRefusal>(
    std::span<const server::SteadyPart>, const server::BoardCalibration&)>;

// Collects steady parts until the sources end, all boards are done, or Enter is pressed.
// @returns what came out of each board
std::vector<tl::expected<server::AxesFit, server::WearableRefusal>> fit_boards(
    const Options& options, const Garment& garment, const Fit& fit,
    const sim::GarmentScene& virtual_scene) {
  StopOnSignal signals;
  const auto nominal = server::WearableCalibration::nominal(garment);
  std::vector<server::SteadyParts> steady(garment.boards.size());
  std::size_t slots = 0;
  bool live = false;
  const auto fit_all = [&] {
    std::vector<tl::expected<server::AxesFit, server::WearableRefusal>> fits;
    for (std::size_t b = 0; b < steady.size(); ++b) {
      const auto parts = steady[b].parts();
      fits.push_back(steady[b].samples() == 0
                         ? tl::unexpected(server::WearableRefusal{"nothing was received"})
                         : fit(parts, nominal.boards[b]));
    }
    return fits;
  };
  const auto look = [&](const wire::GarmentSlot&, const server::BoardSignals& boards) {
    for (std::size_t b = 0; b < steady.size(); ++b) {
      for (const auto& sample : boards.inertial(b)) steady[b].add(sample.code);
    }
    if (!live || ++slots % kLookEvery != 0) return true;
    if (enter_pressed()) return false;
    const auto fits = fit_all();
    const auto done = std::count_if(fits.begin(), fits.end(), [](const auto& f) { return !!f; });
    if (::isatty(STDOUT_FILENO) != 0) {
      const auto first = std::find_if(fits.begin(), fits.end(), [](const auto& f) { return !f; });
      fmt::print(
          "\r\x1b[K{} of {} boards are done{}", done, fits.size(),
          first == fits.end()
              ? std::string()
              : fmt::format("; {}: {}",
                            garment.boards[static_cast<std::size_t>(first - fits.begin())].name,
                            first->error().text));
      std::fflush(stdout);
    }
    return done < static_cast<std::ptrdiff_t>(fits.size());
  };
  if (options.is_virtual()) {
    Signals(garment).run(virtual_scene, options.seed, signals.token(), look);
  } else {
    for (const auto& place : options.sources) {
      server::SlotSource source(place);
      live = source.live();
      if (live) say("Enter ends it; it ends by itself when every board is done.");
      if (!Signals(garment).run(source, options.seconds, signals.token(), look)) stopped();
      if (live && ::isatty(STDOUT_FILENO) != 0) fmt::print("\n");
    }
  }
  if (signals.token().stop_requested()) stopped();
  return fit_all();
}

// Prints every board, and keeps what came out.
void take_fits(const Options& options, const Garment& garment, const char* unit,
               const std::vector<tl::expected<server::AxesFit, server::WearableRefusal>>& fits,
               const Eigen::Vector3d server::BoardCalibration::*slope_of,
               const std::function<void(server::BoardCalibration&, const server::AxesFit&)>& keep,
               const Library& library) {
  const fs::path file = out_file(options, library, garment);
  auto calibration = known(file, garment);
  const auto nominal = server::WearableCalibration::nominal(garment);
  fmt::print("{:<18} {:>6} {:>26} {:>29} {:>18}\n", "board", "parts", "zero x, y, z [codes]",
             "slope, of the nominal", fmt::format("residual [{}]", unit));
  std::size_t refused = 0;
  std::string first_refusal;
  for (std::size_t b = 0; b < fits.size(); ++b) {
    if (!fits[b]) {
      fmt::print("{:<18} REFUSED: {}\n", garment.boards[b].name, fits[b].error().text);
      if (refused++ == 0) {
        first_refusal = fmt::format("{}: {}", garment.boards[b].name, fits[b].error().text);
      }
      continue;
    }
    const auto& fit = *fits[b];
    const Eigen::Vector3d share = fit.slope.cwiseQuotient(nominal.boards[b].*slope_of);
    fmt::print("{:<18} {:>6} {:>8.3f} {:>8.3f} {:>8.3f} {:>9.4f} {:>9.4f} {:>9.4f} {:>18.4f}\n",
               garment.boards[b].name, fit.parts, fit.zero.x(), fit.zero.y(), fit.zero.z(),
               share.x(), share.y(), share.z(), fit.residual);
    keep(calibration.boards[b], fit);
  }
  if (refused == fits.size()) throw std::runtime_error(first_refusal);
  if (refused > 0) spdlog::warn("{} boards keep what they had", refused);
  save(calibration, file, garment);
}

void calibrate_accelerometers(const Options& options) {
  const Library library;
  const Garment garment = Garment::load(library.find_garment(options.garment));
  const sim::BenchScene scene(garment, sim::WornErrors{},
                              options.six ? sim::six_sides() : sim::still_poses(12, options.seed),
                              0.005, options.seed);
  const Fit fit =
      options.six ? Fit(server::accelerometer_by_axes) : Fit(server::accelerometer_by_poses);
  const auto fits = fit_boards(options, garment, fit, scene);
  take_fits(
      options, garment, "m/s^2", fits, &server::BoardCalibration::accel_slope,
      [](auto& board, const auto& got) {
        board.accel_zero = got.zero;
        board.accel_slope = got.slope;
      },
      library);
}

void calibrate_gyroscopes(const Options& options) {
  const Library library;
  const Garment garment = Garment::load(library.find_garment(options.garment));
  const double rate = options.rpm * kRpm;
  const sim::BenchScene scene(
      garment, sim::WornErrors{},
      options.still ? sim::still_poses(2, options.seed, 10.0) : sim::six_turns(rate), 0.005,
      options.seed);
  const Fit fit = options.still ? Fit(server::gyroscope_still)
                                : Fit([rate](std::span<const server::SteadyPart> parts,
                                             const server::BoardCalibration& nominal) {
                                    return server::gyroscope_by_turntable(parts, nominal, rate);
                                  });
  const auto fits = fit_boards(options, garment, fit, scene);
  take_fits(
      options, garment, "rad/s", fits, &server::BoardCalibration::gyro_slope,
      [still = options.still](auto& board, const auto& got) {
        board.gyro_zero = got.zero;
        if (!still) board.gyro_slope = got.slope;
      },
      library);
}

void add_options(CLI::App& command, Options& options, const char* sources) {
  command.add_option("source", options.sources, sources)->required();
  command.add_option("--garment", options.garment, "which one: name or .toml file")
      ->capture_default_str();
  command.add_option("--out", options.out,
                     "the calibration to write, or to add to (default: the garment's own)");
  command
      .add_option("--seconds", options.seconds,
                  "use so much of each recording (default: all; of a port's placement 3 s)")
      ->check(CLI::Range(0.0, 3600.0));
  command.add_option("--seed", options.seed, "of the virtual garment")->capture_default_str();
}

}  // namespace

void add_calibrate_wearable(CLI::App& app) {
  auto* wearable = app.get_subcommand("calibrate")
                       ->add_subcommand("wearable", "a garment's sources and sensor boards");
  wearable->require_subcommand(1);
  wearable->footer(
      "Example:  secondskin calibrate wearable accelerometers /dev/ttyACM0\n"
      "A source is a recorded .garment file, a port, 127.0.0.1:PORT, or 'virtual'.");
  constexpr const char* kSources = ".garment files, a port, 127.0.0.1:PORT, or 'virtual'";

  auto of_sources = std::make_shared<Options>();
  auto* sources = wearable->add_subcommand(
      "sources", "offsets of the ultrasonic sources, from known distances of 30 to 90 cm");
  add_options(*sources, *of_sources, ".garment files, one a placement; a port; or 'virtual'");
  sources->add_option("--distances", of_sources->distances,
                      "a .csv file: placement,source,board,distance_m; placements from 0");
  sources
      ->add_option("--temperature", of_sources->temperature,
                   "of the air [deg C] (default: as the driver box says)")
      ->check(CLI::Range(-40.0, 60.0));
  sources->footer(
      "Examples:  secondskin calibrate wearable sources first.garment second.garment --distances "
      "table.csv\n"
      "           secondskin calibrate wearable sources virtual --out practical.toml");
  sources->callback([of_sources] { calibrate_sources(*of_sources); });

  auto of_accelerometers = std::make_shared<Options>();
  auto* accelerometers = wearable->add_subcommand(
      "accelerometers", "zero and slope of each axis, from nine or more still poses");
  add_options(*accelerometers, *of_accelerometers, kSources);
  accelerometers->add_flag("--six", of_accelerometers->six,
                           "each axis up and down by a level instead: the paper's way");
  accelerometers->footer(
      "Lay every board down in nine poses or more, 3 s each, all sides down once.\n"
      "Example:  secondskin calibrate wearable accelerometers poses.garment");
  accelerometers->callback([of_accelerometers] { calibrate_accelerometers(*of_accelerometers); });

  auto of_gyroscopes = std::make_shared<Options>();
  auto* gyroscopes = wearable->add_subcommand(
      "gyroscopes", "zero and slope of each axis on a turntable, or the zero while lying still");
  add_options(*gyroscopes, *of_gyroscopes, kSources);
  gyroscopes->add_option("--rpm", of_gyroscopes->rpm, "of the turntable")
      ->check(CLI::Range(5.0, 200.0))
      ->capture_default_str();
  gyroscopes->add_flag("--still", of_gyroscopes->still, "the zero only, with no turntable");
  gyroscopes->footer(
      "Turn each board 3 s with each axis up and down.\n"
      "Examples:  secondskin calibrate wearable gyroscopes turntable.garment --rpm 45\n"
      "           secondskin calibrate wearable gyroscopes /dev/ttyACM0 --still");
  gyroscopes->callback([of_gyroscopes] { calibrate_gyroscopes(*of_gyroscopes); });
}

}  // namespace secondskin::cli
