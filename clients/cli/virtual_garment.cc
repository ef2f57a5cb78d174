#include "sim/wearable/virtual_garment.h"

#include <fmt/format.h>
#include <unistd.h>

#include <charconv>
#include <chrono>
#include <cmath>

#include "clients/cli/common.h"
#include "motion/bvh.h"
#include "sim/wearable/worn_garment.h"
#include "wire/pseudo_terminal.h"
#include "wire/tcp_listener.h"

/// `virtual-garment`: a wearable capture garment of software, into a file or live.
namespace secondskin::cli {
namespace {

namespace fs = std::filesystem;

constexpr double kDegree = std::numbers::pi / 180.0;

struct GarmentOptions {
  std::string motion;
  SourceOptions from;
  std::string garment = "practical";
  fs::path file, truth;
  std::string port;
  int tcp = -1;
  double seconds = 0.0, rest = 3.0;
  std::uint64_t seed = 1;
  bool perfect = false;
  sim::WornErrors errors;
  sim::SignalOptions signal;
  bool dry = false;
  std::vector<std::string> silent, blocked, bit_errors, overdriven, swapped;
};

/// "NAME", "NAME:FROM" or "NAME:FROM:TO" with a board's or source's name and seconds.
template <typename Parts>
sim::Outage outage(const std::string& text, const Parts& parts, const char* option) {
  const auto fail = [&] {
    std::string names;
    for (const auto& part : parts) names += (names.empty() ? "" : ", ") + part.name;
    throw std::runtime_error(
        fmt::format("{} {}: expected NAME, NAME:FROM or NAME:FROM:TO in seconds, NAME one of {}",
                    option, text, names));
  };
  sim::Outage outage;
  const std::size_t colon = text.find(':');
  const std::string name = text.substr(0, colon);
  while (outage.which < parts.size() && parts[outage.which].name != name) ++outage.which;
  if (outage.which == parts.size()) fail();
  const char *at = text.data() + std::min(colon, text.size()), *end = text.data() + text.size();
  for (double* value : {&outage.from, &outage.to}) {
    if (at == end) break;
    const auto [rest, error] = std::from_chars(at + 1, end, *value);
    if (error != std::errc() || !(*value >= 0.0)) fail();
    at = rest;
    if (at != end && *at != ':') fail();
  }
  if (at != end) fail();
  return outage;
}

sim::GarmentFaults faults(const GarmentOptions& options, const Garment& garment) {
  sim::GarmentFaults out = options.signal.faults;
  const auto all = [&](const auto& texts, const auto& parts, const char* option, auto& outages) {
    for (const auto& text : texts) outages.push_back(outage(text, parts, option));
  };
  all(options.silent, garment.boards, "--silent", out.silent);
  all(options.blocked, garment.sources, "--blocked", out.blocked);
  all(options.bit_errors, garment.boards, "--bit-errors", out.bit_errors);
  all(options.overdriven, garment.boards, "--overdriven", out.gain);
  for (const auto& text : options.swapped) {
    const std::size_t comma = text.find(',');
    const auto board = [&](const std::string& name) {
      return outage(name, garment.boards, "--swapped").which;
    };
    if (comma == std::string::npos) {
      throw std::runtime_error(fmt::format("--swapped {}: expected two boards, A,B", text));
    }
    out.swapped.emplace_back(board(text.substr(0, comma)), board(text.substr(comma + 1)));
  }
  return out;
}

void write_truth(const sim::WornGarment& worn, double seconds, const fs::path& file) {
  constexpr double kRate = 120.0;
  Motion truth{worn.skeleton(), kRate, {}};
  for (double k = 0.0; k / kRate <= seconds; k += 1.0) {
    worn.pose_at(k / kRate, truth.poses.emplace_back());
  }
  write_bvh(truth, file);
}

/// A line on a terminal that says how far it is.
sim::SlotProgress progress_of(double slot, double seconds) {
  if (::isatty(STDERR_FILENO) == 0) return {};
  return [slot, seconds, next = 0.0](std::uint32_t slots) mutable {
    const double time = slots * slot;
    if (time < next && time + slot < seconds) return;
    next = time + 0.5;
    fmt::print(stderr, "\r{:.1f} of {:.1f} s", time, seconds);
    if (time + slot >= seconds) fmt::print(stderr, "\r\x1b[K");
  };
}

std::int64_t unix_now_ns() {
  return std::chrono::duration_cast<std::chrono::nanoseconds>(
             std::chrono::system_clock::now().time_since_epoch())
      .count();
}

void serve(sim::GarmentSignal& signal, std::uint32_t slots, const GarmentOptions& options,
           std::stop_token stop, const sim::SlotProgress& progress) {
  sim::LinkCounters counters;
  if (!options.port.empty()) {
    wire::PseudoTerminal terminal(options.port);
    fmt::print("garment {}\n", terminal.path());
    std::fflush(stdout);
    counters = sim::serve_garment(
        signal, slots, terminal, [] { return 1U; }, stop, progress);
  } else {
    wire::TcpListener listener(static_cast<std::uint16_t>(options.tcp));
    fmt::print("garment 127.0.0.1:{}\n", listener.port());
    std::fflush(stdout);
    const auto poll = [&] { return listener.poll() ? listener.openings() : 0; };
    counters = sim::serve_garment(signal, slots, listener, poll, stop, progress);
  }
  fmt::print("virtual garment: {} slots, {} bytes written, {} slots nobody read\n", counters.slots,
             counters.bytes, counters.dropped);
}

void virtual_garment(GarmentOptions options) {
  StopOnSignal signals;
  const Library library;
  if (int{!options.file.empty()} + int{!options.port.empty()} + int{options.tcp >= 0} != 1) {
    throw std::runtime_error("expected one of --out FILE, --port PATH and --tcp PORT");
  }
  const Garment garment = Garment::load(library.find_garment(options.garment));
  options.signal.faults = faults(options, garment);
  const auto source = options.from.open(options.motion, library);
  const sim::WornGarment worn(server::read_all(*source), garment,
                              options.perfect ? sim::WornErrors::none() : options.errors,
                              options.seed, options.rest);
  const double seconds = options.seconds > 0.0 ? options.seconds : worn.duration();
  if (!options.truth.empty()) write_truth(worn, seconds, options.truth);
  if (options.dry) options.signal.echoes = false;
  if (options.file.empty()) options.signal.start_ns = unix_now_ns();
  sim::GarmentSignal signal(worn, options.seed, options.signal);
  const double slot = garment.slot();
  const auto slots = static_cast<std::uint32_t>(seconds / slot);
  const auto progress = progress_of(slot, seconds);
  if (options.file.empty()) return serve(signal, slots, options, signals.token(), progress);
  const auto done = sim::write_garment_file(signal, slots, options.file, signals.token(), progress);
  fmt::print("{:.1f} s of {} in {} are in {}\n", done * slot, options.motion, garment.name,
             options.file.string());
}

}  // namespace

void add_virtual_garment(CLI::App& app) {
  auto options = std::make_shared<GarmentOptions>();
  auto* command = app.add_subcommand(
      "virtual-garment", "an ultrasound and inertia garment of software, where none is worn");
  command->footer(
      "Example:  secondskin virtual-garment learner.bvh --out squat.garment --truth true.bvh\n"
      "          secondskin virtual-garment learner.bvh --tcp 7000\n"
      "          secondskin virtual-garment walk.bvh --out f.garment --silent left_foot:10:20 "
      "--blocked hat:5:65\n"
      "A fault without times lasts from the beginning to the end.");
  auto& o = *options;
  command->add_option("motion", o.motion, std::string("what the wearer does: ") + kSourceHelp)
      ->required();
  command->add_option("--garment", o.garment, "a garment's name or file")->capture_default_str();
  command->add_option("--out", o.file, "write a .garment file, as fast as it goes");
  command->add_option("--port", o.port, "serve a pseudo-terminal under this name, in real time");
  command->add_option("--tcp", o.tcp, "serve 127.0.0.1:PORT, in real time; 0: any free port")
      ->check(CLI::Range(0, 65535));
  command->add_option("--truth", o.truth, "write the true motion here (.bvh)");
  command->add_option("--seconds", o.seconds, "for so long (default: rest pose and motion)");
  command->add_option("--rest", o.rest, "seconds in the rest pose before the motion")
      ->check(CLI::Range(0.0, 600.0))
      ->capture_default_str();
  command->add_option("--seed", o.seed, "of all chance")->capture_default_str();
  command->add_flag("--perfect", o.perfect, "sensors and body without errors");
  const auto angle = [&](const char* name, double& radians, const char* help) {
    command
        ->add_option_function<double>(
            name, [&radians](double degrees) { radians = degrees * kDegree; }, help)
        ->check(CLI::Range(0.0, 90.0))
        ->default_str(fmt::format("{:.3g}", radians / kDegree));
  };
  const auto millimetres = [&](const char* name, double& metres, const char* help) {
    command
        ->add_option_function<double>(
            name, [&metres](double mm) { metres = mm * 1e-3; }, help)
        ->check(CLI::Range(0.0, 500.0))
        ->default_str(fmt::format("{:.3g}", metres * 1e3));
  };
  angle("--mounting-deg", o.errors.mounting_angle, "how far boards are turned, RMS");
  millimetres("--mounting-mm", o.errors.mounting_place, "how far boards are displaced, RMS");
  angle("--tissue-deg", o.errors.tissue_angle, "how far soft tissue turns boards, RMS");
  millimetres("--tissue-mm", o.errors.tissue_place, "how far soft tissue moves boards, RMS");
  angle("--gyro-bias-deg", o.errors.gyro_bias, "of the gyroscopes, degrees a second, RMS");
  command->add_option("--noise", o.signal.noise, "of the wires [counts of the 16-bit converter]")
      ->check(CLI::Range(0.0, 5000.0))
      ->capture_default_str();
  command->add_option("--digital", o.signal.digital, "level of the digital stream [counts]")
      ->check(CLI::Range(0.0, 20000.0))
      ->capture_default_str();
  command->add_option("--tones", o.signal.tones_hz, "foreign ultrasonic bursts a second")
      ->check(CLI::Range(0.0, 100.0))
      ->capture_default_str();
  command->add_flag("--no-echoes", o.dry, "neither floor nor walls nor limbs reflect");
  command->add_option("--temperature", o.signal.temperature, "as the box measures it [deg C]")
      ->check(CLI::Range(-40.0, 60.0))
      ->capture_default_str();
  command
      ->add_option("--temperature-error", o.signal.faults.temperature_error,
                   "true temperature less the measured one [K]")
      ->check(CLI::Range(-50.0, 50.0));
  command->add_option("--silent", o.silent, "BOARD:FROM:TO whose wire carries nothing");
  command->add_option("--blocked", o.blocked, "SOURCE:FROM:TO with a hand before it");
  command->add_option("--bit-errors", o.bit_errors, "BOARD:FROM:TO with noise in its digital band");
  command->add_option("--overdriven", o.overdriven, "BOARD:FROM:TO whose amplifier saturates");
  command->add_option("--swapped", o.swapped, "A,B: boards plugged into each other's channel");
  add_motion_options(*command, o.from);
  command->callback([options] { virtual_garment(*options); });
}

}  // namespace secondskin::cli
