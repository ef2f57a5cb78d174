#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <numbers>

#include "server/wearable/csv/csv_stream.h"

namespace secondskin::server {
namespace {

namespace fs = std::filesystem;
using ::testing::AllOf;
using ::testing::HasSubstr;

constexpr double kDegree = std::numbers::pi / 180.0;
const fs::path kSource(SECONDSKIN_SOURCE_DIR);

class CsvTest : public ::testing::Test {
 protected:
  CsvTest() {
    folder_ =
        fs::path(::testing::TempDir()) /
        ("csv_" + std::string(::testing::UnitTest::GetInstance()->current_test_info()->name()));
    fs::create_directories(folder_);
  }
  ~CsvTest() override { fs::remove_all(folder_); }

  fs::path write(const std::string& name, const std::string& text) {
    std::ofstream(folder_ / name) << text;
    return folder_ / name;
  }
  CsvStream open(const std::string& table, const std::string& mapping) {
    const fs::path file = write("table.csv", table);
    write("table.toml", mapping);
    return {file, CsvMapping::load(mapping_beside(file))};
  }
  /// What opening or reading it says.
  std::string trouble(const std::string& table, const std::string& mapping) {
    try {
      CsvStream stream = open(table, mapping);
      Measurement m;
      while (stream.next(m) == Next::kPose) {
      }
    } catch (const std::runtime_error& error) {
      return error.what();
    }
    return "";
  }

  fs::path folder_;
};

const std::string kMapping = R"(name = "test"
time = "t"
gyro_unit = "deg/s"
accel_unit = "g"
gyro_range_deg = 500
[[board]]
name = "thigh"
segment = "left_hip"
gyro = ["gx", "-gz", "gy"]
accel = ["ax", "ay", "az"]
)";
const std::string kHeader = "t,gx,gy,gz,ax,ay,az\n";

TEST_F(CsvTest, ConvertsUnitsAndTurnsAxesAsTheMappingSays) {
  auto stream = open(kHeader + "10.0,90,1,2,0.5,0,-1\n10.01,0,0,0,0,0,1\n", kMapping);
  EXPECT_NEAR(stream.garment().inertial_rate_hz, 100.0, 1e-6);
  Measurement m;
  ASSERT_EQ(stream.next(m), Next::kPose);
  EXPECT_EQ(m.stamp_ns, 10'000'000'000);
  ASSERT_EQ(m.boards.size(), 1u);
  EXPECT_TRUE(m.boards[0].gyro_valid && m.boards[0].accel_valid);
  EXPECT_FALSE(m.boards[0].magnetic_valid);
  EXPECT_LT((m.boards[0].gyro - Eigen::Vector3d(90, -2, 1) * kDegree).norm(), 1e-12);
  EXPECT_LT((m.boards[0].accel - Eigen::Vector3d(0.5, 0, -1) * 9.80665).norm(), 1e-12);
  ASSERT_EQ(stream.next(m), Next::kPose);
  EXPECT_EQ(stream.next(m), Next::kEnd);
  ASSERT_TRUE(stream.rewind());
  ASSERT_EQ(stream.next(m), Next::kPose);
  EXPECT_EQ(m.stamp_ns, 10'000'000'000);
}

TEST_F(CsvTest, GivesInvalidReadingsForWhatIsMissingAndCountsIt) {
  auto stream = open(kHeader +
                         "0.00,1,1,1,0,0,1\n"
                         "0.01,1,,1,0,0,1\n"       // no gyroscope
                         "0.02,1,1,1,0,NaN,1\n"    // no accelerometer
                         "0.03,1,1,499.9,0,0,1\n"  // saturated
                         "0.03,1,1,1,0,0,1\n"      // late
                         "0.06,1,1,1\n",           // two lost, and torn
                     kMapping);
  Measurement m;
  std::vector<std::pair<bool, bool>> valid;
  while (stream.next(m) == Next::kPose) {
    valid.emplace_back(m.boards[0].gyro_valid, m.boards[0].accel_valid);
  }
  EXPECT_THAT(valid, ::testing::ElementsAre(std::pair(true, true), std::pair(false, true),
                                            std::pair(true, false), std::pair(false, true),
                                            std::pair(true, false)));
  EXPECT_EQ(stream.counts().missing, 3u);
  EXPECT_EQ(stream.counts().saturated, 1u);
  EXPECT_EQ(stream.counts().late, 1u);
  EXPECT_EQ(stream.counts().gaps, 2u);
}

TEST_F(CsvTest, NamesFileLineAndColumnOfWhatIsWrong) {
  EXPECT_THAT(trouble(kHeader + "0,1,1,1,0,0,1\n0.01,1,1,fast,0,0,1\n", kMapping),
              AllOf(HasSubstr("table.csv:3"), HasSubstr("column 4 (gz)"),
                    HasSubstr("expected a number, found 'fast'")));
  EXPECT_THAT(trouble("t,gx,gy,ax,ay,az\n0,1,1,0,0,1\n", kMapping),
              AllOf(HasSubstr("table.csv:1"), HasSubstr("no column 'gz'"), HasSubstr("t, gx, gy")));
  EXPECT_THAT(trouble(kHeader + "0,1,1,1\n0.01,1,1,1\n", kMapping),
              AllOf(HasSubstr("table.csv:2"), HasSubstr("expected 7 columns")));
  EXPECT_THAT(trouble(kHeader, kMapping), HasSubstr("times that grow"));
  EXPECT_THAT(trouble(kHeader + "0,1,1,1,0,0,1\n,1,1,1,0,0,1\n", "rate_hz = 100\n" + kMapping),
              AllOf(HasSubstr("table.csv:3"), HasSubstr("expected a time")));
}

TEST_F(CsvTest, NamesFileLineAndFieldOfAMappingThatIsWrong) {
  const auto with = [&](const std::string& from, const std::string& to) {
    std::string mapping = kMapping;
    mapping.replace(mapping.find(from), from.size(), to);
    return trouble(kHeader + "0,1,1,1,0,0,1\n0.01,1,1,1,0,0,1\n", mapping);
  };
  EXPECT_THAT(with("deg/s", "rpm"),
              AllOf(HasSubstr("table.toml:3"), HasSubstr("gyro_unit"), HasSubstr("deg/s, rad/s")));
  EXPECT_THAT(with("time = \"t\"\n", ""), HasSubstr("rate_hz: missing"));
  EXPECT_THAT(with("left_hip", "left_thigh"), HasSubstr("segment: expected a canonical joint"));
  EXPECT_THAT(with("\"gy\"]", "]"), HasSubstr("gyro: expected 3 columns"));
  EXPECT_THAT(with("accel = ", "acceleration = "), HasSubstr("acceleration: unknown"));
}

TEST_F(CsvTest, KnowsABoardByWhereItsAxesPoint) {
  auto stream =
      open(kHeader + "0,1,1,1,0,0,1\n1,1,1,1,0,0,1\n", kMapping + "front = \"-z\"\nup = \"x\"\n");
  const auto& q_BS = stream.mapping().boards[0].q_BS;
  ASSERT_TRUE(q_BS);
  EXPECT_LT((*q_BS * Eigen::Vector3d(0, 0, -1) - Eigen::Vector3d::UnitX()).norm(), 1e-12);
  EXPECT_LT((*q_BS * Eigen::Vector3d(1, 0, 0) - Eigen::Vector3d::UnitZ()).norm(), 1e-12);
  EXPECT_NEAR(q_BS->toRotationMatrix().determinant(), 1.0, 1e-12);
}

TEST_F(CsvTest, ReadsColumnsByNumberWhereThereIsNoHeader) {
  auto stream = open("1;2;3;0;0;9.8\n4;5;6;0;0;9.8\n", R"(name = "plain"
separator = ";"
header_rows = 0
rate_hz = 50
gyro_unit = "rad/s"
accel_unit = "m/s2"
[[board]]
name = "thigh"
segment = "left_hip"
gyro = [1, 2, -3]
accel = [4, 5, 6]
)");
  Measurement m;
  ASSERT_EQ(stream.next(m), Next::kPose);
  ASSERT_EQ(stream.next(m), Next::kPose);
  EXPECT_EQ(m.stamp_ns, 20'000'000);
  EXPECT_LT((m.boards[0].gyro - Eigen::Vector3d(4, 5, -6)).norm(), 1e-12);
}

// Standing feet feel gravity and nearly no turning.
TEST(RealTables, GaitmapIsReadByItsMapping) {
  CsvStream stream(kSource / "tests/data/imu/gaitmap/imu_head.csv",
                   CsvMapping::load(kSource / "garments/csv/gaitmap.toml"));
  Measurement m;
  std::size_t rows = 0;
  for (; stream.next(m) == Next::kPose; ++rows) {
    ASSERT_EQ(m.boards.size(), 2u);
    for (const BoardReading& board : m.boards) {
      EXPECT_NEAR(board.accel.norm(), 9.81, 0.3);
      EXPECT_LT(board.gyro.norm(), 2.0 * kDegree);
    }
  }
  EXPECT_EQ(rows, 60u);
  EXPECT_EQ(m.stamp_ns, std::llround(59e9 / 204.8));
  EXPECT_EQ(stream.counts().missing + stream.counts().gaps, 0u);
}

TEST(RealTables, QmtIsReadByItsMapping) {
  CsvStream stream(kSource / "tests/data/imu/qmt/right_arm_first14s.csv.gz",
                   CsvMapping::load(kSource / "garments/csv/qmt_right_arm.toml"));
  EXPECT_NEAR(stream.garment().inertial_rate_hz, 100.0, 1e-6);
  Measurement m;
  std::size_t rows = 0;
  for (; stream.next(m) == Next::kPose; ++rows) {
    ASSERT_EQ(m.boards.size(), 4u);
    ASSERT_TRUE(stream.orientations()[3]);
  }
  EXPECT_EQ(rows, 1400u);
  EXPECT_EQ(stream.counts().missing + stream.counts().gaps, 0u);
}

}  // namespace
}  // namespace secondskin::server
