#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <fstream>
#include <random>

#include "server/optical/calibrate/grid_calibration.h"
#include "server/optical/calibrate/rough_layout.h"
#include "server/optical/calibrate/wand_calibration.h"

namespace secondskin::server {
namespace {

namespace fs = std::filesystem;
using testing::HasSubstr;

class CalibrationFile : public testing::Test {
 protected:
  CalibrationFile()
      : file_(fs::path(testing::TempDir()) /
              ("calibration_" + std::to_string(std::random_device{}()) + ".toml")) {}
  ~CalibrationFile() override { fs::remove(file_); }

  const fs::path& write(const std::string& text) {
    std::ofstream(file_) << text;
    return file_;
  }
  template <typename T>
  std::string complaint(const std::string& text) {
    try {
      T::load(write(text));
    } catch (const std::runtime_error& e) {
      EXPECT_THAT(e.what(), HasSubstr(file_.string()));
      return e.what();
    }
    return "(none)";
  }

  fs::path file_;
};

// 2.2.2: "two photodetectors located at (10,0,0) and (20,0,0) would be one inch apart ... The grid
// lies along the x-z plane ... raised 36 inches (360 units in the y-direction)".
TEST_F(CalibrationFile, GivesThePapersGridInMetresWithZUp) {
  const CalibrationGrid grid = CalibrationGrid::load(write(R"(
unit = "0.1in"
up = "y"
detectors = [[10, 0, 0], [20, 0, 0], [20, 0, 400], [20, 30, 0]]
heights = [0, 360]
)"));
  ASSERT_EQ(grid.p_W.size(), 4U);
  EXPECT_NEAR((grid.p_W[1] - grid.p_W[0]).norm(), 0.0254, 1e-12);
  EXPECT_NEAR((grid.p_W[1] - grid.p_W[0]).y(), 0.0254, 1e-12);
  EXPECT_NEAR((grid.p_W[2] - grid.p_W[1]).x(), 1.016, 1e-12);
  EXPECT_NEAR((grid.p_W[3] - grid.p_W[1]).z(), 0.0762, 1e-12);
  ASSERT_EQ(grid.heights.size(), 2U);
  EXPECT_NEAR(grid.heights[1], 0.9144, 1e-12);
}

TEST_F(CalibrationFile, GivesWhatIsShipped) {
  const fs::path objects = fs::path(SECONDSKIN_SOURCE_DIR) / "calibration_objects";
  const CalibrationGrid grid = CalibrationGrid::load(objects / "grid_4ft.toml");
  EXPECT_EQ(grid.p_W.size(), 12U);
  EXPECT_NEAR((grid.p_W.back() - grid.p_W.front()).norm(), std::sqrt(2.0) * 1.2192, 1e-9);
  EXPECT_FALSE(Wand::load(objects / "set_square.toml").on_a_line());
}

TEST_F(CalibrationFile, GivesAWand) {
  const Wand wand =
      Wand::load(write("unit = \"mm\"\nlying = [[0, 0, 20], [500, 0, 20], [0, 350, 25]]\n"));
  ASSERT_EQ(wand.lying_W.size(), 3U);
  EXPECT_NEAR((wand.lying_W[1] - Eigen::Vector3d(0.5, 0.0, 0.02)).norm(), 0.0, 1e-12);
  EXPECT_FALSE(wand.on_a_line());
  EXPECT_TRUE(Wand::load(write("unit = \"mm\"\nlying = [[0, 0, 20], [500, 0, 20]]\n")).on_a_line());
  EXPECT_TRUE(Wand::load(write("unit = \"m\"\nlying = [[0, 0, 0], [0.5, 0, 0], [0.2, 0.01, 0]]\n"))
                  .on_a_line());
}

TEST_F(CalibrationFile, GivesALayout) {
  const RoughLayout layout = RoughLayout::load(write(R"(
unit = "m"
[[projector]]
position = [3.3, 0, 1.2]
looks_at = [0, 0, 1.2]
rising_deg = 0
[[projector]]
position = [3.3, 0, 1.2]
looks_at = [0, 0, 1.2]
rising_deg = 90
)"));
  ASSERT_EQ(layout.places.size(), 2U);
  const ProjectorRig rig = layout.rig({});
  const NominalOptics optics;
  // On the axis the middle; seen from +x towards -x, right is +y.
  for (std::size_t i = 0; i < 2; ++i) {
    EXPECT_NEAR(rig.projectors[i]->value({0.0, 0.0, 1.2}), optics.middle, 1e-9);
  }
  EXPECT_NEAR(rig.projectors[0]->value({0.0, 0.33, 1.0}), optics.middle + 0.1 * optics.focal, 1e-9);
  EXPECT_NEAR(rig.projectors[1]->value({0.0, 0.33, 1.53}), optics.middle + 0.1 * optics.focal,
              1e-9);
}

TEST_F(CalibrationFile, NamesLineAndFieldOfWhatItDoesNotUnderstand) {
  EXPECT_THAT(complaint<Wand>("unit = \"m\"\nlying = [[0, 0, 0]\n"), HasSubstr(":2:"));
  EXPECT_THAT(complaint<Wand>("lying = [[0, 0, 0], [1, 0, 0]]\n"), HasSubstr("unit: expected"));
  EXPECT_THAT(complaint<Wand>("unit = \"yd\"\nlying = [[0, 0, 0], [1, 0, 0]]\n"),
              HasSubstr(":1: unit: expected"));
  EXPECT_THAT(complaint<Wand>("unit = \"m\"\n\nlying = [[0, 0, 0]]\n"),
              HasSubstr(":3: lying: expected a list of at least 2"));
  EXPECT_THAT(complaint<Wand>("unit = \"m\"\nlying = [[0, 0, 0], [1, 0]]\n"),
              HasSubstr("lying[1]: expected three numbers"));
  EXPECT_THAT(complaint<Wand>("unit = \"m\"\nlying = [[0, 0, 0], [1, nan, 0]]\n"),
              HasSubstr("lying[1]: expected a number"));
  EXPECT_THAT(complaint<Wand>("unit = \"m\"\nlying = [[0, 0, 0], [500, 0, 0]]\n"),
              HasSubstr("lying[1]: expected a number from -100 to 100"));
  EXPECT_THAT(complaint<Wand>("unit = \"m\"\nlying = [[0, 0, 0], [0, 0, 0]]\n"),
              HasSubstr("another place than lying[0]"));
  EXPECT_THAT(complaint<Wand>("unit = \"m\"\nlaying = [[0, 0, 0], [1, 0, 0]]\n"),
              HasSubstr("laying: expected one of unit, lying"));
  const std::string detectors = "detectors = [[0,0,0],[1,0,0],[0,1,0],[1,1,0]]\n";
  EXPECT_THAT(
      complaint<CalibrationGrid>("unit = \"m\"\nup = \"x\"\n" + detectors + "heights=[0]\n"),
      HasSubstr(R"(:2: up: expected "y" or "z")"));
  EXPECT_THAT(complaint<CalibrationGrid>("unit = \"m\"\nup = \"z\"\n" + detectors),
              HasSubstr("heights: expected"));
  EXPECT_THAT(
      complaint<CalibrationGrid>("unit = \"m\"\nup = \"z\"\n" + detectors + "heights=[\"a\"]\n"),
      HasSubstr("heights[0]: expected a number"));
  EXPECT_THAT(complaint<RoughLayout>("unit = \"m\"\n"), HasSubstr("projector: expected a list"));
  EXPECT_THAT(complaint<RoughLayout>("unit = \"m\"\n[[projector]]\nposition = [1, 2, 3]\n"),
              HasSubstr("projector 0: looks_at: expected a value"));
  EXPECT_THAT(complaint<RoughLayout>("unit = \"m\"\n[[projector]]\nposition = [0, 0, 3]\n"
                                     "looks_at = [0, 0, 1]\nrising_deg = 0\n"),
              HasSubstr("not straight above"));
  try {
    Wand::load(file_.string() + ".absent");
    FAIL();
  } catch (const std::runtime_error& e) {
    EXPECT_THAT(e.what(), HasSubstr(".absent"));
  }
}

}  // namespace
}  // namespace secondskin::server
