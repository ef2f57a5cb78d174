#include "server/wearable/signal/garment_receiver.h"

#include <fmt/format.h>

namespace secondskin::server {

GarmentReceiver::GarmentReceiver(const std::string& place, Garment garment,
                                 WearableCalibration calibration, std::optional<double> temperature)
    : garment_(std::move(garment)),
      calibration_(std::move(calibration)),
      temperature_(temperature),
      slots_(place),
      measurements_(std::make_unique<GarmentMeasurements>(garment_, calibration_)) {}

Next GarmentReceiver::next(Measurement& measurement) {
  while (!measurements_->next(measurement)) {
    if (finished_) return Next::kEnd;
    const wire::GarmentSlot* slot = nullptr;
    const Next next = slots_.next(slot);
    if (next == Next::kSilence) return next;
    if (next == Next::kEnd) {
      finished_ = true;
      measurements_->finish();
      continue;
    }
    if (!checked_) check_stream(*slots_.header(), garment_, slots_.place());
    checked_ = true;
    measurements_->add(*slot, temperature_.value_or(slots_.header()->temperature));
  }
  return Next::kPose;
}

std::string GarmentReceiver::trouble() const {
  if (std::string trouble = slots_.trouble(); !trouble.empty()) return trouble;
  const wire::GarmentStreamCounters& c = slots_.counters();
  if (c.garbled + c.lost == 0 && c.slots > 0) return {};
  return fmt::format(
      "of {}, {} slots came whole, {} are missing, {} headers and blocks are garbled",
      slots_.place(), c.slots, c.lost, c.garbled);
}

bool GarmentReceiver::rewind() {
  if (!slots_.rewind()) return false;
  measurements_ = std::make_unique<GarmentMeasurements>(garment_, calibration_);
  checked_ = finished_ = false;
  return true;
}

}  // namespace secondskin::server
