#pragma once

#include <memory>
#include <optional>

#include "server/wearable/measurement.h"
#include "server/wearable/signal/garment_measurements.h"
#include "server/wearable/signal/slot_source.h"

/// A garment as a stream of measurements, from a file, a port or a socket by the same code.
namespace secondskin::server {

class GarmentReceiver final : public MeasurementStream {
 public:
  /// @param temperature  of the air [deg C]; empty: as the stream's headers say
  /// @throws std::runtime_error naming the place; std::invalid_argument as GarmentMeasurements
  GarmentReceiver(const std::string& place, Garment garment, WearableCalibration calibration,
                  std::optional<double> temperature = {});

  /// Inertial sets and distances as they become known.
  /// @throws std::runtime_error as check_stream, at the first slot, and when a file is no stream
  [[nodiscard]] Next next(Measurement& measurement) override;
  bool live() const override { return slots_.live(); }
  bool rewind() override;
  std::string trouble() const override;

  const Garment& garment() const noexcept { return garment_; }
  const SlotSource& slots() const noexcept { return slots_; }
  /// Health of each board is in its signals().
  const GarmentMeasurements& measurements() const noexcept { return *measurements_; }

 private:
  Garment garment_;
  WearableCalibration calibration_;
  std::optional<double> temperature_;
  SlotSource slots_;
  std::unique_ptr<GarmentMeasurements> measurements_;
  bool checked_ = false, finished_ = false;
};

}  // namespace secondskin::server
