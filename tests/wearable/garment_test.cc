#include "motion/garment.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <fstream>

namespace secondskin {
namespace {

namespace fs = std::filesystem;

const fs::path kSource = SECONDSKIN_SOURCE_DIR;

TEST(Garment, ThePapersHasEighteenBoardsAndEightSources) {
  const Garment garment = Garment::load(kSource / "garments/practical.toml");
  EXPECT_EQ(garment.boards.size(), 18U);    // Practical Motion Capture, 3.1
  EXPECT_EQ(garment.sources.size(), 8U);    // the same
  EXPECT_DOUBLE_EQ(garment.slot(), 0.008);  // 4.1: 1120 samples, 2.75 m of sound
  EXPECT_NEAR(garment.slot() * 343.0, 2.75, 0.01);
}

TEST(Garment, BoardsLookAwayFromTheBodyAndSourcesWhereTheySay) {
  const Garment garment = Garment::load(kSource / "garments/practical.toml");
  const Skeleton body = canonical_skeleton();
  for (const SensorBoard& board : garment.boards) {
    const Eigen::Isometry3d X_BS = board_place(body, board);
    const SkinPlace place = skin_place(body, board.segment, board.along, board.angle);
    EXPECT_LT((X_BS.translation() - place.p_BS).norm(), 1e-12) << board.name;
    EXPECT_LT((X_BS.linear().col(2) - place.n_B).norm(), 1e-12) << board.name;
    EXPECT_NEAR(X_BS.linear().determinant(), 1.0, 1e-12) << board.name;
  }
  for (const UltrasonicSource& source : garment.sources) {
    const Eigen::Vector3d forward =
        source.name == "hat" ? -Eigen::Vector3d::UnitZ().eval() : Eigen::Vector3d::UnitX().eval();
    EXPECT_LT((source_place(body, source).linear().col(2) - forward).norm(), 1e-12) << source.name;
  }
}

class GarmentFile : public ::testing::Test {
 protected:
  std::string error_of(const std::string& from, const std::string& to) {
    std::ifstream in(kSource / "garments/practical.toml");
    std::string text{std::istreambuf_iterator<char>(in), {}};
    text.replace(text.find(from), from.size(), to);
    std::ofstream(file_) << text;
    try {
      (void)Garment::load(file_);
    } catch (const std::runtime_error& error) {
      return error.what();
    }
    return {};
  }
  ~GarmentFile() override { fs::remove(file_); }
  fs::path file_ =
      fs::temp_directory_path() / ("garment_test_" + std::to_string(::getpid()) + ".toml");
};

TEST_F(GarmentFile, RefusalsNameFileAndField) {
  using ::testing::AllOf;
  using ::testing::HasSubstr;
  const std::string name = file_.filename();
  EXPECT_THAT(error_of("name = \"head\"", "name = \"chest\""),
              AllOf(HasSubstr(name), HasSubstr("name")));
  EXPECT_THAT(error_of("segment = \"head\"", "segment = \"hat\""),
              AllOf(HasSubstr(name), HasSubstr("segment")));
  EXPECT_THAT(error_of("carrier_hz = 40000", "carrier_hz = 90000"), HasSubstr("carrier_hz"));
  EXPECT_THAT(error_of("slot_samples = 1120", "slot_samples = 0"), HasSubstr("slot_samples"));
  EXPECT_THAT(error_of("along = 0.5", "along = 1.5"), HasSubstr("along"));
  EXPECT_THAT(error_of("facing = [1.0, 0.0, 0.0]", "facing = [0.0, 0.0, 0.0]"),
              HasSubstr("facing"));
  EXPECT_THAT(error_of("standoff = 0.08", "stand_off = 0.08"), HasSubstr("stand_off"));
}

}  // namespace
}  // namespace secondskin
