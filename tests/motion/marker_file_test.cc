#include "motion/marker_file.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>

#include "motion/c3d.h"
#include "motion/trc.h"
#include "motion/ui_prmd.h"

namespace secondskin {
namespace {

using testing::AllOf;
using testing::HasSubstr;

const std::filesystem::path kData = SECONDSKIN_SOURCE_DIR "/tests/data";
const std::filesystem::path kSquat = kData / "ui_prmd/m01_s01_e02_positions.txt.gz";
const std::filesystem::path kServe = kData / "c3d/kineticstoolkit/tennis_serve_first_40.c3d";

class MarkerFile : public testing::Test {
 protected:
  void SetUp() override {
    folder_ = std::filesystem::path(testing::TempDir()) /
              (std::string("secondskin_") +
               testing::UnitTest::GetInstance()->current_test_info()->name());
    std::filesystem::remove_all(folder_);
    std::filesystem::create_directories(folder_);
  }
  void TearDown() override { std::filesystem::remove_all(folder_); }

  std::filesystem::path folder_;
};

void expect_same(const MarkerMotion& a, const MarkerMotion& b, double tolerance) {
  EXPECT_EQ(a.names, b.names);
  EXPECT_EQ(a.rate_hz, b.rate_hz);
  ASSERT_EQ(a.frames.size(), b.frames.size());
  for (std::size_t f = 0; f < a.frames.size(); ++f) {
    ASSERT_EQ(a.frames[f].visible, b.frames[f].visible);
    for (std::size_t i = 0; i < a.names.size(); ++i) {
      if (!a.frames[f].visible[i]) continue;
      ASSERT_LT((a.frames[f].p_WM[i] - b.frames[f].p_WM[i]).norm(), tolerance);
    }
  }
}

TEST_F(MarkerFile, IsKnownByItsEnding) {
  for (const char* name : {"a.c3d", "A.C3D", "b/a.trc", "a.txt", "a.TXT.gz", "a.b.c3d"}) {
    EXPECT_TRUE(is_marker_file(name)) << name;
  }
  for (const char* name : {"a.bvh", "c3d", "a.gz", "a.c3d.gz", "a.c3d/b", ""}) {
    EXPECT_FALSE(is_marker_file(name)) << name;
  }
}

TEST_F(MarkerFile, OfEveryKindStandsZUp) {
  const std::filesystem::path walk = kData / "c3d/biomechzoo/HC002D06_frames_221_260.c3d";
  const std::filesystem::path variant = kData / "c3d/kineticstoolkit/format_variants/dec_int.c3d";
  write_markers(read_markers(kSquat), folder_ / "squat.trc");
  struct Case {
    std::filesystem::path file;
    const char *high, *low;
  };
  for (const Case& c :
       {Case{walk, "LASI", "LHEE"}, Case{kServe, "LFHD", "LHEE"}, Case{variant, "RTA1", "RFT1"},
        Case{kSquat, "LFHD", "LHEE"}, Case{folder_ / "squat.trc", "LFHD", "LHEE"}}) {
    const MarkerMotion motion = read_markers(c.file);
    const MarkerFrame& frame = motion.frames[20];
    const std::size_t high = motion.find(c.high).value(), low = motion.find(c.low).value();
    ASSERT_TRUE(frame.visible[high] && frame.visible[low]);
    EXPECT_GT(frame.p_WM[high].z() - frame.p_WM[low].z(), 0.4) << c.file;
    EXPECT_GT(frame.p_WM[low].z(), -0.1) << c.file;
    EXPECT_LT(frame.p_WM[low].z(), 0.3) << c.file;
  }
}

// x = z', y = x', z = y', as retarget.cc turns a BVH file that is y up.
TEST_F(MarkerFile, IsTurnedByItsOwnAxisOrByTheOneThatIsSaid) {
  const Eigen::Vector3d native = read_c3d(kServe).markers.frames[0].p_WM[0];
  const Eigen::Vector3d turned(native.z(), native.x(), native.y());
  const auto first = [](const std::filesystem::path& file, std::optional<UpAxis> up = {}) {
    return read_markers(file, up).frames[0].p_WM[0];
  };
  EXPECT_EQ(first(kServe), native) << "z where the file says nothing";
  EXPECT_EQ(first(kServe, UpAxis::kY), turned);

  C3dFile content = read_c3d(kServe);
  const auto with_screen = [&](const char* axis) {
    content.set("POINT", {.name = "Y_SCREEN", .dimensions = {2}, .values = std::string(axis)});
    write_c3d(content, folder_ / "a.c3d", C3dProcessor::kIntel, C3dStorage::kReal);
    return folder_ / "a.c3d";
  };
  EXPECT_LT((first(with_screen("+Y")) - turned).norm(), 1e-6);
  EXPECT_LT((first(with_screen("+Z")) - native).norm(), 1e-6);
  EXPECT_LT((first(with_screen("  ")) - native).norm(), 1e-6);
  EXPECT_LT((first(with_screen("+Y"), UpAxis::kZ) - native).norm(), 1e-6);
  EXPECT_LT((first(with_screen("-Z"), UpAxis::kZ) - native).norm(), 1e-6);
  try {
    first(with_screen("-Z"));
    FAIL() << "upside down";
  } catch (const MarkerFileError& error) {
    EXPECT_THAT(error.what(), AllOf(HasSubstr("a.c3d: POINT:Y_SCREEN"), HasSubstr("\"-Z\"")));
  }
}

TEST_F(MarkerFile, KeepsItsMarkersWhicheverKindItIsWrittenAs) {
  const MarkerMotion squat = read_markers(kSquat);
  const MarkerMotion gaps = read_markers(kData / "ui_prmd/m07_s04_e01_positions_inc.txt.gz");
  for (const MarkerMotion& motion : {squat, gaps}) {
    write_markers(motion, folder_ / "a.c3d");
    expect_same(motion, read_markers(folder_ / "a.c3d"), 1e-6);
    write_markers(motion, folder_ / "a.trc");
    expect_same(motion, read_markers(folder_ / "a.trc"), 1e-7);
  }
  const C3dFile c3d = read_c3d(folder_ / "a.c3d");
  EXPECT_EQ(c3d.find("POINT", "Y_SCREEN")->strings().at(0), "+Z");
  EXPECT_EQ(c3d.find("POINT", "UNITS")->strings().at(0), "mm");
  EXPECT_EQ(c3d.processor, C3dProcessor::kIntel);
  EXPECT_EQ(c3d.storage, C3dStorage::kReal);
  // OpenSim's world is y up.
  const MarkerMotion trc = read_trc(folder_ / "a.trc");
  EXPECT_GT(trc.frames[0].p_WM[*trc.find("LFHD")].y(), 1.3);
}

TEST_F(MarkerFile, OfAnotherKindIsRefused) {
  const MarkerMotion motion = read_markers(kSquat);
  for (const char* name : {"a.bvh", "a.txt", "a"}) {
    EXPECT_THROW(write_markers(motion, folder_ / name), MarkerFileError) << name;
    EXPECT_FALSE(std::filesystem::exists(folder_ / name));
  }
  EXPECT_THROW(read_markers(folder_ / "a.bvh"), MarkerFileError);
  EXPECT_THROW(read_markers(folder_ / "missing.c3d"), C3dError);
  EXPECT_THROW(read_markers(folder_ / "missing.trc"), TrcError);
  EXPECT_THROW(read_markers(folder_ / "missing.txt"), UiPrmdError);
}

}  // namespace
}  // namespace secondskin
