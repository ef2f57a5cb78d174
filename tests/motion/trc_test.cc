#include "motion/trc.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <fstream>
#include <random>
#include <sstream>
#include <system_error>

namespace secondskin {
namespace {

using testing::AllOf;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::StartsWith;

MarkerMotion parse(const std::string& text) {
  std::istringstream in(text);
  return read_trc(in, "test.trc");
}
std::string complaint(const std::string& text) {
  try {
    parse(text);
  } catch (const TrcError& error) {
    return error.what();
  }
  return "accepted";
}
std::string with(std::string text, std::string_view old, std::string_view replacement) {
  const std::size_t at = text.find(old);
  EXPECT_NE(at, std::string::npos) << old;
  return text.replace(at, old.size(), replacement);
}
std::string encode(const MarkerMotion& markers) {
  std::ostringstream out;
  write_trc(markers, out, "out.trc");
  return out.str();
}

// As OpenSim's examples have it: tabs at the lines' ends, blank fields for what was not seen.
const std::string kSmall =
    "PathFileType\t4\t(X/Y/Z)\ttest.trc\t\n"                              // 1
    "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\t"  // 2
    "OrigDataStartFrame\tOrigNumFrames\n"                                 //
    "60.00\t60.00\t3\t2\tmm\t60.00\t1\t3\n"                               // 3
    "Frame#\tTime\tR.ASIS\t\t\tTop Head\t\t\t\n"                          // 4
    "\t\tX1\tY1\tZ1\tX2\tY2\tZ2\t\n"                                      // 5
    "\n"                                                                  // 6
    "1\t0.000\t614.257\t1049.3\t-160.6\t1\t2\t3\t\n"                      // 7
    "2\t0.017\t\t\t\t-1e2\t+2.5\t.5\n"                                    // 8
    "3\t0.033\t615.0\t1050.0\t-161.0\t\t\t\t\n";                          // 9

TEST(ReadTrc, ReadsMarkersInMetres) {
  const MarkerMotion motion = parse(kSmall);
  EXPECT_THAT(motion.names, ElementsAre("R.ASIS", "Top Head"));
  EXPECT_EQ(motion.rate_hz, 60.0);
  ASSERT_EQ(motion.frames.size(), 3U);
  EXPECT_TRUE(motion.frames[0].p_WM[0].isApprox(Eigen::Vector3d(0.614257, 1.0493, -0.1606), 1e-12));
  EXPECT_TRUE(motion.frames[1].p_WM[1].isApprox(Eigen::Vector3d(-0.1, 0.0025, 0.0005), 1e-12));
}

TEST(ReadTrc, HidesWhatIsBlankMissingNotANumberOrZero) {
  EXPECT_THAT(parse(kSmall).frames[0].visible, ElementsAre(1, 1));
  EXPECT_THAT(parse(kSmall).frames[1].visible, ElementsAre(0, 1));
  EXPECT_THAT(parse(kSmall).frames[2].visible, ElementsAre(1, 0));
  const auto first_frame = [](std::string_view fields) {
    return parse(with(kSmall, "614.257\t1049.3\t-160.6\t1\t2\t3\t", fields)).frames[0].visible;
  };
  EXPECT_THAT(first_frame("1\t2\t3"), ElementsAre(1, 0)) << "the columns end early";
  EXPECT_THAT(first_frame(""), ElementsAre(0, 0));
  EXPECT_THAT(first_frame("NaN\tnan\tNaN\t1\t2\t3"), ElementsAre(0, 1));
  EXPECT_THAT(first_frame("0\t0.000\t-0\t1\t2\t3"), ElementsAre(0, 1));
}

TEST(ReadTrc, ReadsWindowsLinesEveryUnitAndNoBlankLine) {
  std::string text = kSmall;
  for (std::size_t at = 0; (at = text.find('\n', at)) != std::string::npos; at += 2) {
    text.replace(at, 1, "\r\n");
  }
  EXPECT_EQ(encode(parse(text)), encode(parse(kSmall)));
  EXPECT_EQ(encode(parse(with(kSmall, "Z2\t\n\n", "Z2\n"))), encode(parse(kSmall)));
  EXPECT_EQ(encode(parse(kSmall + "\n \n")), encode(parse(kSmall)));
  EXPECT_NEAR(parse(with(kSmall, "\tmm", "\tcm")).frames[0].p_WM[1].z(), 0.03, 1e-12);
  EXPECT_NEAR(parse(with(kSmall, "\tmm", "\tm")).frames[0].p_WM[1].z(), 3.0, 1e-12);
  EXPECT_NEAR(parse(with(kSmall, "\tmm", "\tin")).frames[0].p_WM[1].z(), 0.0762, 1e-12);
}

TEST(ReadTrc, SaysWhatIsWrongAndInWhichLine) {
  const auto said = [](std::string_view old, std::string_view replacement) {
    return complaint(with(kSmall, old, replacement));
  };
  EXPECT_THAT(complaint(""), StartsWith("test.trc:1: found the end of the file"));
  EXPECT_THAT(said("PathFileType", "HIERARCHY"), StartsWith("test.trc:1: found \"HIERARCHY\""));
  EXPECT_THAT(said("NumMarkers", "Markers"), StartsWith("test.trc:3: found nothing, expected a "
                                                        "value of NumMarkers"));
  EXPECT_THAT(said("60.00\t60.00\t3", "0\t60.00\t3"),
              AllOf(StartsWith("test.trc:3:"), HasSubstr("DataRate")));
  EXPECT_THAT(said("60.00\t60.00\t3", "nan\t60.00\t3"), HasSubstr("DataRate"));
  EXPECT_THAT(said("\tmm", "\tfeet"), AllOf(StartsWith("test.trc:3:"), HasSubstr("\"feet\"")));
  EXPECT_THAT(said("\t3\t2\tmm", "\t3\t2.5\tmm"),
              AllOf(StartsWith("test.trc:3:"), HasSubstr("NumMarkers from 1")));
  EXPECT_THAT(said("\t3\t2\tmm", "\t3\t3\tmm"),
              StartsWith("test.trc:4: found 2 names, expected NumMarkers, 3"));
  EXPECT_THAT(said("\t3\t2\tmm", "\t4\t2\tmm"),
              StartsWith("test.trc:9: found 3 rows of data, expected NumFrames, 4"));
  EXPECT_THAT(said("\t3\t2\tmm", "\t2\t2\tmm"),
              StartsWith("test.trc:9: found a further row of data, expected NumFrames, 2"));
  EXPECT_THAT(said("Top Head", "R.ASIS"),
              StartsWith("test.trc:4: found \"R.ASIS\", expected each"));
  EXPECT_THAT(said("\t\t\tTop", "\t\tTop"),
              AllOf(StartsWith("test.trc:4:"), HasSubstr("column 5")));
  EXPECT_THAT(said("X1\tY1", "1.0\t2.0"), StartsWith("test.trc:5: found \"1.0\", expected X1"));
  EXPECT_THAT(said("1049.3", "10x49"),
              AllOf(StartsWith("test.trc:7: found \"10x49\""), HasSubstr("column 4")));
  EXPECT_THAT(said("1049.3", ""), StartsWith("test.trc:7: found 1 blank of the three fields of "
                                             "R.ASIS"));
  EXPECT_THAT(said("1049.3", "1e300"), StartsWith("test.trc:7: found \"1e300\""));
  EXPECT_THAT(said("\t3\t\n2\t", "\t3\t4\n2\t"),
              StartsWith("test.trc:7: found \"4\" in column 9, expected 8 columns"));
  EXPECT_THAT(said("0.033", "0.3"), AllOf(StartsWith("test.trc:9:"), HasSubstr("DataRate, 60 Hz")));
  EXPECT_THAT(said("0.033", "inf"), StartsWith("test.trc:9:"));
  EXPECT_THROW(read_trc(std::filesystem::path(SECONDSKIN_SOURCE_DIR "/missing.trc")), TrcError);
  EXPECT_THROW(read_trc(std::filesystem::path(SECONDSKIN_SOURCE_DIR "/motion")), TrcError);
}

TEST(ReadTrc, SurvivesAnyDamage) {
  std::mt19937 generator(41);
  constexpr std::string_view kLetters = "\t\n\r 0123456789.-+eENaXxf\xFF";
  std::size_t accepted = 0;
  for (int round = 0; round < 20000; ++round) {
    std::string text = kSmall;
    for (std::size_t damage = 1 + generator() % 4; damage-- > 0;) {
      const std::size_t at = generator() % text.size();
      switch (generator() % 4) {
        case 0:
          text[at] = kLetters[generator() % kLetters.size()];
          break;
        case 1:
          text.erase(at, 1 + generator() % 8);
          break;
        case 2:
          text.insert(at, 1, kLetters[generator() % kLetters.size()]);
          break;
        default:
          if (generator() % 8 == 0) text.resize(at);
          break;
      }
      if (text.empty()) break;
    }
    accepted += complaint(text) == "accepted";
  }
  EXPECT_GT(accepted, 100U);
  EXPECT_LT(accepted, 19900U);
}

TEST(WriteTrc, WhatIsWrittenIsReadBackWithinHundredNanometres) {
  std::mt19937 generator(42);
  std::uniform_real_distribution<double> real(-5.0, 5.0);
  for (int draw = 0; draw < 200; ++draw) {
    MarkerMotion motion;
    motion.rate_hz = draw % 2 == 0 ? 120.0 : 100.0 / 3.0;
    const std::size_t markers = 1 + generator() % 6, frames = 1 + generator() % 40;
    for (std::size_t i = 0; i < markers; ++i) motion.names.push_back("S:M " + std::to_string(i));
    for (std::size_t f = 0; f < frames; ++f) {
      MarkerFrame frame(markers);
      for (std::size_t i = 0; i < markers; ++i) {
        if (generator() % 4 == 0) continue;
        frame.visible[i] = 1;
        frame.p_WM[i] = {real(generator), real(generator), real(generator)};
      }
      motion.frames.push_back(frame);
    }
    const MarkerMotion read = parse(encode(motion));
    ASSERT_EQ(read.names, motion.names);
    ASSERT_EQ(read.rate_hz, motion.rate_hz);
    ASSERT_EQ(read.frames.size(), frames);
    for (std::size_t f = 0; f < frames; ++f) {
      ASSERT_EQ(read.frames[f].visible, motion.frames[f].visible);
      for (std::size_t i = 0; i < markers; ++i) {
        if (!motion.frames[f].visible[i]) continue;
        ASSERT_LT((read.frames[f].p_WM[i] - motion.frames[f].p_WM[i]).norm(), 1e-7);
      }
    }
  }
}

TEST(WriteTrc, RefusesANameThatWouldBreakALineAndLeavesNoFile) {
  MarkerMotion motion = parse(kSmall);
  const auto file = std::filesystem::path(testing::TempDir()) / "secondskin_write.trc";
  std::filesystem::remove(file);
  for (const char* name : {"A\tB", "", "A\n", " A"}) {
    motion.names[1] = name;
    EXPECT_THROW(write_trc(motion, file), TrcError) << name;
    EXPECT_FALSE(std::filesystem::exists(file));
  }
  motion.names[1] = "A B";
  write_trc(motion, file);
  EXPECT_EQ(read_trc(file).names[1], "A B");
  EXPECT_THROW(write_trc(motion, file / "inside.trc"), std::system_error);
  std::filesystem::remove(file);
}

}  // namespace
}  // namespace secondskin
