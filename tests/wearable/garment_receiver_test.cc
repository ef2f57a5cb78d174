#include "server/wearable/signal/garment_receiver.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <atomic>
#include <filesystem>
#include <fstream>
#include <thread>

#include "sim/wearable/calibration_scenes.h"
#include "sim/wearable/virtual_garment.h"
#include "wire/pseudo_terminal.h"
#include "wire/tcp_listener.h"

namespace secondskin::server {
namespace {

namespace fs = std::filesystem;
constexpr std::int64_t kStart = 1'700'000'000'000'000'000;

Garment garment_of(std::size_t boards) {
  Garment garment = Garment::load(fs::path(SECONDSKIN_SOURCE_DIR) / "garments" / "practical.toml");
  garment.boards.resize(boards);
  return garment;
}

sim::SignalOptions options_of(std::int64_t start_ns = kStart) {
  sim::SignalOptions options;
  options.start_ns = start_ns;
  return options;
}

std::vector<Measurement> all_of(GarmentReceiver& receiver) {
  std::vector<Measurement> all;
  Measurement measurement;
  for (Next next = receiver.next(measurement); next != Next::kEnd;
       next = receiver.next(measurement)) {
    if (next == Next::kPose) all.push_back(measurement);
  }
  return all;
}

class Receiver : public testing::Test {
 protected:
  fs::path record(const sim::GarmentScene& scene, const sim::SignalOptions& options,
                  std::uint32_t slots) {
    const fs::path file =
        fs::path(testing::TempDir()) /
        (std::string("receiver_") + testing::UnitTest::GetInstance()->current_test_info()->name() +
         ".garment");
    sim::GarmentSignal signal(scene, 4, options);
    sim::write_garment_file(signal, slots, file);
    return file;
  }
  Garment garment_ = garment_of(3);
  WearableCalibration nominal_ = WearableCalibration::nominal(garment_);
};

TEST_F(Receiver, FileGivesInertialSetsAndDistancesWithTheirStamps) {
  const sim::StandScene scene(garment_, sim::WornErrors::none(), 1, 10.0);
  GarmentReceiver receiver(record(scene, options_of(), 400), garment_, nominal_);
  EXPECT_FALSE(receiver.live());
  const auto all = all_of(receiver);
  std::size_t inertial = 0, distances = 0, good = 0;
  std::int64_t last_inertial = 0, last_pulse = 0;
  for (const auto& m : all) {
    if (m.kind == MeasurementKind::kInertial) {
      ++inertial;
      if (last_inertial != 0) {
        EXPECT_NEAR(static_cast<double>(m.stamp_ns - last_inertial), 1e9 / 140.0, 50'000);
      }
      last_inertial = m.stamp_ns;
      for (const auto& board : m.boards) {
        ASSERT_TRUE(board.gyro_valid && board.accel_valid);
        // It stands still: facing sources, x down or so; half a code either side and the rounding.
        EXPECT_NEAR(board.accel.norm(), 9.81, 1.6);
        EXPECT_LT(board.gyro.cwiseAbs().maxCoeff(), 0.3);
      }
    } else {
      EXPECT_EQ(m.source, distances % garment_.sources.size());
      EXPECT_EQ(m.stamp_ns, kStart + static_cast<std::int64_t>(distances) * 8'000'000);
      last_pulse = m.stamp_ns;
      ++distances;
      for (std::size_t b = 0; b < 3; ++b) {
        if (m.distances[b].confidence < 0.5) continue;
        ++good;
        // Nominal offsets: sources start within some samples of it.
        EXPECT_NEAR(m.distances[b].distance, scene.distance(m.source, b), 0.02);
      }
    }
  }
  EXPECT_EQ(distances, 400U);
  EXPECT_NEAR(static_cast<double>(inertial), 3.2 * 140.0, 3.0);
  EXPECT_GT(good, 900U);
  EXPECT_GT(last_pulse, 0);
  const auto health = receiver.measurements().signals().health(0);
  EXPECT_TRUE(health.locked);
  EXPECT_EQ(health.inertial.locks, 1U);
  EXPECT_LE(health.inertial.lost, 2U);
  EXPECT_GT(receiver.measurements().signal_strength(0), 0.1);

  ASSERT_TRUE(receiver.rewind());
  const auto again = all_of(receiver);
  ASSERT_EQ(again.size(), all.size());
  EXPECT_EQ(again.back().stamp_ns, all.back().stamp_ns);
}

TEST_F(Receiver, SilentBoardIsMissingAndTheOthersGoOn) {
  const sim::StandScene scene(garment_, sim::WornErrors::none(), 1, 10.0);
  auto options = options_of();
  options.faults.silent.push_back({1, 1.0, 2.0});
  GarmentReceiver receiver(record(scene, options, 400), garment_, nominal_);
  std::size_t missing = 0, heard = 0;
  for (const auto& m : all_of(receiver)) {
    const double t = 1e-9 * static_cast<double>(m.stamp_ns - kStart);
    if (m.kind == MeasurementKind::kInertial) {
      EXPECT_TRUE(m.boards[0].gyro_valid && m.boards[2].gyro_valid);
      missing += m.boards[1].gyro_valid ? 0 : 1;
      EXPECT_TRUE(m.boards[1].gyro_valid || (t > 0.98 && t < 2.03)) << t;
    } else if (t > 1.0 && t < 1.99) {
      heard += m.distances[1].confidence > 0.0 ? 1 : 0;
    }
  }
  EXPECT_NEAR(static_cast<double>(missing), 140.0, 5.0);
  EXPECT_EQ(heard, 0U);
  EXPECT_EQ(receiver.measurements().signals().health(1).inertial.locks, 2U);
}

TEST_F(Receiver, BurstOfBitErrorsLosesSamplesAndGivesNoWrongOne) {
  const sim::StandScene scene(garment_, sim::WornErrors::none(), 1, 10.0);
  auto options = options_of();
  options.faults.bit_errors.push_back({0, 0.5, 2.5});
  options.faults.gain.push_back({2, 1.0, 1.5});
  GarmentReceiver receiver(record(scene, options, 400), garment_, nominal_);
  std::size_t missing = 0, distances = 0;
  for (const auto& m : all_of(receiver)) {
    const double t = 1e-9 * static_cast<double>(m.stamp_ns - kStart);
    if (m.kind == MeasurementKind::kDistances) {
      distances += t > 0.6 && t < 2.4 && m.distances[0].confidence > 0.5 ? 1 : 0;
      continue;
    }
    EXPECT_TRUE(m.boards[1].gyro_valid);
    missing += m.boards[0].gyro_valid ? 0 : 1;
    for (const auto& board : m.boards) {
      if (!board.accel_valid) continue;
      EXPECT_NEAR(board.accel.norm(), 9.81, 1.6);
    }
  }
  EXPECT_GT(missing, 100U);
  EXPECT_LT(missing, 290U);
  EXPECT_GT(distances, 100U);  // the noise is in the digital stream's band, not in the sources'
  EXPECT_GT(receiver.measurements().signals().health(2).clipped, 1000U);
  EXPECT_TRUE(receiver.measurements().signals().health(0).locked);
}

TEST_F(Receiver, LostSlotsCostTheirSamplesOnly) {
  const sim::StandScene scene(garment_, sim::WornErrors::none(), 1, 10.0);
  const fs::path file = record(scene, options_of(), 300);
  // Cut some slots out of the middle, not on a block's edge.
  std::ifstream in(file, std::ios::binary);
  std::string bytes(std::istreambuf_iterator<char>(in), {});
  bytes.erase(bytes.size() / 2 + 777, 20'000);
  std::ofstream(file, std::ios::binary) << bytes;
  GarmentReceiver receiver(file, garment_, nominal_);
  std::size_t inertial = 0;
  std::int64_t last = 0;
  for (const auto& m : all_of(receiver)) {
    if (m.kind != MeasurementKind::kInertial) continue;
    ++inertial;
    if (last != 0) {
      const double periods = static_cast<double>(m.stamp_ns - last) * 140.0 * 1e-9;
      EXPECT_NEAR(periods, std::round(periods), 0.01);
    }
    last = m.stamp_ns;
  }
  const auto& counters = receiver.slots().counters();
  EXPECT_EQ(counters.lost + counters.slots, 300U);
  EXPECT_GE(counters.lost, 3U);
  EXPECT_LE(counters.lost, 5U);
  EXPECT_GT(inertial, 324U);
  EXPECT_EQ(receiver.measurements().signals().health(0).inertial.locks, 1U);
}

TEST_F(Receiver, TellsWhatOfAStreamIsGarbled) {
  const sim::StandScene scene(garment_, sim::WornErrors::none(), 1, 1.0);
  const fs::path file = record(scene, options_of(), 40);
  GarmentReceiver whole(file, garment_, nominal_);
  (void)all_of(whole);
  EXPECT_EQ(whole.trouble(), "");
  {
    std::fstream bytes(file, std::ios::in | std::ios::out | std::ios::binary);
    bytes.seekp(static_cast<std::streamoff>(fs::file_size(file) / 2));
    bytes.write("overwritten", 11);
  }
  GarmentReceiver torn(file, garment_, nominal_);
  (void)all_of(torn);
  EXPECT_THAT(torn.trouble(), testing::HasSubstr("of " + file.string() + ", 39 slots came whole"));
}

TEST_F(Receiver, SaturatedReadingsAreNotValid) {
  // A turntable faster than the gyroscopes can tell.
  const sim::BenchScene scene(garment_, sim::WornErrors::none(), sim::six_turns(10.0, 1.0));
  GarmentReceiver receiver(record(scene, options_of(), 600), garment_, nominal_);
  std::size_t invalid = 0;
  for (const auto& m : all_of(receiver)) {
    if (m.kind != MeasurementKind::kInertial) continue;
    invalid += m.boards[0].gyro_valid ? 0 : 1;
    EXPECT_TRUE(m.boards[0].accel_valid);
  }
  EXPECT_GT(invalid, 100U);
  EXPECT_EQ(receiver.measurements().saturated_readings(0), invalid);
}

TEST_F(Receiver, RefusesAnotherGarmentsStreamAndWhatIsNoStream) {
  const sim::StandScene scene(garment_, sim::WornErrors::none(), 1, 1.0);
  const fs::path file = record(scene, options_of(), 20);
  const Garment other = garment_of(4);
  GarmentReceiver receiver(file, other, WearableCalibration::nominal(other));
  Measurement measurement;
  try {
    (void)receiver.next(measurement);
    FAIL() << "a stream of three boards was read as of four";
  } catch (const std::runtime_error& error) {
    EXPECT_THAT(error.what(), testing::HasSubstr("number of boards is 3"));
  }
  std::ofstream(file) << "not a garment";
  GarmentReceiver garbage(file, garment_, nominal_);
  EXPECT_THROW((void)garbage.next(measurement), std::runtime_error);
  EXPECT_THROW(GarmentReceiver("no such file.garment", garment_, nominal_), std::runtime_error);
  EXPECT_THROW(GarmentReceiver("localhost:x", garment_, nominal_), std::runtime_error);
  EXPECT_THROW(GarmentReceiver(file, other, nominal_), std::invalid_argument);
}

// Serves 0.8 s over a link, and collects what a receiver makes of it.
void expect_live(wire::ByteLink& link, const std::function<std::uint64_t()>& poll,
                 const std::string& place, const Garment& garment) {
  const sim::StandScene scene(garment, sim::WornErrors::none(), 1, 30.0);
  sim::GarmentSignal signal(scene, 4, options_of());
  GarmentReceiver receiver(place, garment, WearableCalibration::nominal(garment));
  EXPECT_TRUE(receiver.live());
  EXPECT_FALSE(receiver.rewind());
  std::stop_source stop;
  std::string trouble;
  std::thread box([&] {
    try {
      sim::serve_garment(signal, 100'000, link, poll, stop.get_token());
    } catch (const std::exception& error) {  // the machine is too busy
      trouble = error.what();
    }
  });
  std::size_t inertial = 0, distances = 0;
  Measurement measurement;
  for (int silences = 0; distances < 100 && silences < 40;) {
    const Next next = receiver.next(measurement);
    if (next == Next::kSilence) ++silences;
    if (next != Next::kPose) continue;
    ++(measurement.kind == MeasurementKind::kInertial ? inertial : distances);
  }
  stop.request_stop();
  box.join();
  if (!trouble.empty()) GTEST_SKIP() << trouble;
  EXPECT_EQ(distances, 100U);
  EXPECT_GT(inertial, 100U);
  EXPECT_TRUE(receiver.measurements().signals().health(0).locked);
  // Then nothing comes: told, and not an end.
  Next next = Next::kPose;
  for (int i = 0; i < 1000 && next == Next::kPose; ++i) next = receiver.next(measurement);
  EXPECT_EQ(next, Next::kSilence);
}

TEST_F(Receiver, PseudoTerminalGivesTheSameLive) {
  wire::PseudoTerminal terminal;
  expect_live(
      terminal, [] { return std::uint64_t{1}; }, terminal.path(), garment_);
}

TEST_F(Receiver, SocketGivesTheSameLive) {
  wire::TcpListener listener(0);
  expect_live(
      listener, [&] { return listener.poll() ? listener.openings() : 0; },
      "127.0.0.1:" + std::to_string(listener.port()), garment_);
}

TEST(TcpClient, StaysOnThisMachine) {
  const Garment garment = garment_of(3);
  const auto nominal = WearableCalibration::nominal(garment);
  for (const char* place : {"192.0.2.1:7000", "here:7000"}) {
    try {
      const GarmentReceiver receiver(place, garment, nominal);
      FAIL() << place << " was taken";
    } catch (const std::runtime_error& error) {
      EXPECT_THAT(error.what(), testing::HasSubstr(std::string(place) + "' is another machine"));
    }
  }
  EXPECT_THROW(GarmentReceiver("127.0.0.1.nowhere:7000", garment, nominal), std::invalid_argument);
}

}  // namespace
}  // namespace secondskin::server
