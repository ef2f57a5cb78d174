// From the raw signals of a garment to measurements: how far are the distances from the truth, by
// distance, occlusion and noise; how many samples and chips of the inertial stream are lost or
// wrong, by its amplitude; what calibration leaves; what the 6-bit code adds; and what all of it
// costs. Signals are of sim/wearable. docs/wearable-signals.md quotes the output.

#include <fmt/core.h>
#include <time.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cmath>
#include <filesystem>
#include <functional>
#include <nlohmann/json.hpp>
#include <numbers>
#include <random>
#include <string>
#include <vector>

#include "motion/retarget.h"
#include "server/wearable/calibrate/source_offsets.h"
#include "server/wearable/signal/garment_measurements.h"
#include "sim/wearable/acoustics.h"
#include "sim/wearable/calibration_scenes.h"
#include "sim/wearable/garment_signal.h"
#include "sim/wearable/worn_garment.h"

namespace {

using namespace secondskin;
using namespace secondskin::server;
namespace fs = std::filesystem;

constexpr std::uint64_t kSeed = 5;
constexpr double kGood = 0.5;    // confidence from which a distance counts as measured
constexpr double kWrong = 0.05;  // a distance so far off is wrong, not inaccurate [m]

// Processor time of this thread [s]: what other processes do does not count.
double cpu_time() {
  timespec t{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
  return static_cast<double>(t.tv_sec) + 1e-9 * static_cast<double>(t.tv_nsec);
}

// Gives `look` every slot of a scene's signal.
void for_each_slot(sim::GarmentSignal& signal, const Garment& garment, std::uint32_t slots,
                   const std::function<void(const wire::GarmentSlot&)>& look) {
  wire::GarmentSlot slot;
  slot.samples.resize(garment.boards.size() * garment.slot_samples);
  const auto header = signal.header();
  for (std::uint32_t k = 0; k < std::min(slots, signal.slots()); ++k) {
    signal.next(slot.samples);
    slot.sequence = k;
    slot.source = k % garment.sources.size();
    slot.stamp_ns = header.stamp_ns(k);
    look(slot);
  }
}

// Source offsets as a user would measure them: placements on stands, distances by a ruler.
SourceOffsets calibrate(const Garment& garment, double ruler, double noise) {
  std::vector<PlacementArrivals> placements;
  std::vector<KnownSourceDistance> known;
  std::mt19937_64 random(kSeed);
  std::normal_distribution<double> error(0.0, ruler);
  for (std::size_t p = 0; p < 5; ++p) {
    const sim::StandScene scene(garment, sim::WornErrors::none(), p, 1.0);
    sim::SignalOptions options;
    options.noise = noise;
    sim::GarmentSignal signal(scene, kSeed, options);
    BoardSignals signals(garment);
    placements.emplace_back(garment.sources.size(), garment.boards.size());
    for_each_slot(signal, garment, ~0U, [&](const wire::GarmentSlot& slot) {
      signals.process(slot);
      placements.back().add(*slot.source, signals.arrivals());
    });
    for (std::size_t s = 0; s < garment.sources.size(); ++s) {
      for (std::size_t b = 0; b < garment.boards.size(); ++b) {
        known.push_back({p, s, b, scene.distance(s, b) + error(random)});
      }
    }
  }
  const auto offsets = solve_source_offsets(garment, placements, known, 20.0);
  if (!offsets) throw std::runtime_error(offsets.error().text);
  return *offsets;
}

struct Distances {
  std::size_t slots = 0, good = 0, wrong = 0;
  double sum = 0.0, square = 0.0;
  void add(const DistanceReading& reading, double truth) {
    ++slots;
    if (!(reading.confidence >= kGood)) return;
    ++good;
    const double error = reading.distance - truth;
    if (std::abs(error) > kWrong) {
      ++wrong;
      return;
    }
    sum += error;
    square += error * error;
  }
  nlohmann::json json(const std::string& name) const {
    const auto n = static_cast<double>(good - wrong);
    const double mean = n > 0 ? sum / n : NAN;
    return {{"pairs", name},
            {"pulses", slots},
            {"measured",
             static_cast<double>(good) / static_cast<double>(std::max<std::size_t>(slots, 1))},
            {"mean_mm", 1e3 * mean},
            {"sd_mm", n > 1 ? 1e3 * std::sqrt(std::max(0.0, square / n - mean * mean)) : NAN},
            {"wrong", good > 0 ? static_cast<double>(wrong) / static_cast<double>(good) : NAN}};
  }
};

struct Worn {
  std::vector<Distances> by_distance = std::vector<Distances>(5);  // steps of 0.3 m
  std::vector<Distances> by_shadow = std::vector<Distances>(3);
  Distances all_visible;
  std::uint64_t inertial = 0, lost = 0;
};

// A body that moves, distances against where source and microphone truly were.
void wear(const sim::WornGarment& scene, const WearableCalibration& calibration, double noise,
          double seconds, Worn& worn) {
  const Garment& garment = scene.garment();
  sim::SignalOptions options;
  options.noise = noise;
  sim::GarmentSignal signal(scene, kSeed, options);
  GarmentMeasurements measurements(garment, calibration);
  Measurement measurement;
  sim::GarmentInstant instant;
  std::vector<sim::Shadow> shadows(garment.boards.size());
  const double c = speed_of_sound(options.temperature);
  for_each_slot(
      signal, garment, static_cast<std::uint32_t>(seconds / garment.slot()),
      [&](const wire::GarmentSlot& slot) {
        measurements.add(slot, options.temperature);
        while (measurements.next(measurement)) {
          if (measurement.kind != MeasurementKind::kDistances) continue;
          const std::size_t s = measurement.source;
          const double late = signal.transducers()[s].start_samples / garment.sample_rate_hz;
          scene.at(static_cast<double>(slot.sequence) * garment.slot() + late, instant);
          sim::shadows(instant, s, c / garment.carrier_hz, shadows);
          for (std::size_t b = 0; b < garment.boards.size(); ++b) {
            const auto& board = instant.boards[b];
            const Eigen::Vector3d way = board.X_WS.translation() - instant.sources[s].translation();
            const double truth = (way + way.norm() / c * board.v).norm();
            const double facing = instant.sources[s].linear().col(2).dot(way.normalized());
            // w_a, which the filter adds, leaves out what is behind the source.
            if (facing <= 0.0) continue;
            const double open = shadows[b].amplitude;
            worn.by_shadow[open > 0.7   ? 0
                           : open > 0.1 ? 1
                                        : 2]
                .add(measurement.distances[b], truth);
            if (open <= 0.7) continue;
            worn.all_visible.add(measurement.distances[b], truth);
            worn.by_distance[std::min<std::size_t>(4, static_cast<std::size_t>(truth / 0.3))].add(
                measurement.distances[b], truth);
          }
        }
      });
  for (std::size_t b = 0; b < garment.boards.size(); ++b) {
    const auto counts = measurements.signals().health(b).inertial;
    worn.inertial += counts.samples;
    worn.lost += counts.lost;
  }
}

// One board's stream in white noise, with random values: what comes through.
nlohmann::json stream_row(double level, double noise, int slots) {
  sim::InertialEncoder encoder(1000.0, 123.4, kSeed);
  InertialDecoder decoder(1000.0, 1120);
  std::mt19937_64 random(kSeed);
  std::normal_distribution<double> gauss(0.0, noise);
  std::uniform_real_distribution<double> value(-1.0, 1.0);
  std::vector<std::int16_t> signal(1120);
  std::vector<wire::InertialCode> sent;
  std::uint64_t wrong = 0;
  for (int k = 0; k < slots; ++k) {
    for (auto& x : signal) {
      if (encoder.due()) {
        encoder.take({value(random), value(random), value(random), value(random), value(random),
                      value(random)});
        sent.push_back(encoder.sent());
      }
      x = static_cast<std::int16_t>(std::lround(level * encoder.next() + gauss(random)));
    }
    for (const auto& sample : decoder.feed(signal)) {
      const auto i = static_cast<std::size_t>(std::lround((sample.start - 123.4) / 1000.0));
      wrong += i < sent.size() && sent[i] == sample.code ? 0 : 1;
    }
  }
  const auto& counts = decoder.counts();
  const auto total = static_cast<double>(counts.samples + counts.lost);
  return {{"level_over_noise", level / noise},
          {"corrected_chips", counts.samples > 0 ? static_cast<double>(counts.corrected) /
                                                       static_cast<double>(93 * counts.samples)
                                                 : NAN},
          {"lost", static_cast<double>(counts.lost) / total},
          {"relocks", counts.locks > 0 ? counts.locks - 1 : 0},
          {"wrong", static_cast<double>(wrong) / total}};
}

// Chips that are wrong at random: what BCH, CRC and counter let through.
nlohmann::json code_row(double rate, int samples) {
  std::mt19937_64 random(kSeed);
  std::uniform_real_distribution<double> uniform;
  std::uint64_t right = 0, wrong = 0;
  for (int i = 0; i < samples; ++i) {
    wire::InertialCode code;
    for (auto& v : code.values) v = static_cast<std::uint8_t>(random() % 64);
    code.counter = static_cast<std::uint8_t>(i % 16);
    auto chips = wire::encode_chips(code);
    for (auto& chip : chips) chip ^= uniform(random) < rate ? 1 : 0;
    int corrected = 0;
    const auto got = decode_chips(chips, corrected);
    if (!got || got->counter != code.counter) continue;
    ++(*got == code ? right : wrong);
  }
  return {{"wrong_chips", rate},
          {"read", static_cast<double>(right) / samples},
          {"wrong", static_cast<double>(wrong) / samples},
          {"wrong_count", wrong},
          {"samples", samples}};
}

// What the 6-bit code adds to a value that wanders through its range.
nlohmann::json codec_row(const std::string& name, double range, double without) {
  const auto theory = wire::inertial_code_noise(range);
  sim::InertialEncoder encoder(1000.0, 0.0, kSeed);
  std::mt19937_64 random(kSeed);
  std::normal_distribution<double> push(0.0, 0.05 * range);
  double x = 0.0, second = 0.0, seconds_square = 0.0, square = 0.0, low = 0.0;
  // Low-passed at 10 Hz as white() says: windowed sinc, 71 taps.
  constexpr int kTaps = 71;
  std::vector<double> taps(kTaps), error;
  double gain = 0.0;
  for (int i = 0; i < kTaps; ++i) {
    const double t = i - kTaps / 2, w = 2.0 * 10.0 / 140.0;
    const double sinc = t == 0 ? w : std::sin(std::numbers::pi * w * t) / (std::numbers::pi * t);
    taps[static_cast<std::size_t>(i)] =
        sinc * (0.54 + 0.46 * std::cos(2.0 * std::numbers::pi * t / (kTaps - 1)));
    gain += taps[static_cast<std::size_t>(i)] * taps[static_cast<std::size_t>(i)];
  }
  const int n = 100'000;
  for (int k = 0; k < n; ++k) {
    x = std::clamp(0.98 * x + push(random), -0.9 * range, 0.9 * range);
    encoder.take({x / range, 0, 0, 0, 0, 0});
    encoder.skip(1000);
    error.push_back((encoder.sent().values[0] - 32) * theory.step - x);
    square += error.back() * error.back();
    second += error.back() * theory.period;
    if (k % 140 == 139) {
      seconds_square += second * second / (n / 140);
      second = 0.0;
    }
    if (k < kTaps) continue;
    double y = 0.0;
    for (int i = 0; i < kTaps; ++i) {
      y += taps[static_cast<std::size_t>(i)] * error[static_cast<std::size_t>(k - i)];
    }
    low += y * y;
  }
  return {{"channel", name},
          {"step", theory.step},
          {"sample_theory", theory.sample},
          {"sample_measured", std::sqrt(square / n)},
          {"white_10hz_theory", theory.white(10.0)},
          // White noise of this standard deviation would leave as much behind the low-pass.
          {"white_10hz_measured", std::sqrt(low / (n - kTaps) / gain)},
          {"sensor_alone", without},
          {"R_sigma_10hz", std::hypot(without, theory.white(10.0))},
          // Over one second: the error at its end less that at its beginning.
          {"second_theory", std::numbers::sqrt2 * theory.integral},
          {"second_measured", std::sqrt(seconds_square)}};
}

}  // namespace

int main(int argc, char** argv) try {
  CLI::App app{"A garment's raw signals: accuracy of distances, errors of the stream, and cost"};
  const fs::path repository = SECONDSKIN_SOURCE_DIR;
  bool json = false;
  double seconds = 10.0;
  int stream_slots = 20'000;
  std::vector<std::string> motions{"knife_hand_block", "squat", "stepping_punch"};
  app.add_flag("--json", json, "print JSON");
  app.add_option("--seconds", seconds, "of each motion")->capture_default_str();
  app.add_option("--stream-slots", stream_slots, "of a board's stream, for each row")
      ->capture_default_str();
  app.add_option("--motions", motions, "under reference_motions/")->capture_default_str();
  CLI11_PARSE(app, argc, argv);

  const Garment garment = Garment::load(repository / "garments" / "practical.toml");
  nlohmann::json all;

  // Calibration.
  auto& calibrations = all["calibration"] = nlohmann::json::array();
  auto calibration = WearableCalibration::nominal(garment);
  for (const auto& [ruler, noise] :
       {std::pair{0.0, 6.0}, std::pair{1e-3, 6.0}, std::pair{1e-3, 300.0}}) {
    const auto offsets = calibrate(garment, ruler, noise);
    calibrations.push_back({{"ruler_mm", 1e3 * ruler},
                            {"noise", noise},
                            {"left_out_mean_mm", 1e3 * offsets.left_out_mean},
                            {"left_out_sd_mm", 1e3 * offsets.left_out_sd},
                            {"temperature", offsets.implied_temperature}});
    if (ruler == 1e-3 && noise == 6.0) {
      for (std::size_t s = 0; s < garment.sources.size(); ++s) {
        calibration.sources[s] = offsets.sources[s].calibration;
      }
    }
  }

  // Distances on a body.
  std::vector<sim::WornGarment> scenes;
  for (const auto& name : motions) {
    const Motion motion = read_canonical(repository / "reference_motions" / name / "motion.bvh",
                                         repository / "joint_maps");
    scenes.emplace_back(motion, garment, sim::WornErrors{}, kSeed);
  }
  auto& by_noise = all["distances_by_noise"] = nlohmann::json::array();
  for (const double noise : {6.0, 30.0, 100.0, 300.0}) {
    Worn worn;
    for (const auto& scene : scenes) wear(scene, calibration, noise, seconds, worn);
    auto row = worn.all_visible.json(fmt::format("in sight, noise {:.0f}", noise));
    row["inertial_lost"] =
        static_cast<double>(worn.lost) / static_cast<double>(worn.lost + worn.inertial);
    by_noise.push_back(row);
    if (noise != 6.0) continue;
    auto& rows = all["distances"] = nlohmann::json::array();
    for (std::size_t i = 0; i < worn.by_distance.size(); ++i) {
      rows.push_back(worn.by_distance[i].json(
          fmt::format("in sight, {:.1f} to {:.1f} m", 0.3 * static_cast<double>(i),
                      i == 4 ? 2.5 : 0.3 * static_cast<double>(i + 1))));
    }
    rows.push_back(worn.by_shadow[0].json("in sight, all"));
    rows.push_back(worn.by_shadow[1].json("partly hidden"));
    rows.push_back(worn.by_shadow[2].json("hidden"));
  }

  auto& stream = all["stream"] = nlohmann::json::array();
  for (const double ratio : {8.0, 4.0, 2.0, 1.4, 1.0, 0.7, 0.5, 0.35}) {
    stream.push_back(stream_row(300.0, 300.0 / ratio, stream_slots));
  }
  auto& code = all["code"] = nlohmann::json::array();
  for (const double rate : {1e-3, 1e-2, 3e-2, 5e-2, 1e-1, 2e-1, 5e-1}) {
    code.push_back(code_row(rate, 50 * stream_slots));
  }
  all["codec"] = {codec_row("gyroscope, 500 deg/s [rad/s]", garment.boards[0].gyro_range, 0.002),
                  codec_row("accelerometer, 3 g [m/s^2]", garment.boards[0].accel_range, 0.02)};

  // Cost: a recording in memory, each stage alone.
  {
    sim::GarmentSignal signal(scenes.front(), kSeed);
    std::vector<wire::GarmentSlot> slots;
    for_each_slot(signal, garment, static_cast<std::uint32_t>(seconds / garment.slot()),
                  [&](const wire::GarmentSlot& slot) { slots.push_back(slot); });
    const double duration = static_cast<double>(slots.size()) * garment.slot();
    const auto timed = [&](const std::string& stage, auto run) {
      double best = INFINITY;
      for (int i = 0; i < 3; ++i) {
        const double begin = cpu_time();
        run();
        best = std::min(best, cpu_time() - begin);
      }
      all["cost"].push_back({{"stage", stage},
                             {"real_time_factor", duration / best},
                             {"us_per_slot", 1e6 * best / static_cast<double>(slots.size())}});
    };
    const auto n = garment.boards.size();
    timed("ultrasound, 18 boards", [&] {
      std::vector<ArrivalFinder> finders(
          n, ArrivalFinder(garment.sample_rate_hz, garment.carrier_hz, garment.slot_samples));
      for (const auto& slot : slots) {
        for (std::size_t b = 0; b < n; ++b) {
          (void)finders[b].find(slot.board(b, garment.slot_samples));
        }
      }
    });
    timed("inertial stream, 18 boards", [&] {
      std::vector<InertialDecoder> decoders(n, InertialDecoder(1000.0, garment.slot_samples));
      for (const auto& slot : slots) {
        for (std::size_t b = 0; b < n; ++b) {
          (void)decoders[b].feed(slot.board(b, garment.slot_samples));
        }
      }
    });
    timed("inertial stream, none locked", [&] {
      std::vector<std::int16_t> noise(garment.slot_samples);
      std::mt19937 random(kSeed);
      for (auto& x : noise) x = static_cast<std::int16_t>(random() % 200);
      std::vector<InertialDecoder> decoders(n, InertialDecoder(1000.0, garment.slot_samples));
      for (std::size_t k = 0; k < slots.size(); ++k) {
        for (auto& decoder : decoders) (void)decoder.feed(noise);
      }
    });
    timed("slots to measurements", [&] {
      GarmentMeasurements measurements(garment, calibration);
      Measurement measurement;
      for (const auto& slot : slots) {
        measurements.add(slot, 20.0);
        while (measurements.next(measurement)) {
        }
      }
    });
    std::vector<std::uint8_t> bytes;
    const auto header = signal.header();
    for (const auto& slot : slots) wire::append_slot(header, slot.sequence, slot.samples, bytes);
    timed("bytes to measurements", [&] {
      GarmentMeasurements measurements(garment, calibration);
      Measurement measurement;
      wire::GarmentStreamReader reader;
      const auto sink = [&](const wire::GarmentSlot& slot) {
        measurements.add(slot, 20.0);
        while (measurements.next(measurement)) {
        }
      };
      constexpr std::size_t kChunk = 1 << 16;
      for (std::size_t at = 0; at < bytes.size(); at += kChunk) {
        reader.feed(std::span(bytes).subspan(at, std::min(kChunk, bytes.size() - at)), sink);
      }
    });
  }

  if (json) {
    fmt::print("{}\n", all.dump(2));
    return 0;
  }
  const auto number = [](const nlohmann::json& value) {
    return value.is_number() ? value.get<double>() : NAN;
  };
  fmt::print(
      "Source offsets, leave-one-out error [mm]; the paper's, on real hardware: 2.35 +- 1.92\n");
  fmt::print("{:>10} {:>8} {:>8} {:>8} {:>16}\n", "ruler [mm]", "noise", "mean", "sd",
             "temperature [C]");
  for (const auto& row : calibrations) {
    fmt::print("{:>10.1f} {:>8.0f} {:>8.2f} {:>8.2f} {:>16.1f}\n", number(row["ruler_mm"]),
               number(row["noise"]), number(row["left_out_mean_mm"]), number(row["left_out_sd_mm"]),
               number(row["temperature"]));
  }
  const auto distances = [&](const std::string& title, const nlohmann::json& rows) {
    fmt::print("\n{}\n{:<28} {:>8} {:>9} {:>10} {:>8} {:>8}\n", title, "pairs", "pulses",
               "measured", "mean [mm]", "sd [mm]", "wrong");
    for (const auto& row : rows) {
      fmt::print("{:<28} {:>8} {:>7.1f} % {:>10.2f} {:>8.2f} {:>6.2f} %\n",
                 row["pairs"].get<std::string>(), row["pulses"].get<std::size_t>(),
                 100.0 * number(row["measured"]), number(row["mean_mm"]), number(row["sd_mm"]),
                 100.0 * number(row["wrong"]));
    }
  };
  distances("Distances on a moving body (measured: confidence 0.5 or more; wrong: by over 5 cm)",
            all["distances"]);
  distances("The same by the converter's noise [counts; a pulse at 1 m has 4800]", by_noise);
  fmt::print("\nInertial stream in white noise\n{:>12} {:>16} {:>9} {:>9} {:>10}\n", "level/noise",
             "corrected chips", "lost", "relocks", "wrong");
  for (const auto& row : stream) {
    fmt::print("{:>12.2f} {:>16.5f} {:>7.2f} % {:>9} {:>10.1e}\n", number(row["level_over_noise"]),
               number(row["corrected_chips"]), 100.0 * number(row["lost"]),
               row["relocks"].get<std::uint64_t>(), number(row["wrong"]));
  }
  fmt::print("\nThe code alone, {} samples a row\n{:>12} {:>10} {:>10} {:>8}\n", 50 * stream_slots,
             "wrong chips", "read", "wrong", "number");
  for (const auto& row : code) {
    fmt::print("{:>12.3f} {:>10.5f} {:>10.1e} {:>8}\n", number(row["wrong_chips"]),
               number(row["read"]), number(row["wrong"]), row["wrong_count"].get<std::uint64_t>());
  }
  fmt::print("\nWhat the 6-bit code adds (sigma)\n");
  for (const auto& row : all["codec"]) {
    fmt::print(
        "{:<30} step {:.4f}; a sample {:.4f} (theory {:.4f}); as white noise below 10 Hz {:.4f} "
        "(theory {:.4f});\n{:30} R sigma without the code {:.4f}, with it {:.4f}; integral of a "
        "second {:.5f} (theory {:.5f})\n",
        row["channel"].get<std::string>(), number(row["step"]), number(row["sample_measured"]),
        number(row["sample_theory"]), number(row["white_10hz_measured"]),
        number(row["white_10hz_theory"]), "", number(row["sensor_alone"]),
        number(row["R_sigma_10hz"]), number(row["second_measured"]), number(row["second_theory"]));
  }
  fmt::print("\nCost, one core, 18 boards at 140 kHz\n{:<30} {:>12} {:>16}\n", "stage", "us a slot",
             "times real time");
  for (const auto& row : all["cost"]) {
    fmt::print("{:<30} {:>12.1f} {:>16.1f}\n", row["stage"].get<std::string>(),
               number(row["us_per_slot"]), number(row["real_time_factor"]));
  }
  return 0;
} catch (const std::exception& error) {
  fmt::print(stderr, "garment_signal_bench: {}\n", error.what());
  return 1;
}
