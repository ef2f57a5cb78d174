#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <fstream>
#include <functional>
#include <numbers>

#include "server/wearable/calibrate/inertial_calibration.h"
#include "server/wearable/calibrate/source_offsets.h"
#include "server/wearable/signal/board_signals.h"
#include "sim/wearable/calibration_scenes.h"
#include "sim/wearable/garment_signal.h"

namespace secondskin::server {
namespace {

constexpr double kRate = 45.0 * 2.0 * std::numbers::pi / 60.0;  // 4.3: 45 rpm

Garment garment_of(std::size_t boards) {
  Garment garment =
      Garment::load(std::filesystem::path(SECONDSKIN_SOURCE_DIR) / "garments" / "practical.toml");
  garment.boards.resize(boards);
  return garment;
}

// Sends a scene through its raw signals. `look` sees the signals after each slot.
void receive(const sim::GarmentScene& scene, sim::GarmentSignal& signal,
             const std::function<void(const wire::GarmentSlot&, const BoardSignals&)>& look) {
  const Garment& garment = scene.garment();
  BoardSignals signals(garment);
  wire::GarmentSlot slot;
  slot.samples.resize(garment.boards.size() * garment.slot_samples);
  for (std::uint32_t k = 0; k < signal.slots(); ++k) {
    signal.next(slot.samples);
    slot.sequence = k;
    slot.source = k % garment.sources.size();
    signals.process(slot);
    look(slot, signals);
  }
}

struct Recorded {
  std::vector<SteadyParts> boards;
  std::vector<sim::InertialSensor> sensors;
};

Recorded record(const Garment& garment, std::vector<sim::BenchStop> stops,
                const sim::WornErrors& errors, double slip = 0.0) {
  const sim::BenchScene scene(garment, errors, std::move(stops), slip);
  sim::GarmentSignal signal(scene, 3);
  Recorded recorded{std::vector<SteadyParts>(garment.boards.size()), {}};
  receive(scene, signal, [&](const wire::GarmentSlot&, const BoardSignals& signals) {
    for (std::size_t b = 0; b < garment.boards.size(); ++b) {
      for (const auto& sample : signals.inertial(b)) recorded.boards[b].add(sample.code);
    }
  });
  recorded.sensors = signal.sensors();
  return recorded;
}

sim::WornErrors sensor_errors() {
  sim::WornErrors errors;
  errors.gyro_bias = 0.05;
  errors.accel_bias = 0.3;
  errors.scale = 0.02;
  return errors;
}

// What the sensors are: reading = (1 + scale) truth + bias, code = 32 + reading / step.
void expect_accelerometer(const AxesFit& fit, const sim::InertialSensor& sensor,
                          const BoardCalibration& nominal, double zero, double slope) {
  for (Eigen::Index i = 0; i < 3; ++i) {
    EXPECT_NEAR(fit.zero[i], 32.0 + sensor.accel_bias()[i] / nominal.accel_slope[i], zero);
    EXPECT_NEAR(fit.slope[i] * (1.0 + sensor.accel_scale()[i]) / nominal.accel_slope[i], 1.0,
                slope);
  }
}

TEST(AccelerometerCalibration, SixSidesGiveZeroAndSlope) {
  const Garment garment = garment_of(2);
  const auto nominal = WearableCalibration::nominal(garment);
  const auto recorded = record(garment, sim::six_sides(), sensor_errors(), 0.005);
  for (std::size_t b = 0; b < 2; ++b) {
    const auto fit = accelerometer_by_axes(recorded.boards[b].parts(), nominal.boards[b]);
    ASSERT_TRUE(fit) << fit.error().text;
    EXPECT_EQ(fit->parts, 6U);
    expect_accelerometer(*fit, recorded.sensors[b], nominal.boards[b], 0.02, 0.003);
  }
}

TEST(AccelerometerCalibration, StillPosesInAnyOrientationGiveTheSame) {
  const Garment garment = garment_of(2);
  const auto nominal = WearableCalibration::nominal(garment);
  const auto recorded = record(garment, sim::still_poses(12, 7), sensor_errors());
  for (std::size_t b = 0; b < 2; ++b) {
    const auto fit = accelerometer_by_poses(recorded.boards[b].parts(), nominal.boards[b]);
    ASSERT_TRUE(fit) << fit.error().text;
    EXPECT_EQ(fit->parts, 12U);
    EXPECT_LT(fit->residual, 0.02);
    expect_accelerometer(*fit, recorded.sensors[b], nominal.boards[b], 0.03, 0.003);
  }
}

TEST(AccelerometerCalibration, RefusalNamesWhatIsMissing) {
  const Garment garment = garment_of(1);
  const auto nominal = WearableCalibration::nominal(garment);
  auto stops = sim::six_sides();
  stops.erase(stops.begin() + 3);  // y down
  const auto recorded = record(garment, stops, sensor_errors());
  const auto parts = recorded.boards[0].parts();
  const auto by_axes = accelerometer_by_axes(parts, nominal.boards[0]);
  ASSERT_FALSE(by_axes);
  EXPECT_THAT(by_axes.error().text, testing::HasSubstr("its y down;"));
  const auto by_poses = accelerometer_by_poses(parts, nominal.boards[0]);
  ASSERT_FALSE(by_poses);
  EXPECT_THAT(by_poses.error().text, testing::HasSubstr("5 still poses that differ, 9"));
  // Many poses, none of which has z down.
  std::vector<SteadyPart> upper;
  for (int i = 0; i < 24; ++i) {
    const double a = 0.26 * i, z = 0.1 + 0.8 * i / 24.0, r = std::sqrt(1.0 - z * z);
    SteadyPart part{CodeVector::Constant(32.0), 280};
    part.mean.tail<3>() += (kStandardGravity * Eigen::Vector3d(r * std::cos(a), r * std::sin(a), z))
                               .cwiseQuotient(nominal.boards[0].accel_slope);
    upper.push_back(part);
  }
  const auto half = accelerometer_by_poses(upper, nominal.boards[0]);
  ASSERT_FALSE(half);
  EXPECT_EQ(half.error().text, "no still pose with its z down");
}

TEST(GyroscopeCalibration, TurntableGivesZeroAndSlope) {
  const Garment garment = garment_of(2);
  const auto nominal = WearableCalibration::nominal(garment);
  const auto recorded = record(garment, sim::six_turns(kRate), sensor_errors(), 0.005);
  for (std::size_t b = 0; b < 2; ++b) {
    const auto fit = gyroscope_by_turntable(recorded.boards[b].parts(), nominal.boards[b], kRate);
    ASSERT_TRUE(fit) << fit.error().text;
    const auto& sensor = recorded.sensors[b];
    for (Eigen::Index i = 0; i < 3; ++i) {
      EXPECT_NEAR(fit->zero[i], 32.0 + sensor.gyro_bias()[i] / nominal.boards[b].gyro_slope[i],
                  0.02);
      EXPECT_NEAR(fit->slope[i] * (1.0 + sensor.gyro_scale()[i]) / nominal.boards[b].gyro_slope[i],
                  1.0, 0.002);
    }
    auto three = recorded.boards[b].parts();
    std::erase_if(three, [&](const SteadyPart& part) {
      return part.mean.head<3>().y() < 20.0 || std::abs(part.mean.z() - 32.0) > 10.0;
    });
    const auto refused = gyroscope_by_turntable(three, nominal.boards[b], kRate);
    ASSERT_FALSE(refused);
    EXPECT_THAT(refused.error().text, testing::HasSubstr("y down, z up, z down"));
  }
}

TEST(GyroscopeCalibration, LyingStillGivesTheZero) {
  const Garment garment = garment_of(2);
  const auto nominal = WearableCalibration::nominal(garment);
  const auto recorded = record(garment, sim::still_poses(2, 3, 8.0), sensor_errors());
  for (std::size_t b = 0; b < 2; ++b) {
    const auto fit = gyroscope_still(recorded.boards[b].parts(), nominal.boards[b]);
    ASSERT_TRUE(fit) << fit.error().text;
    EXPECT_EQ(fit->slope, nominal.boards[b].gyro_slope);
    for (Eigen::Index i = 0; i < 3; ++i) {
      // A hundredth of a code is 0.16 degrees/s.
      EXPECT_NEAR(fit->zero[i],
                  32.0 + recorded.sensors[b].gyro_bias()[i] / nominal.boards[b].gyro_slope[i],
                  0.01);
    }
  }
  EXPECT_FALSE(gyroscope_still({}, nominal.boards[0]));
}

struct Placements {
  std::vector<PlacementArrivals> arrivals;
  std::vector<KnownSourceDistance> known;
  std::vector<sim::Transducer> transducers;
};

Placements place(const Garment& garment, std::size_t count, double temperature_error) {
  Placements placements;
  for (std::size_t p = 0; p < count; ++p) {
    const sim::StandScene scene(garment, sim::WornErrors::none(), p);
    sim::SignalOptions options;
    options.faults.temperature_error = temperature_error;
    sim::GarmentSignal signal(scene, 11, options);
    placements.transducers = signal.transducers();
    placements.arrivals.emplace_back(garment.sources.size(), garment.boards.size());
    receive(scene, signal, [&](const wire::GarmentSlot& slot, const BoardSignals& signals) {
      placements.arrivals.back().add(*slot.source, signals.arrivals());
    });
    for (std::size_t s = 0; s < garment.sources.size(); ++s) {
      for (std::size_t b = 0; b < garment.boards.size(); ++b) {
        placements.known.push_back({p, s, b, scene.distance(s, b)});
      }
    }
  }
  return placements;
}

TEST(SourceOffsets, LeaveOneOutErrorIsBelowThePapers) {
  const Garment garment = garment_of(3);
  const auto placements = place(garment, 4, 0.0);
  const auto offsets = solve_source_offsets(garment, placements.arrivals, placements.known, 20.0);
  ASSERT_TRUE(offsets) << offsets.error().text;
  EXPECT_EQ(offsets->unheard, 0U);
  EXPECT_LT(offsets->left_out_mean, 2.35e-3);  // 4.3: 2.35 +- 1.92 mm
  EXPECT_LT(offsets->left_out_sd, 1.92e-3);
  EXPECT_NEAR(offsets->implied_temperature, 20.0, 4.0);
  // The offsets tell how late each source starts, up to what all pulses have in common.
  double mean = 0.0;
  for (std::size_t s = 0; s < garment.sources.size(); ++s) {
    mean += (offsets->sources[s].calibration.offset - placements.transducers[s].start_samples) / 8;
  }
  for (std::size_t s = 0; s < garment.sources.size(); ++s) {
    EXPECT_NEAR(offsets->sources[s].calibration.offset,
                placements.transducers[s].start_samples + mean, 3.0);
  }
}

TEST(SourceOffsets, DistancesTellAWrongTemperature) {
  const Garment garment = garment_of(3);
  const auto placements = place(garment, 3, 15.0);
  const auto offsets = solve_source_offsets(garment, placements.arrivals, placements.known, 20.0);
  ASSERT_TRUE(offsets) << offsets.error().text;
  EXPECT_NEAR(offsets->implied_temperature, 35.0, 5.0);
  EXPECT_LT(offsets->implied_sigma, 4.0);
}

TEST(SourceOffsets, RefusalNamesSourcesWithoutDistances) {
  const Garment garment = garment_of(2);
  auto placements = place(garment, 2, 0.0);
  std::erase_if(placements.known, [](const auto& k) { return k.source == 3 && k.placement == 1; });
  const auto offsets = solve_source_offsets(garment, placements.arrivals, placements.known, 20.0);
  ASSERT_FALSE(offsets);
  EXPECT_THAT(offsets.error().text, testing::HasSubstr("waist_left (1)"));
  EXPECT_THAT(offsets.error().text, testing::Not(testing::HasSubstr("hat (")));
}

TEST(WearableCalibrationFile, ComesBackAsItWasWritten) {
  const Garment garment = garment_of(18);
  auto calibration = WearableCalibration::nominal(garment);
  calibration.temperature = 23.5;
  calibration.sources[2] = {37.25, 1.5e7};
  calibration.boards[17].gyro_zero = {31.5, 32.25, 33.0};
  calibration.boards[17].accel_slope = {0.9, 0.91, -0.92};
  const auto file = std::filesystem::path(testing::TempDir()) / "wearable_calibration_test.toml";
  calibration.save(file, garment);
  const auto back = WearableCalibration::load(file, garment);
  EXPECT_EQ(back.temperature, 23.5);
  EXPECT_EQ(back.sources[2].offset, 37.25);
  EXPECT_EQ(back.sources[2].strength, 1.5e7);
  EXPECT_EQ(back.boards[17].gyro_zero, calibration.boards[17].gyro_zero);
  EXPECT_EQ(back.boards[17].accel_slope, calibration.boards[17].accel_slope);
  EXPECT_NEAR(back.boards[3].gyro_slope.x(), calibration.boards[3].gyro_slope.x(), 1e-6);

  Garment other = garment;
  other.name = "another";
  EXPECT_THROW(WearableCalibration::load(file, other), std::runtime_error);
  std::ofstream(file) << "garment = \"practical\"\ntemperature = 20.0\n[[source]]\nname = "
                         "\"belly\"\noffset = 1e9\nstrength = 1.0\n";
  try {
    (void)WearableCalibration::load(file, garment);
    FAIL() << "an offset of 1e9 samples was read";
  } catch (const std::runtime_error& error) {
    EXPECT_THAT(error.what(), testing::HasSubstr(":5: offset"));
  }
}

TEST(SourceDistances, AreReadByName) {
  const Garment garment = garment_of(18);
  const auto file = std::filesystem::path(testing::TempDir()) / "wearable_distances_test.csv";
  std::ofstream(file)
      << "placement,source,board,distance_m\n0,hat,chest,0.45\n1,belly,pelvis,0.9\n";
  const auto known = read_source_distances(file, garment);
  ASSERT_EQ(known.size(), 2U);
  EXPECT_EQ(known[0].source, 7U);
  EXPECT_EQ(known[0].board, 2U);
  EXPECT_EQ(known[1].distance, 0.9);
  std::ofstream(file) << "placement,source,board,distance_m\n0,hat,chest,45\n";
  try {
    (void)read_source_distances(file, garment);
    FAIL() << "45 m were read";
  } catch (const std::runtime_error& error) {
    EXPECT_THAT(error.what(), testing::HasSubstr(":2: 45 m"));
  }
}

}  // namespace
}  // namespace secondskin::server
