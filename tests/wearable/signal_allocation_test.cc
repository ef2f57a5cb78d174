#include <gtest/gtest.h>

#include <filesystem>

#include "server/wearable/signal/garment_measurements.h"
#include "sim/wearable/calibration_scenes.h"
#include "sim/wearable/garment_signal.h"
#include "tests/count_malloc.h"

namespace secondskin::server {
namespace {

TEST(GarmentMeasurements, AllocateNothingFromBytesToMeasurements) {
#ifndef COUNTS_MALLOC
  GTEST_SKIP() << "the sanitizers bring their own malloc";
#else
  Garment garment =
      Garment::load(std::filesystem::path(SECONDSKIN_SOURCE_DIR) / "garments" / "practical.toml");
  garment.boards.resize(4);
  const sim::StandScene scene(garment, sim::WornErrors::none(), 1, 10.0);
  sim::SignalOptions options;
  options.faults.silent.push_back({1, 0.5, 0.8});
  sim::GarmentSignal signal(scene, 2, options);
  std::vector<std::uint8_t> bytes;
  std::vector<std::int16_t> samples(garment.boards.size() * garment.slot_samples);
  for (std::uint32_t k = 0; k < 250; ++k) {
    signal.next(samples);
    if (k < 100 || k > 104) wire::append_slot(signal.header(), k, samples, bytes);
  }

  GarmentMeasurements measurements(garment, WearableCalibration::nominal(garment));
  wire::GarmentStreamReader reader;
  Measurement measurement;
  measurement.boards.resize(garment.boards.size());
  measurement.distances.resize(garment.boards.size());
  std::size_t given = 0;
  const wire::GarmentStreamReader::Sink sink = [&](const wire::GarmentSlot& slot) {
    measurements.add(slot, 20.0);
    while (measurements.next(measurement)) ++given;
  };
  const std::size_t first = bytes.size() / 20;  // the header, and room made for blocks
  const std::size_t chunk = 4096;
  std::size_t at = 0;
  for (; at < first; at += chunk) reader.feed(std::span(bytes).subspan(at, chunk), sink);
  const long before = allocations;
  for (; at < bytes.size(); at += chunk) {
    reader.feed(std::span(bytes).subspan(at, std::min(chunk, bytes.size() - at)), sink);
  }
  EXPECT_EQ(allocations, before);
  EXPECT_GT(given, 450U);
#endif
}

}  // namespace
}  // namespace secondskin::server
