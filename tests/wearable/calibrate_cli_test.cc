#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <array>
#include <cstdio>
#include <filesystem>
#include <fstream>

#include "server/wearable/signal/wearable_calibration.h"
#include "sim/wearable/calibration_scenes.h"
#include "sim/wearable/virtual_garment.h"

namespace secondskin {
namespace {

namespace fs = std::filesystem;

struct Ran {
  int status;
  std::string output;
};

Ran run(const std::string& arguments) {
  FILE* pipe = ::popen((std::string(SECONDSKIN_PROGRAM) + " " + arguments + " 2>&1").c_str(), "r");
  Ran ran{-1, {}};
  std::array<char, 512> line{};
  while (std::fgets(line.data(), line.size(), pipe) != nullptr) ran.output += line.data();
  ran.status = ::pclose(pipe);
  return ran;
}

TEST(CalibrateWearable, RecordingsBecomeOneCalibrationFile) {
  const fs::path folder = fs::path(testing::TempDir()) / "calibrate_wearable";
  fs::create_directories(folder);
  const fs::path out = folder / "practical.toml";
  fs::remove(out);
  const Garment garment =
      Garment::load(fs::path(SECONDSKIN_SOURCE_DIR) / "garments" / "practical.toml");

  // Sources: two placements, a recording each.
  std::ofstream table(folder / "table.csv");
  table << "placement,source,board,distance_m\n";
  std::vector<sim::Transducer> transducers;
  for (std::size_t p = 0; p < 2; ++p) {
    const sim::StandScene scene(garment, sim::WornErrors::none(), p);
    sim::GarmentSignal signal(scene, 3);
    transducers = signal.transducers();
    sim::write_garment_file(signal, 125, folder / fmt::format("stands{}.garment", p));
    for (const auto& source : garment.sources) {
      const auto s = static_cast<std::size_t>(&source - garment.sources.data());
      table << fmt::format("{},{},chest,{:.4f}\n", p, source.name, scene.distance(s, 2));
    }
  }
  table.close();
  const auto sources = run(
      fmt::format("calibrate wearable sources {0}/stands0.garment {0}/stands1.garment --distances "
                  "{0}/table.csv --out {1}",
                  folder.string(), out.string()));
  ASSERT_EQ(sources.status, 0) << sources.output;
  EXPECT_THAT(sources.output, testing::HasSubstr("leave-one-out error"));

  // Accelerometers: too few poses are refused, and nothing is lost.
  {
    const sim::BenchScene scene(garment, sim::WornErrors::none(), sim::still_poses(6, 1));
    sim::GarmentSignal signal(scene, 3);
    sim::write_garment_file(signal, signal.slots(), folder / "few.garment");
  }
  const auto few = run(fmt::format("calibrate wearable accelerometers {}/few.garment --out {}",
                                   folder.string(), out.string()));
  EXPECT_NE(few.status, 0);
  EXPECT_THAT(few.output, testing::HasSubstr("pelvis: 6 still poses that differ, 9 are needed"));

  // Gyroscopes: their zeros, beside the offsets.
  sim::WornErrors errors = sim::WornErrors::none();
  errors.gyro_bias = 0.05;
  const sim::BenchScene scene(garment, errors, sim::still_poses(1, 1, 5.0));
  sim::GarmentSignal signal(scene, 3);
  sim::write_garment_file(signal, signal.slots(), folder / "still.garment");
  const auto still =
      run(fmt::format("calibrate wearable gyroscopes {}/still.garment --still --out {}",
                      folder.string(), out.string()));
  ASSERT_EQ(still.status, 0) << still.output;
  const auto calibration = server::WearableCalibration::load(out, garment);
  for (std::size_t b = 0; b < garment.boards.size(); ++b) {
    const auto& board = calibration.boards[b];
    for (Eigen::Index i = 0; i < 3; ++i) {
      EXPECT_NEAR(board.gyro_zero[i],
                  32.0 + signal.sensors()[b].gyro_bias()[i] / board.gyro_slope[i], 0.02);
    }
  }
  EXPECT_NEAR(calibration.sources[0].offset - calibration.sources[4].offset,
              transducers[0].start_samples - transducers[4].start_samples, 4.0);

  const auto none = run("calibrate wearable sources nothing.garment --distances " +
                        (folder / "table.csv").string());
  EXPECT_NE(none.status, 0);
}

}  // namespace
}  // namespace secondskin
