#include "motion/ui_prmd.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <fstream>
#include <random>
#include <string>

namespace secondskin {
namespace {

using testing::AllOf;
using testing::HasSubstr;

const std::filesystem::path kData = SECONDSKIN_SOURCE_DIR "/tests/data/ui_prmd";
const std::filesystem::path kSquat = kData / "m01_s01_e02_positions.txt.gz";
const std::filesystem::path kSquatAngles = kData / "m01_s01_e02_angles.txt.gz";
const std::filesystem::path kGaps = kData / "m07_s04_e01_positions_inc.txt.gz";

class UiPrmd : public testing::Test {
 protected:
  std::filesystem::path write(const std::string& bytes) {
    std::ofstream(file_, std::ios::binary) << bytes;
    return file_;
  }
  std::string complaint(const std::string& bytes) {
    try {
      read_ui_prmd_markers(write(bytes));
    } catch (const UiPrmdError& error) {
      return error.what();
    }
    return "accepted";
  }
  void TearDown() override { std::filesystem::remove(file_); }

  std::filesystem::path file_ =
      std::filesystem::path(testing::TempDir()) /
      (std::string("secondskin_") + testing::UnitTest::GetInstance()->current_test_info()->name() +
       ".txt");
};

std::string row(int numbers, const std::string& between = ",") {
  std::string text;
  for (int i = 0; i < numbers; ++i) {
    if (i > 0) text += between;
    text += std::to_string(i + 1);
  }
  return text + "\n";
}
std::string contents(const std::filesystem::path& file) {
  std::ifstream in(file, std::ios::binary);
  return {std::istreambuf_iterator<char>(in), {}};
}

TEST(UiPrmdMarkers, AreAPersonInMetresStandingAlongZ) {
  const MarkerMotion motion = read_ui_prmd_markers(kSquat);
  EXPECT_EQ(motion.rate_hz, 100.0);
  EXPECT_EQ(motion.names.size(), 39U);
  ASSERT_GT(motion.frames.size(), 100U);
  const MarkerFrame& first = motion.frames.front();
  EXPECT_EQ(std::count(first.visible.begin(), first.visible.end(), 1), 39);
  const auto at = [&](std::string_view name) { return first.p_WM[*motion.find(name)]; };
  EXPECT_NEAR(at("LFHD").z(), 1.7, 0.3);
  EXPECT_LT(at("LTOE").z(), 0.15);
  EXPECT_LT(at("RTOE").z(), 0.15);
  EXPECT_GT(at("C7").z(), at("T10").z());
  EXPECT_GT(at("LASI").z(), at("LKNE").z());
  EXPECT_GT(at("LKNE").z(), at("LANK").z());
  EXPECT_NEAR((at("LASI") - at("RASI")).norm(), 0.25, 0.08);
  EXPECT_NEAR((at("LKNE") - at("LANK")).norm(), 0.42, 0.08);
}

TEST(UiPrmdMarkers, AtTheOriginWereNotSeen) {
  const MarkerMotion motion = read_ui_prmd_markers(kGaps);
  std::size_t hidden = 0;
  for (const MarkerFrame& frame : motion.frames) {
    for (std::size_t i = 0; i < 39; ++i) {
      if (!frame.visible[i]) {
        ++hidden;
      } else {
        EXPECT_GT(frame.p_WM[i].norm(), 0.01);
      }
    }
  }
  EXPECT_EQ(hidden, 31U) << "counted with another program";
}

// The same repetition: hips, knees and ankles bend in a squat, and the knee's flexion goes with the
// angle at its marker.
TEST(UiPrmdAngles, AreTheJointsThatTheirIndicesName) {
  const MarkerMotion motion = read_ui_prmd_markers(kSquat);
  const std::vector<UiPrmdAngles> angles = read_ui_prmd_angles(kSquatAngles);
  ASSERT_EQ(angles.size(), motion.frames.size());
  const auto range = [&](std::size_t joint) {
    double low = 1e9, high = -1e9;
    for (const UiPrmdAngles& frame : angles) {
      low = std::min(low, frame[joint].x());
      high = std::max(high, frame[joint].x());
    }
    return high - low;
  };
  for (const std::size_t joint :
       {kUiPrmdLeftHip, kUiPrmdRightHip, kUiPrmdLeftKnee, kUiPrmdRightKnee}) {
    EXPECT_GT(range(joint), 50.0) << joint;
    EXPECT_LT(range(joint), 160.0) << joint;
  }
  for (const std::size_t joint : {kUiPrmdLeftAnkle, kUiPrmdRightAnkle}) {
    EXPECT_GT(range(joint), 10.0) << joint;
    EXPECT_LT(range(joint), 60.0) << joint;
  }
  for (const std::size_t joint : {kUiPrmdLeftElbow, kUiPrmdRightElbow}) {
    for (const UiPrmdAngles& frame : angles) {
      ASSERT_EQ(frame[joint].y(), 0.0);
      ASSERT_EQ(frame[joint].z(), 0.0);
    }
  }
  struct Side {
    const char *hip, *knee, *ankle;
    std::size_t joint;
  };
  for (const Side& side : {Side{"LASI", "LKNE", "LANK", kUiPrmdLeftKnee},
                           Side{"RASI", "RKNE", "RANK", kUiPrmdRightKnee}}) {
    Eigen::VectorXd stored(angles.size()), seen(angles.size());
    for (std::size_t f = 0; f < angles.size(); ++f) {
      const auto at = [&](const char* name) { return motion.frames[f].p_WM[*motion.find(name)]; };
      const Eigen::Vector3d thigh = (at(side.knee) - at(side.hip)).normalized();
      const Eigen::Vector3d shank = (at(side.ankle) - at(side.knee)).normalized();
      stored[f] = angles[f][side.joint].x();
      seen[f] = std::acos(thigh.dot(shank));
    }
    stored.array() -= stored.mean();
    seen.array() -= seen.mean();
    EXPECT_GT(stored.dot(seen) / (stored.norm() * seen.norm()), 0.98) << side.knee;
  }
}

TEST_F(UiPrmd, ReadsCommasBlanksTabsAndWindowsLinesUnpacked) {
  for (const std::string between : {",", " ", "\t", ", ", "   "}) {
    const MarkerMotion motion = read_ui_prmd_markers(write(row(117, between) + "\r\n"));
    ASSERT_EQ(motion.frames.size(), 1U);
    EXPECT_TRUE(motion.frames[0].p_WM[38].isApprox(Eigen::Vector3d(0.115, 0.116, 0.117), 1e-12));
  }
}

TEST_F(UiPrmd, SaysWhatIsWrongAndInWhichLine) {
  EXPECT_THAT(complaint(row(117) + row(116)), HasSubstr(".txt:2: found 116 numbers, expected 117"));
  EXPECT_THAT(complaint(row(118)), HasSubstr(".txt:1: found more than 117 numbers"));
  EXPECT_THAT(complaint("x" + row(117)), HasSubstr(".txt:1: found \"x1\" as number 1"));
  EXPECT_THAT(complaint("1,,2"), HasSubstr("number 2"));
  EXPECT_THAT(complaint("1;2"), HasSubstr("\";\" after number 1"));
  EXPECT_THAT(complaint("1,nan," + row(115)), HasSubstr("\"nan\" as number 2"));
  EXPECT_THAT(complaint("1,1e99," + row(115)), HasSubstr("number 2"));
  EXPECT_THAT(complaint(""), HasSubstr("found no rows"));
  EXPECT_THAT(complaint("\n\n"), HasSubstr("found no rows"));
  EXPECT_THROW(read_ui_prmd_markers(kData), UiPrmdError);
  EXPECT_THROW(read_ui_prmd_angles(kData / "missing.txt.gz"), UiPrmdError);
}

TEST_F(UiPrmd, RefusesATornOrDamagedGzipFile) {
  const std::string whole = contents(kGaps);
  ASSERT_EQ(complaint(whole), "accepted");
  for (const std::size_t size : {whole.size() - 1, whole.size() - 8, whole.size() / 2}) {
    EXPECT_THAT(complaint(whole.substr(0, size)), HasSubstr("expected a whole gzip file")) << size;
  }
  std::mt19937 generator(43);
  for (int round = 0; round < 100; ++round) {
    std::string bytes = whole;
    bytes[20 + generator() % (bytes.size() - 20)] ^= static_cast<char>(1U << generator() % 8);
    EXPECT_NE(complaint(bytes), "accepted") << "the checksum covers every byte";
  }
}

}  // namespace
}  // namespace secondskin
