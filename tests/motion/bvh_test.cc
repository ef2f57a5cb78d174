#include "motion/bvh.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <chrono>
#include <sstream>
#include <vector>

#include "motion/anatomy.h"
#include "motion/kinematics.h"
#include "motion/rotation.h"
#include "random_pose.h"

namespace secondskin {
namespace {

using testing::AllOf;
using testing::HasSubstr;
using testing::StartsWith;

const std::filesystem::path kData = SECONDSKIN_SOURCE_DIR "/tests/data/bvh";

BvhFile parse(const std::string& text) {
  std::istringstream in(text);
  return read_bvh(in, "test.bvh");
}

std::string complaint(const std::string& text) {
  try {
    parse(text);
  } catch (const BvhError& error) {
    return error.what();
  }
  return "accepted";
}

std::string with(std::string text, std::string_view old, std::string_view replacement) {
  const std::size_t at = text.find(old);
  EXPECT_NE(at, std::string::npos) << old;
  return text.replace(at, old.size(), replacement);
}

// Root and one arm, two frames; lines are numbered for the tests of errors.
const std::string kSmall =
    "HIERARCHY\n"                                                                 // 1
    "ROOT hips\n"                                                                 // 2
    "{\n"                                                                         // 3
    "  OFFSET 0 0 0\n"                                                            // 4
    "  CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation\n"  // 5
    "  JOINT arm\n"                                                               // 6
    "  {\n"                                                                       // 7
    "    OFFSET 0 10 0\n"                                                         // 8
    "    CHANNELS 3 Zrotation Xrotation Yrotation\n"                              // 9
    "    End Site\n"                                                              // 10
    "    {\n"                                                                     // 11
    "      OFFSET 0 5 0\n"                                                        // 12
    "    }\n"                                                                     // 13
    "  }\n"                                                                       // 14
    "}\n"                                                                         // 15
    "MOTION\n"                                                                    // 16
    "Frames: 2\n"                                                                 // 17
    "Frame Time: 0.04\n"                                                          // 18
    "1 2 3 0 0 0 90 0 0\n"                                                        // 19
    "1 2 3 0 0 0 0 0 -90\n";                                                      // 20

TEST(ReadBvh, UnderstandsASmallFile) {
  const BvhFile file = parse(kSmall);
  const Motion& m = file.motion;
  ASSERT_EQ(m.skeleton.size(), 2U);
  EXPECT_EQ(m.skeleton[1].name, "arm");
  EXPECT_EQ(m.skeleton[1].parent, 0U);
  EXPECT_EQ(m.skeleton[1].p_PB, Eigen::Vector3d(0, 10, 0));
  EXPECT_EQ(m.skeleton[1].p_BE, Eigen::Vector3d(0, 5, 0));
  EXPECT_EQ(m.skeleton[0].p_BE, Eigen::Vector3d(0, 10, 0));
  EXPECT_DOUBLE_EQ(m.rate_hz, 25.0);
  ASSERT_EQ(m.poses.size(), 2U);
  EXPECT_EQ(m.poses[0].p_WR, Eigen::Vector3d(1, 2, 3));
  EXPECT_EQ(file.ignored_position_joints, 0U);
  // 90 degrees about z take the arm's y to -x.
  EXPECT_LT((m.poses[0].q_PB[1] * Eigen::Vector3d::UnitY() + Eigen::Vector3d::UnitX()).norm(),
            1e-15);
}

TEST(ReadBvh, TakesRotationsInTheOrderOfTheChannelsWhateverItIs) {
  const char axes[] = "XYZ";
  std::mt19937 generator(15);
  std::uniform_real_distribution<double> angle(-179.0, 179.0);
  std::vector<int> order{0, 1, 2};
  do {
    const double a[3] = {angle(generator), angle(generator), angle(generator)};
    std::string channels = "CHANNELS 3";
    Eigen::Quaterniond expected = Eigen::Quaterniond::Identity();
    std::string values;
    for (int k = 0; k < 3; ++k) {
      channels.append(" ").append(1, axes[order[k]]).append("rotation");
      values.append(" ").append(std::to_string(a[k]));
      expected =
          expected * Eigen::AngleAxisd(std::stod(std::to_string(a[k])) * std::numbers::pi / 180.0,
                                       Eigen::Vector3d::Unit(order[k]));
    }
    const Motion m = parse(with(with(kSmall, "CHANNELS 3 Zrotation Xrotation Yrotation", channels),
                                "0 0 0 90 0 0\n", "0 0 0" + values + "\n"))
                         .motion;
    EXPECT_LT(geodesic_distance(m.poses[0].q_PB[1], expected), 1e-9) << channels;
  } while (std::next_permutation(order.begin(), order.end()));
}

TEST(ReadBvh, TakesPositionsAndRotationsMixedInAnyOrder) {
  const Motion m =
      parse(with(with(kSmall,
                      "CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation",
                      "CHANNELS 6 Yrotation Zposition Xrotation Xposition Zrotation Yposition"),
                 "1 2 3 0 0 0 90", "0 30 0 10 90 20 90"))
          .motion;
  EXPECT_EQ(m.poses[0].p_WR, Eigen::Vector3d(10, 20, 30));
  EXPECT_NEAR(rotation_vector(m.poses[0].q_PB[0]).z(), std::numbers::pi / 2, 1e-12);
}

TEST(ReadBvh, KeepsTheOffsetOfJointsWithPositionChannelsAndCountsThem) {
  std::string text = with(kSmall, "CHANNELS 3", "CHANNELS 6 Xposition Yposition Zposition");
  text = with(text, "0 0 0 90 0 0", "0 0 0 -77 13 28 90 0 0");
  text = with(text, "0 0 0 0 0 -90", "0 0 0 -76 12 27 0 0 -90");
  const BvhFile file = parse(text);
  EXPECT_EQ(file.ignored_position_joints, 1U);
  EXPECT_EQ(file.motion.skeleton[1].p_PB, Eigen::Vector3d(0, 10, 0));
  EXPECT_NEAR(rotation_vector(file.motion.poses[0].q_PB[1]).z(), std::numbers::pi / 2, 1e-12);
}

TEST(ReadBvh, TakesARootWithoutPositionsFromItsOffset) {
  std::string text = with(kSmall, "OFFSET 0 0 0", "OFFSET 4 5 6");
  text = with(text, "CHANNELS 6 Xposition Yposition Zposition", "CHANNELS 3");
  text = with(text, "1 2 3 0 0 0 90", "0 0 0 90");
  text = with(text, "1 2 3 0 0 0 0", "0 0 0 0");
  EXPECT_EQ(parse(text).motion.poses[1].p_WR, Eigen::Vector3d(4, 5, 6));
}

TEST(ReadBvh, AcceptsWindowsLinesTabsAnyCaseByteOrderMarkAndNoFinalNewline) {
  std::string text;
  for (const char c : kSmall) text += c == '\n' ? "\r\n" : std::string(1, c);
  EXPECT_EQ(parse(text).motion.poses.size(), 2U);
  EXPECT_EQ(parse("\xEF\xBB\xBF" + kSmall).motion.poses.size(), 2U);
  EXPECT_EQ(parse(with(kSmall, "Frame Time: ", "Frame Time:\t")).motion.rate_hz, 25.0);
  text = with(with(kSmall, "HIERARCHY", "hierarchy"), "JOINT", "Joint");
  text = with(with(text, "Zrotation", "ZROTATION"), "End Site", "END SITE");
  text = with(with(text, "MOTION", "Motion"), "Frame Time:", "FRAME TIME :");
  EXPECT_EQ(parse(text.substr(0, text.size() - 1) + "\n \n").motion.poses.size(), 2U);
  EXPECT_EQ(parse(kSmall.substr(0, kSmall.size() - 1)).motion.poses.size(), 2U);
}

// What Blender's exporter writes: braces on their own lines, six decimals, and, with "root
// transform only" off, six channels everywhere.
TEST(ReadBvh, ReadsBlendersExports) {
  const std::string blender =
      "HIERARCHY\nROOT Hips\n{\n\tOFFSET 0.000000 0.000000 1.000000\n"
      "\tCHANNELS 6 Xposition Yposition Zposition Xrotation Yrotation Zrotation\n"
      "\tJOINT upper arm.L\n\t{\n\t\tOFFSET 0.200000 0.000000 0.400000\n"
      "\t\tCHANNELS 6 Xposition Yposition Zposition Xrotation Yrotation Zrotation\n"
      "\t\tEnd Site\n\t\t{\n\t\t\tOFFSET 0.300000 0.000000 0.000000\n\t\t}\n\t}\n}\n"
      "MOTION\nFrames: 1\nFrame Time: 0.041667\n"
      "0.000000 0.000000 1.000000 0.000000 -0.000000 10.000000 0.200000 0.000000 0.400000 0.000000 "
      "90.000000 0.000000 \n";
  const BvhFile file = parse(blender);
  EXPECT_EQ(file.motion.skeleton[1].name, "upper arm.L");
  EXPECT_DOUBLE_EQ(file.motion.rate_hz, 24.0);
  EXPECT_EQ(file.ignored_position_joints, 1U);
}

TEST(ReadBvh, TakesTheWholeRateThatARoundedFrameTimeMeans) {
  const auto rate = [](std::string_view time) {
    return parse(with(kSmall, "0.04", time)).motion.rate_hz;
  };
  EXPECT_DOUBLE_EQ(rate("0.008333"), 120.0);
  EXPECT_DOUBLE_EQ(rate(".0083333"), 120.0);
  EXPECT_DOUBLE_EQ(rate("0.0333333"), 30.0);
  EXPECT_DOUBLE_EQ(rate("0.01"), 100.0);
  EXPECT_NEAR(rate("0.033367"), 29.97, 1e-3);
  EXPECT_NEAR(rate("0.008342"), 119.875, 1e-3);
  EXPECT_NEAR(rate("1e-2"), 100.0, 1e-9);
}

TEST(ReadBvh, SaysWhereAFileIsWrongAndWhatWasExpected) {
  struct Case {
    std::string old, replacement, place, found, expected;
  };
  for (const Case& c : std::vector<Case>{
           {"HIERARCHY", "HIERACHY", "test.bvh:1:1:", "\"HIERACHY\"", "HIERARCHY"},
           {"ROOT hips", "JOINT hips", "test.bvh:2:1:", "\"JOINT\"", "ROOT"},
           {"ROOT hips", "ROOT", "test.bvh:2:5:", "no name", "name"},
           {"ROOT hips\n{", "ROOT hips\n", "test.bvh:4:3:", "\"OFFSET\"", "{"},
           {"OFFSET 0 10 0", "OFFSET 0 ten 0", "test.bvh:8:14:", "\"ten\"", "number"},
           {"OFFSET 0 10 0", "OFFSET 0 10", "test.bvh:8:16:", "end of the line", "three"},
           {"OFFSET 0 10 0", "OFFSET 0 10 0 1", "test.bvh:8:19:", "\"1\"", "end of the line"},
           {"OFFSET 0 10 0", "OFFSET 0 nan 0", "test.bvh:8:14:", "\"nan\"", "finite"},
           {"OFFSET 0 10 0\n", "\n", "test.bvh:10:5:", "\"End\"", "OFFSET"},
           {"OFFSET 0 10 0", "OFFSET 0 10 0\n    OFFSET 0 10 0", "test.bvh:9:5:", "\"OFFSET\"",
            "one"},
           {"CHANNELS 3 Zrot", "CHANNELS 4 Zrot", "test.bvh:9:45:", "end of the line", "rotation"},
           {"CHANNELS 3 Zrot", "CHANNELS 2 Zrot", "test.bvh:9:36:", "\"Yrotation\"", "2 channels"},
           {"CHANNELS 3 Zrot", "CHANNELS 99999999999999999999 Zrot", "test.bvh:9:14:", "9999",
            "1 to 6"},
           {"CHANNELS 3 Zrot", "CHANNELS -3 Zrot", "test.bvh:9:14:", "\"-3\"", "1 to 6"},
           {"CHANNELS 3 Zrotation", "CHANNELS 3 Wrotation", "test.bvh:9:16:", "\"Wrotation\"",
            "Xrotation"},
           {"3 Zrotation X", "3 Xrotation X", "test.bvh:9:26:", "\"Xrotation\"", "once"},
           {"JOINT arm", "JOINT hips", "test.bvh:6:9:", "\"hips\"", "no other joint"},
           {"  }\n}\n", "  }\n", "test.bvh:15:1:", "\"MOTION\"", "}"},
           {"}\nMOTION", "}\n}\nMOTION", "test.bvh:16:1:", "\"}\"", "MOTION"},
           {"Frames: 2", "Frames: 0", "test.bvh:17:9:", "\"0\"", "at least 1"},
           {"Frames: 2", "Frames: -2", "test.bvh:17:9:", "\"-2\"", "at least 1"},
           {"Frames: 2", "Frames: 2.5", "test.bvh:17:9:", "\"2.5\"", "number of frames"},
           {"Frames: 2", "Frames: many", "test.bvh:17:9:", "\"many\"", "number of frames"},
           {"Frames: 2", "Frame: 2", "test.bvh:17:1:", "\"Frame:\"", "Frames:"},
           {"Frames: 2", "Frames: 3", "test.bvh:21:1:", "the end of the file after 2 frames",
            "3 frames"},
           {"Frames: 2", "Frames: 1", "test.bvh:20:1:", "\"1\"", "after 1 frames"},
           {"Time: 0.04", "Time: 0", "test.bvh:18:13:", "\"0\"", "seconds"},
           {"Time: 0.04", "Time: -0.04", "test.bvh:18:13:", "\"-0.04\"", "seconds"},
           {"Time: 0.04", "Time: inf", "test.bvh:18:13:", "\"inf\"", "seconds"},
           {"Time: 0.04", "Tim: 0.04", "test.bvh:18:7:", "\"Tim:\"", "Frame Time:"},
           {"1 2 3 0 0 0 90 0 0", "1 2 3 0 0 0 90 0", "test.bvh:19:17:", "end of the line after 8",
            "9 values"},
           {"1 2 3 0 0 0 90 0 0", "1 2 3 0 0 0 90 0 0 7", "test.bvh:19:20:", "\"7\"", "9 values"},
           {"1 2 3 0 0 0 90 0 0", "1 2 NaN 0 0 0 90 0 0", "test.bvh:19:5:", "\"NaN\"", "finite"},
           {"1 2 3 0 0 0 90 0 0", "1 2 3 0 0 0 -inf 0 0", "test.bvh:19:13:", "\"-inf\"", "finite"},
           {"1 2 3 0 0 0 90 0 0", "1 2 3 0 0 0 9o 0 0", "test.bvh:19:13:", "\"9o\"", "finite"},
           {"1 2 3 0 0 0 90 0 0", "1 2 3 0 0 0 1,5 0 0", "test.bvh:19:13:", "\"1,5\"", "finite"},
           {"1 2 3 0 0 0 90 0 0", "1 2 3 0 0 0 1e999 0 0", "test.bvh:19:13:", "\"1e999\"",
            "finite"},
       }) {
    EXPECT_THAT(complaint(with(kSmall, c.old, c.replacement)),
                AllOf(StartsWith(c.place), HasSubstr("found"), HasSubstr(c.found),
                      HasSubstr("expected"), HasSubstr(c.expected)))
        << c.replacement;
  }
}

TEST(ReadBvh, RefusesEveryFileThatIsCutBeforeItsLastNumber) {
  const std::size_t last = kSmall.rfind(' ');
  for (std::size_t length = 0; length <= last; ++length) {
    EXPECT_THAT(complaint(kSmall.substr(0, length)),
                AllOf(StartsWith("test.bvh:"), HasSubstr("expected")))
        << length;
  }
}

TEST(ReadBvh, NeverCrashesOnAFileWithOneWrongByte) {
  std::mt19937 generator(16);
  std::uniform_int_distribution<std::size_t> place(0, kSmall.size() - 1);
  std::uniform_int_distribution<int> byte(0, 255);
  for (int n = 0; n < 5000; ++n) {
    std::string text = kSmall;
    text[place(generator)] = static_cast<char>(byte(generator));
    try {
      for (const Pose& pose : parse(text).motion.poses) EXPECT_TRUE(pose.is_valid());
    } catch (const BvhError& error) {
      EXPECT_THAT(error.what(), HasSubstr("expected"));
    }
  }
}

TEST(ReadBvh, DoesNotBelieveANumberOfFramesBeforeItHasReadThem) {
  const auto start = std::chrono::steady_clock::now();
  EXPECT_THAT(complaint(with(kSmall, "Frames: 2", "Frames: 1000000000000000")),
              HasSubstr("1000000000000000 frames"));
  EXPECT_LT(std::chrono::steady_clock::now() - start, std::chrono::seconds(1));
}

TEST(ReadBvh, ReadsADeepHierarchyWithoutRecursion) {
  constexpr int kDepth = 20000;
  std::string text = "HIERARCHY\nROOT j0\n{\nOFFSET 0 0 0\nCHANNELS 1 Xrotation\n";
  for (int i = 1; i < kDepth; ++i) {
    text.append("JOINT j")
        .append(std::to_string(i))
        .append("\n{\nOFFSET 0 1 0\nCHANNELS 1 Xrotation\n");
  }
  for (int i = 0; i < kDepth; ++i) text += "}\n";
  text += "MOTION\nFrames: 1\nFrame Time: 0.01\n";
  for (int i = 0; i < kDepth; ++i) text += "0 ";
  EXPECT_EQ(parse(text).motion.skeleton.size(), static_cast<std::size_t>(kDepth));
}

TEST(ReadBvh, NamesAFileThatIsNotThere) {
  EXPECT_THROW(
      {
        try {
          read_bvh(std::filesystem::path("/nowhere/none.bvh"));
        } catch (const BvhError& error) {
          EXPECT_THAT(error.what(), HasSubstr("/nowhere/none.bvh"));
          throw;
        }
      },
      BvhError);
}

struct Recording {
  std::string file;
  double metres_per_unit;
  std::size_t joints, frames, ignored;
};

class RecordedBvh : public testing::TestWithParam<Recording> {};

// 0.1 mm is the bound for BVH -> Motion -> BVH.
TEST_P(RecordedBvh, KeepsEveryJointPositionWithinATenthOfAMillimetre) {
  const BvhFile file = read_bvh(kData / GetParam().file);
  EXPECT_EQ(file.motion.skeleton.size(), GetParam().joints);
  EXPECT_EQ(file.motion.poses.size(), GetParam().frames);
  EXPECT_EQ(file.ignored_position_joints, GetParam().ignored);
  std::stringstream stream;
  write_bvh(file.motion, stream);
  const Motion again = read_bvh(stream, "again").motion;
  ASSERT_EQ(again.poses.size(), file.motion.poses.size());
  EXPECT_NEAR(again.rate_hz, file.motion.rate_hz, 1e-6);
  const std::size_t joints = file.motion.skeleton.size();
  std::vector<Eigen::Isometry3d> X(joints), Y(joints);
  double worst = 0.0;
  for (std::size_t n = 0; n < again.poses.size(); ++n) {
    ASSERT_TRUE(file.motion.poses[n].is_valid());
    forward_kinematics(file.motion.skeleton, file.motion.poses[n].p_WR, file.motion.poses[n].q_PB,
                       X);
    forward_kinematics(again.skeleton, again.poses[n].p_WR, again.poses[n].q_PB, Y);
    for (std::size_t i = 0; i < joints; ++i) {
      const std::size_t k = *again.skeleton.find(file.motion.skeleton[i].name);
      worst = std::max(
          worst, (X[i] * file.motion.skeleton[i].p_BE - Y[k] * again.skeleton[k].p_BE).norm());
      worst = std::max(worst, (X[i].translation() - Y[k].translation()).norm());
    }
  }
  EXPECT_LT(worst * GetParam().metres_per_unit, 1e-4);
}

INSTANTIATE_TEST_SUITE_P(
    ThreeHierarchiesThreeUnits, RecordedBvh,
    testing::Values(Recording{"cmu/131_01_first_240.bvh", 0.0254 / 0.45, 31, 240, 0},
                    Recording{"cmu/13_26_first_120.bvh", 0.0254 / 0.45, 31, 120, 0},
                    Recording{"cmu/14_14_squat_300.bvh", 0.0254 / 0.45, 31, 300, 0},
                    Recording{"cmu/135_05_last_480.bvh", 0.0254, 19, 480, 2},
                    Recording{"animated_drawings/dab.bvh", 0.0254, 27, 339, 0}));

// Euler angles of any rotation, those at gimbal lock included, on a hierarchy whose segments are
// not in the order of a file.
TEST(WriteBvh, KeepsAnyRotationGimbalLockIncluded) {
  std::vector<Segment> segments;
  segments.push_back({.name = "root", .parent = {}});
  segments.push_back({.name = "left", .parent = 0, .p_PB = {0, 0.3, 0}});
  segments.push_back({.name = "right", .parent = 0, .p_PB = {0, -0.3, 0}});
  segments.push_back(
      {.name = "left tip", .parent = 1, .p_PB = {0, 0.4, 0.123456}, .p_BE = {0, 0, 1}});
  segments.push_back({.name = "right tip", .parent = 2, .p_PB = {0, -0.4, 0}});
  Motion motion{Skeleton(segments), 62.5, {}};
  std::mt19937 generator(17);
  for (int n = 0; n < 1000; ++n) {
    Pose pose = random_pose(generator, 5);
    const double almost = n % 2 == 0 ? 0.0 : std::pow(10.0, -1 - n % 15);
    pose.q_PB[1] = quaternion_from({0, 0, 0.3 * n}) *
                   quaternion_from({std::numbers::pi / 2 - almost, 0, 0}) *
                   quaternion_from({0, 0.2 * n, 0});
    motion.poses.push_back(pose);
  }
  std::stringstream stream;
  write_bvh(motion, stream);
  const Motion again = read_bvh(stream, "again").motion;
  EXPECT_DOUBLE_EQ(again.rate_hz, 62.5);
  for (std::size_t n = 0; n < motion.poses.size(); ++n) {
    for (std::size_t i = 0; i < 5; ++i) {
      const std::size_t k = *again.skeleton.find(segments[i].name);
      EXPECT_LT(geodesic_distance(motion.poses[n].q_PB[i], again.poses[n].q_PB[k]), 1e-7)
          << n << " " << i;
    }
  }
}

TEST(WriteBvh, LeavesTheOldFileAndNothingElseWhenItCannotWrite) {
  const Motion motion = parse(kSmall).motion;
  const auto folder = std::filesystem::path(testing::TempDir()) / "secondskin_write_bvh";
  std::filesystem::remove_all(folder);
  std::filesystem::create_directories(folder);
  write_bvh(motion, folder / "a.bvh");
  write_bvh(motion, folder / "a.bvh");
  EXPECT_EQ(read_bvh(folder / "a.bvh").motion.poses.size(), 2U);
  // A directory in the file's place cannot be replaced.
  std::filesystem::create_directories(folder / "b.bvh" / "inside");
  EXPECT_THROW(write_bvh(motion, folder / "b.bvh"), std::system_error);
  EXPECT_THROW(write_bvh(motion, folder / "missing" / "c.bvh"), std::system_error);
  std::size_t files = 0;
  for ([[maybe_unused]] const auto& entry : std::filesystem::directory_iterator(folder)) ++files;
  EXPECT_EQ(files, 2U);
  std::filesystem::remove_all(folder);
}

// /dev/full accepts a file's opening and refuses its bytes, as a full disk does.
TEST(WriteBvh, SaysWhenTheDiskIsFull) {
  if (!std::filesystem::exists("/dev/full")) GTEST_SKIP() << "this system has no /dev/full";
  const auto folder = std::filesystem::path(testing::TempDir()) / "secondskin_full_disk";
  std::filesystem::remove_all(folder);
  std::filesystem::create_directories(folder);
  std::filesystem::create_symlink("/dev/full", folder / "a.bvh.partial");
  try {
    write_bvh(parse(kSmall).motion, folder / "a.bvh");
    FAIL() << "wrote to a full disk";
  } catch (const std::system_error& error) {
    EXPECT_THAT(error.what(), HasSubstr((folder / "a.bvh").string()));
    EXPECT_EQ(error.code(), std::errc::no_space_on_device);
  }
  EXPECT_FALSE(std::filesystem::exists(folder / "a.bvh"));
  std::filesystem::remove_all(folder);
}

}  // namespace
}  // namespace secondskin
