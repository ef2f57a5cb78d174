#include "server/wearable/signal/garment_measurements.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>

namespace secondskin::server {
namespace {

// A sample is complete when its last chip is through the low-pass; a board may be so much later
// than its sample's end [A/D samples].
constexpr double kTail = 64.0;
constexpr double kStrengthGain = 0.05;

}  // namespace

GarmentMeasurements::GarmentMeasurements(const Garment& garment, WearableCalibration calibration)
    : calibration_(std::move(calibration)),
      rate_(garment.sample_rate_hz),
      period_(garment.sample_rate_hz / garment.inertial_rate_hz),
      signals_(garment),
      trackers_(garment.sources.size() * garment.boards.size()),
      saturated_(garment.boards.size()),
      strength_(garment.boards.size()) {
  if (calibration_.boards.size() != garment.boards.size() ||
      calibration_.sources.size() != garment.sources.size()) {
    throw std::invalid_argument("the calibration is of another garment");
  }
  // What a bridged gap may complete at once, and a slot of boards that all begin apart.
  const std::size_t samples_a_slot = garment.slot_samples / static_cast<std::size_t>(period_) + 4;
  waiting_.reserve(4 * samples_a_slot * garment.boards.size());
  ready_.resize(waiting_.capacity() + 2);
  order_.resize(ready_.size());
  for (auto& measurement : ready_) {
    measurement.boards.resize(garment.boards.size());
    measurement.distances.resize(garment.boards.size());
  }
}

Measurement& GarmentMeasurements::make(MeasurementKind kind, std::int64_t stamp_ns) noexcept {
  Measurement& made = ready_[std::min(ready_count_, ready_.size() - 1)];
  ready_count_ = std::min(ready_count_ + 1, ready_.size());
  made.kind = kind;
  made.stamp_ns = stamp_ns;
  std::fill(made.boards.begin(), made.boards.end(), BoardReading{});
  std::fill(made.distances.begin(), made.distances.end(), DistanceReading{});
  return made;
}

void GarmentMeasurements::take_inertial(const wire::GarmentSlot& slot) noexcept {
  for (std::size_t b = 0; b < saturated_.size(); ++b) {
    for (const auto& sample : signals_.inertial(b)) {
      if (waiting_.size() == waiting_.capacity()) return;
      const double after = (sample.start - signals_.slot_begin()) / rate_;
      waiting_.push_back({sample.start, slot.stamp_ns + std::llround(1e9 * after), b, sample.code});
    }
  }
}

void GarmentMeasurements::take_distances(const wire::GarmentSlot& slot,
                                         double temperature) noexcept {
  if (!slot.source || *slot.source >= calibration_.sources.size()) return;
  const std::size_t source = *slot.source;
  Measurement& made = make(MeasurementKind::kDistances, slot.stamp_ns);
  made.source = source;
  const auto arrivals = signals_.arrivals();
  const double metres_per_sample = speed_of_sound(temperature) / rate_;
  const double time = signals_.slot_begin() / rate_;
  for (std::size_t b = 0; b < arrivals.size(); ++b) {
    double share = 0.0;
    if (arrivals[b]) {
      const auto& known = calibration_.sources[source];
      auto& tracker = trackers_[source * arrivals.size() + b];
      const auto result = tracker.add(*arrivals[b], time, known, metres_per_sample);
      made.distances[b] = {result.distance, result.w_s * result.w_t};
      share = arrivals[b]->peak * result.distance * result.distance / known.strength;
    }
    strength_[b] += kStrengthGain * (share - strength_[b]);
  }
}

// Gives out what no board can add to: all who begin within kTogether of the first have been read
// by `until`.
void GarmentMeasurements::give_out_inertial(double until) noexcept {
  const double together = kTogether * period_;
  while (!waiting_.empty() && ready_count_ < ready_.size()) {
    const double first =
        std::min_element(waiting_.begin(), waiting_.end(), [](const Waiting& a, const Waiting& b) {
          return a.start < b.start;
        })->start;
    if (first + together + period_ + kTail > until) return;
    Measurement& made = make(MeasurementKind::kInertial, 0);
    std::int64_t earliest = 0, sum = 0, count = 0;
    const auto kept = std::remove_if(waiting_.begin(), waiting_.end(), [&](const Waiting& in) {
      if (in.start > first + together) return false;
      if (count == 0) earliest = in.stamp_ns;
      sum += in.stamp_ns - earliest;
      ++count;
      const auto& known = calibration_.boards[in.board];
      auto& out = made.boards[in.board];
      out.gyro = gyro_of(in.code, known);
      out.accel = accel_of(in.code, known);
      out.gyro_valid = !saturated(in.code, 0);
      out.accel_valid = !saturated(in.code, 3);
      saturated_[in.board] += out.gyro_valid && out.accel_valid ? 0 : 1;
      return true;
    });
    waiting_.erase(kept, waiting_.end());
    made.stamp_ns = earliest + sum / count;
  }
}

void GarmentMeasurements::begin() noexcept {
  ready_count_ = 0;
  given_ = 0;
}

void GarmentMeasurements::sort() noexcept {
  for (std::size_t i = 0; i < ready_count_; ++i) order_[i] = i;
  std::sort(order_.begin(), order_.begin() + static_cast<std::ptrdiff_t>(ready_count_),
            [&](std::size_t a, std::size_t b) {
              return ready_[a].stamp_ns != ready_[b].stamp_ns
                         ? ready_[a].stamp_ns < ready_[b].stamp_ns
                         : a < b;
            });
}

void GarmentMeasurements::add(const wire::GarmentSlot& slot, double temperature) noexcept {
  begin();
  signals_.process(slot);
  take_inertial(slot);
  take_distances(slot, temperature);
  give_out_inertial(signals_.slot_end());
  sort();
}

void GarmentMeasurements::finish() noexcept {
  begin();
  give_out_inertial(std::numeric_limits<double>::infinity());
  sort();
}

bool GarmentMeasurements::next(Measurement& measurement) {
  if (given_ == ready_count_) return false;
  measurement = ready_[order_[given_++]];
  return true;
}

}  // namespace secondskin::server
