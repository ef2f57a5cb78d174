#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "server/wearable/measurement.h"
#include "server/wearable/signal/board_signals.h"
#include "server/wearable/signal/wearable_calibration.h"

/// From a driver box's slots to measurements in physical units. One thread; no allocation after
/// construction.
namespace secondskin::server {

class GarmentMeasurements {
 public:
  /// Boards whose samples begin within this time share a Measurement, stamped with their mean: a
  /// quarter of a sample. [share of the inertial period]
  static constexpr double kTogether = 0.25;

  /// @throws std::invalid_argument as BoardSignals, and when calibration and garment differ
  GarmentMeasurements(const Garment& garment, WearableCalibration calibration);

  /// Takes the next slot; what next() has not given out is dropped. @param temperature  of the air
  /// [deg C]
  void add(const wire::GarmentSlot& slot, double temperature) noexcept;
  /// No more slots come: what waits for boards that are late is given out.
  void finish() noexcept;

  /// The next measurement that is known, by its stamp among those that became known together.
  /// @returns false when more slots are needed
  [[nodiscard]] bool next(Measurement& measurement);

  const BoardSignals& signals() const noexcept { return signals_; }
  /// Readings of a board that were at an end of the sensors' range.
  std::uint64_t saturated_readings(std::size_t board) const noexcept { return saturated_[board]; }
  /// How strong a board hears the sources: peak power as a share of the calibrated strength, mean
  /// of late; 0 when it hears nothing.
  double signal_strength(std::size_t board) const noexcept { return strength_[board]; }

 private:
  struct Waiting {
    double start;
    std::int64_t stamp_ns;
    std::size_t board;
    wire::InertialCode code;
  };

  void begin() noexcept;
  void sort() noexcept;
  void take_inertial(const wire::GarmentSlot& slot) noexcept;
  void take_distances(const wire::GarmentSlot& slot, double temperature) noexcept;
  void give_out_inertial(double until) noexcept;
  Measurement& make(MeasurementKind kind, std::int64_t stamp_ns) noexcept;

  WearableCalibration calibration_;
  double rate_, period_;
  BoardSignals signals_;
  std::vector<DistanceTracker> trackers_;  ///< source-major
  std::vector<Waiting> waiting_;
  std::vector<Measurement> ready_;  ///< the first ready_count_ hold measurements
  std::size_t ready_count_ = 0, given_ = 0;
  std::vector<std::size_t> order_;
  std::vector<std::uint64_t> saturated_;
  std::vector<double> strength_;
};

}  // namespace secondskin::server
