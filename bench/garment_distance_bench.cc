// Are simulated distances as good and as bad as those of the raw signals? One worn garment, its raw
// signals through the ultrasound processing beside SimulatedMeasurements of the same truth, by how
// weak the direct sound is. docs/wearable-hardware.md quotes the output.

#include <fmt/core.h>

#include <CLI/CLI.hpp>
#include <array>
#include <cmath>
#include <filesystem>
#include <nlohmann/json.hpp>

#include "motion/retarget.h"
#include "server/wearable/signal/garment_measurements.h"
#include "sim/wearable/acoustics.h"
#include "sim/wearable/garment_signal.h"
#include "sim/wearable/simulated_measurements.h"
#include "sim/wearable/worn_garment.h"

namespace {

using namespace secondskin;

constexpr std::size_t kClasses = 10;
constexpr double kClass = 5.0;   // [dB]
constexpr double kWrong = 0.05;  // a distance so far off is of something else [m]

struct Class {
  double pulses = 0.0, silent = 0.0, wrong = 0.0, confident = 0.0, error = 0.0, square = 0.0;
};
using Classes = std::array<Class, kClasses>;

// A source's offset as calibration would find it: the pulse's own inflection, after its start.
double true_offset(const sim::Transducer& transducer, const Garment& garment) {
  const sim::UltrasonicPulse pulse(transducer, garment.carrier_hz, garment.sample_rate_hz);
  double steepest = 0.0, at = 0.0;
  for (double x = 0.25; x < pulse.length(); x += 0.25) {
    const double rise = std::pow(pulse.envelope(x), 2) - std::pow(pulse.envelope(x - 0.25), 2);
    if (rise > steepest) {
      steepest = rise;
      at = x;
    }
  }
  return transducer.start_samples + at;
}

void judge(const sim::WornGarment& worn, const server::Measurement& m, double c, Classes& out) {
  if (m.kind != server::MeasurementKind::kDistances) return;
  static thread_local sim::GarmentInstant instant;
  worn.at(static_cast<double>(m.stamp_ns) * 1e-9, instant);
  const Eigen::Isometry3d& X_WU = instant.sources[m.source];
  for (std::size_t i = 0; i < m.distances.size(); ++i) {
    const sim::BoardTruth& S = instant.boards[i];
    const Eigen::Vector3d way = S.X_WS.translation() - X_WU.translation();
    const sim::Shadow shadow = sim::acoustic_shadow(X_WU.translation(), S.X_WS.translation(),
                                                    instant.limbs, c / worn.garment().carrier_hz);
    const double amplitude =
        sim::directivity(X_WU.linear().col(2).dot(way) / way.norm()) * shadow.amplitude;
    const auto k = static_cast<std::size_t>(-20.0 * std::log10(amplitude) / kClass);
    if (k >= kClasses) continue;
    Class& row = out[k];
    const server::DistanceReading& reading = m.distances[i];
    row.pulses += 1.0;
    if (reading.confidence <= 0.0) {
      row.silent += 1.0;
      continue;
    }
    row.confident += reading.confidence > 0.5 ? 1.0 : 0.0;
    const double flight = way.norm() / c;
    const double error = reading.distance - (way + flight * S.v).norm() - shadow.detour;
    if (std::abs(error) > kWrong) {
      row.wrong += 1.0;
    } else {
      row.error += error;
      row.square += error * error;
    }
  }
}

nlohmann::json json_of(const Class& row) {
  const double heard = row.pulses - row.silent, right = heard - row.wrong;
  return {{"pulses", row.pulses},
          {"silent", row.silent / row.pulses},
          {"confident", row.confident / row.pulses},
          {"wrong", row.wrong / heard},
          {"mean_mm", 1e3 * row.error / right},
          {"rms_mm", 1e3 * std::sqrt(row.square / right)}};
}

}  // namespace

int main(int argc, char** argv) {
  namespace fs = std::filesystem;
  CLI::App app{"distances of raw signals and simulated ones, by how weak the direct sound is"};
  const fs::path repository = SECONDSKIN_SOURCE_DIR;
  bool json = false;
  std::vector<std::string> motions{"roundhouse_kick", "stepping_punch", "jumping_jack"};
  app.add_flag("--json", json, "print JSON");
  app.add_option("--motions", motions, "under reference_motions/")->capture_default_str();
  CLI11_PARSE(app, argc, argv);

  const Garment garment = Garment::load(repository / "garments/practical.toml");
  Classes raw{}, simulated{};
  server::Measurement m;
  for (std::size_t i = 0; i < motions.size(); ++i) {
    const sim::WornGarment worn(
        read_canonical(repository / "reference_motions" / motions[i] / "motion.bvh",
                       repository / "joint_maps"),
        garment, sim::WornErrors{}, i + 1);
    const sim::SignalOptions options;
    const double c = sim::speed_of_sound(options.temperature);
    sim::GarmentSignal signal(worn, i + 1, options);
    auto calibration = server::WearableCalibration::nominal(garment);
    for (std::size_t s = 0; s < garment.sources.size(); ++s) {
      calibration.sources[s].offset = true_offset(signal.transducers()[s], garment);
    }
    server::GarmentMeasurements measurements(garment, calibration);
    wire::GarmentSlot slot;
    slot.samples.resize(garment.boards.size() * garment.slot_samples);
    for (std::uint32_t k = 0; k < signal.slots(); ++k) {
      signal.next(slot.samples);
      slot.sequence = k;
      slot.source = k % garment.sources.size();
      slot.stamp_ns = signal.header().stamp_ns(k);
      measurements.add(slot, options.temperature);
      while (measurements.next(m)) judge(worn, m, c, raw);
    }
    sim::SimulatedMeasurements stream(worn, i + 1);
    while (stream.next(m) == server::Next::kPose) judge(worn, m, c, simulated);
  }

  if (json) {
    nlohmann::json out;
    for (std::size_t k = 0; k < kClasses; ++k) {
      out.push_back({{"weaker_than_db", kClass * static_cast<double>(k)},
                     {"raw", json_of(raw[k])},
                     {"simulated", json_of(simulated[k])}});
    }
    fmt::print("{}\n", out.dump(2));
    return 0;
  }
  fmt::print("direct sound   pulses | raw: silent wrong  mean   rms  conf | simulated: the same\n");
  for (std::size_t k = 0; k < kClasses; ++k) {
    fmt::print("-{:2.0f} to -{:2.0f} dB {:8.0f} |", kClass * static_cast<double>(k),
               kClass * static_cast<double>(k + 1), raw[k].pulses);
    for (const Class& row : {raw[k], simulated[k]}) {
      const auto j = json_of(row);
      fmt::print("   {:5.1f} % {:5.1f} % {:5.1f} {:5.1f} mm {:4.0f} % |",
                 100.0 * j["silent"].get<double>(), 100.0 * j["wrong"].get<double>(),
                 j["mean_mm"].get<double>(), j["rms_mm"].get<double>(),
                 100.0 * j["confident"].get<double>());
    }
    fmt::print("\n");
  }
  return 0;
}
