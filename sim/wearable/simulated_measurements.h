#pragma once

#include <random>

#include "sim/wearable/garment_faults.h"
#include "sim/wearable/inertial_sensor.h"

/// What a garment would measure, without its signals: for filters. garment_signal.h makes the
/// raw signals of the same truth.
///
/// Inertial sets come at the garment's inertial rate from time 0; each slot's distances follow when
/// the slot has ended, stamped with the pulse, so stamps go back by up to a slot.
namespace secondskin::sim {

struct MeasurementOptions {
  bool codec = false;         ///< inertial readings through 6-bit delta modulation (4.2)
  bool distances = true;      ///< whether the sources sound
  double temperature = 20.0;  ///< of the air, as assumed [deg C]
  /// Share of the weak direct sounds that an echo is taken for; the others give no distance.
  double echo_share = 0.3;
  std::int64_t start_ns = 0;  ///< stamp of time 0
  GarmentFaults faults;
};

/// Deterministic for a seed.
class SimulatedMeasurements final : public server::MeasurementStream {
 public:
  /// @param worn  borrowed
  SimulatedMeasurements(const GarmentScene& worn, std::uint64_t seed,
                        const MeasurementOptions& options = {});

  /// Ends with the motion.
  [[nodiscard]] server::Next next(server::Measurement& measurement) override;
  /// The same measurements again.
  bool rewind() override;

  /// The sensors as they are by now, in the order of the garment's boards.
  const std::vector<InertialSensor>& sensors() const noexcept { return sensors_; }
  double time_of(std::int64_t stamp_ns) const noexcept {
    return static_cast<double>(stamp_ns - options_.start_ns) * 1e-9;
  }

 private:
  void inertial(double time, server::Measurement& out);
  void distances(double time, server::Measurement& out);
  server::DistanceReading distance(std::size_t source, std::size_t board, double time,
                                   const Shadow& shadow);
  std::size_t board_at_channel(std::size_t channel) const noexcept;

  const GarmentScene& worn_;
  std::uint64_t seed_;
  MeasurementOptions options_;
  std::vector<InertialSensor> sensors_;
  std::mt19937_64 random_;
  std::vector<BoardTruth> truth_;
  GarmentInstant instant_;
  std::vector<Shadow> shadows_;
  std::vector<double> last_;  ///< last distance by source and channel, NaN before the first [m]
  std::uint64_t samples_ = 0, slots_ = 0;
};

}  // namespace secondskin::sim
