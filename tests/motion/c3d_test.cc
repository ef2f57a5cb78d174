#include "motion/c3d.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <bit>
#include <cmath>
#include <fstream>
#include <random>
#include <sstream>
#include <system_error>

namespace secondskin {
namespace {

using testing::AllOf;
using testing::ElementsAre;
using testing::HasSubstr;

const std::filesystem::path kData = SECONDSKIN_SOURCE_DIR "/tests/data/c3d";
const std::filesystem::path kVariants = kData / "kineticstoolkit/format_variants";
const std::filesystem::path kWalk = kData / "biomechzoo/HC002D06_frames_221_260.c3d";
const std::filesystem::path kStatic = kData / "pycgm/Sample_Static_first_8.c3d";
const std::filesystem::path kServe = kData / "kineticstoolkit/tennis_serve_first_40.c3d";

struct Variant {
  C3dProcessor processor;
  C3dStorage storage;
};
constexpr std::array<Variant, 6> kSix{{{C3dProcessor::kIntel, C3dStorage::kInteger},
                                       {C3dProcessor::kIntel, C3dStorage::kReal},
                                       {C3dProcessor::kDec, C3dStorage::kInteger},
                                       {C3dProcessor::kDec, C3dStorage::kReal},
                                       {C3dProcessor::kSgi, C3dStorage::kInteger},
                                       {C3dProcessor::kSgi, C3dStorage::kReal}}};
constexpr std::array<const char*, 6> kSixFiles{"pc_int.c3d",   "pc_real.c3d", "dec_int.c3d",
                                               "dec_real.c3d", "sgi_int.c3d", "sgi_real.c3d"};

C3dFile parse(const std::string& bytes) {
  std::istringstream in(bytes);
  return read_c3d(in, "test.c3d");
}
std::string encode(const C3dFile& content, Variant variant = kSix[1]) {
  std::ostringstream out;
  write_c3d(content, out, variant.processor, variant.storage);
  return out.str();
}
std::string complaint(const std::string& bytes) {
  try {
    parse(bytes);
  } catch (const C3dError& error) {
    return error.what();
  }
  return "accepted";
}
std::string refusal(const C3dFile& content, Variant variant = kSix[1]) {
  try {
    encode(content, variant);
  } catch (const C3dError& error) {
    return error.what();
  }
  return "accepted";
}
std::string contents(const std::filesystem::path& file) {
  std::ifstream in(file, std::ios::binary);
  return {std::istreambuf_iterator<char>(in), {}};
}

// Two markers, an angle, a channel of two samples a frame; three frames.
C3dFile small() {
  C3dFile file;
  file.markers.names = {"LASI", "RASI"};
  file.markers.rate_hz = 100.0;
  for (int f = 0; f < 3; ++f) {
    MarkerFrame frame(2);
    frame.p_WM = {{0.1 + f, 0.2, 1.0}, {0.1 + f, -0.2, 1.0}};
    frame.visible = {1, 1};
    file.markers.frames.push_back(frame);
  }
  file.derived.push_back({.name = "LKneeAngles",
                          .kind = C3dKind::kAngle,
                          .unit = "deg",
                          .values = {{10, 1, 2}, {20, 1, 2}, {30, 1, 2}},
                          .valid = {1, 0, 1}});
  file.analog.push_back({.name = "Fz1", .unit = "N", .values = {1, 2, 3, 4, 5, 6}});
  return file;
}

// Where the values of the first parameter of that name begin, in any order of bytes.
std::size_t values_of(const std::string& bytes, std::string_view name) {
  std::string record(1, static_cast<char>(name.size()));
  std::size_t at = 512;
  for (;;) {
    at = bytes.find(name, at + 1);
    if (at == std::string::npos) {
      ADD_FAILURE() << "no parameter " << name;
      return 0;
    }
    if (bytes[at - 2] == record[0]) break;
  }
  at += name.size() + 2;
  return at + 2 + static_cast<std::uint8_t>(bytes[at + 1]);
}
void put_word(std::string& bytes, std::size_t at, unsigned value) {
  bytes[at] = static_cast<char>(value & 0xFFU);
  bytes[at + 1] = static_cast<char>(value >> 8);
}
void put_real(std::string& bytes, std::size_t at, float value) {
  const auto bits = std::bit_cast<std::uint32_t>(value);
  put_word(bytes, at, bits & 0xFFFFU);
  put_word(bytes, at + 2, bits >> 16);
}
void rename(std::string& bytes, std::string_view name, std::string_view other) {
  ASSERT_EQ(name.size(), other.size());
  bytes.replace(bytes.find(name, 512), name.size(), other);
}
std::size_t data_of(const std::string& bytes) {
  return (static_cast<std::uint8_t>(bytes[16]) - 1U) * 512U;
}

// readme_upstream.txt: all six hold the same data; POINT:SCALE is 0.28 mm, one step of integers,
// which were cut off instead of rounded.
TEST(ReadC3d, SixKindsOfFileHoldTheSameWalk) {
  const C3dFile expected = read_c3d(kVariants / "pc_real.c3d");
  EXPECT_EQ(expected.markers.names.size(), 36U);
  EXPECT_EQ(expected.markers.frames.size(), 89U);
  EXPECT_EQ(expected.markers.rate_hz, 50.0);
  EXPECT_EQ(expected.analog.size(), 16U);
  EXPECT_EQ(expected.analog[0].values.size(), 89U * 4U);
  const double step = 0.001 * std::abs(expected.find("POINT", "SCALE")->numbers().at(0));
  EXPECT_NEAR(step, 0.00028, 0.00001);
  for (std::size_t k = 0; k < 6; ++k) {
    SCOPED_TRACE(kSixFiles[k]);
    const C3dFile file = read_c3d(kVariants / kSixFiles[k]);
    EXPECT_EQ(file.processor, kSix[k].processor);
    EXPECT_EQ(file.storage, kSix[k].storage);
    EXPECT_EQ(file.markers.names, expected.markers.names);
    ASSERT_EQ(file.markers.frames.size(), 89U);
    const double tolerance = file.storage == C3dStorage::kReal ? 1e-9 : step;
    for (std::size_t f = 0; f < 89; ++f) {
      const MarkerFrame &a = expected.markers.frames[f], &b = file.markers.frames[f];
      ASSERT_EQ(b.visible, a.visible);
      ASSERT_EQ(b.residual, a.residual);
      for (std::size_t i = 0; i < 36; ++i) {
        ASSERT_LE((b.p_WM[i] - a.p_WM[i]).cwiseAbs().maxCoeff(), tolerance);
      }
    }
    ASSERT_EQ(file.analog.size(), 16U);
    for (std::size_t i = 0; i < 16; ++i) {
      EXPECT_EQ(file.analog[i].name, expected.analog[i].name);
      EXPECT_EQ(file.analog[i].unit, expected.analog[i].unit);
      EXPECT_EQ(file.analog[i].values, expected.analog[i].values);
    }
    ASSERT_GE(file.events.size(), 8U) << "dec_int.c3d lacks the last one";
    for (std::size_t i = 0; i < 8; ++i) {
      EXPECT_EQ(file.events[i].label, expected.events[i].label);
      EXPECT_NEAR(file.events[i].time, expected.events[i].time, 1e-6);
    }
    EXPECT_EQ(file.events[0].label, "RHS");
    EXPECT_NEAR(file.events[0].time, 0.38, 1e-6);
  }
}

TEST(ReadC3d, GivesTheStoredAnglesInDegrees) {
  const C3dFile file = read_c3d(kStatic);
  EXPECT_EQ(file.markers.names.size(), 115U);
  EXPECT_EQ(file.markers.names[0], "LFHD");
  ASSERT_EQ(file.derived.size(), 26U);
  for (const C3dDerived& d : file.derived) {
    EXPECT_EQ(d.kind, C3dKind::kAngle);
    EXPECT_EQ(d.unit, "deg");
    EXPECT_EQ(d.values.size(), 8U);
    EXPECT_EQ(std::count(d.valid.begin(), d.valid.end(), 1), 8);
  }
  // Someone standing upright and still.
  for (const char* name : {"LKneeAngles", "RKneeAngles", "LHipAngles", "RHipAngles"}) {
    const auto d = std::find_if(file.derived.begin(), file.derived.end(),
                                [&](const C3dDerived& x) { return x.name == name; });
    ASSERT_NE(d, file.derived.end()) << name;
    EXPECT_LT(std::abs(d->values[0].x()), 15.0);
    EXPECT_LT((d->values[0] - d->values[7]).norm(), 1.0);
  }
}

// Plug-in Gait's file has origin (O) and proximal end (P) of the bones too: the angle between
// femur and tibia contains the stored knee flexion (x), and little else.
TEST(ReadC3d, StoredKneeAnglesAgreeWithTheBonesInTheSameFile) {
  const C3dFile file = read_c3d(kWalk);
  double largest = 0.0;
  for (const std::string side : {"L", "R"}) {
    const auto knee = std::find_if(file.derived.begin(), file.derived.end(),
                                   [&](const auto& d) { return d.name == side + "KneeAngles"; });
    ASSERT_NE(knee, file.derived.end());
    const auto bone = [&](const MarkerFrame& frame, const std::string& name) -> Eigen::Vector3d {
      return (frame.p_WM[*file.markers.find(side + name + "P")] -
              frame.p_WM[*file.markers.find(side + name + "O")])
          .normalized();
    };
    for (std::size_t f = 0; f < file.markers.frames.size(); ++f) {
      ASSERT_EQ(knee->valid[f], 1);
      const MarkerFrame& frame = file.markers.frames[f];
      const double between =
          std::acos(bone(frame, "FE").dot(bone(frame, "TI"))) * 180.0 / 3.14159265358979;
      const double stored = std::hypot(knee->values[f].x(), knee->values[f].y());
      EXPECT_NEAR(stored, between, 1.0) << side << " frame " << f;
      largest = std::max(largest, stored);
    }
  }
  EXPECT_GT(largest, 45.0) << "a swinging leg's knee";
  EXPECT_LT(largest, 75.0);
}

TEST(ReadC3d, SplitsResultsFromMarkersOverMoreThan255Labels) {
  const C3dFile file = read_c3d(kWalk);
  EXPECT_EQ(file.markers.names.size() + file.derived.size(), 290U);
  std::array<std::size_t, 6> count{};
  for (const C3dDerived& d : file.derived) ++count[static_cast<std::size_t>(d.kind)];
  EXPECT_THAT(count, ElementsAre(55, 20, 18, 16, 2, 0));
  const auto power = std::find_if(file.derived.begin(), file.derived.end(),
                                  [](const auto& d) { return d.name == "RWristPower"; });
  ASSERT_NE(power, file.derived.end()) << "a label of LABELS2";
  EXPECT_EQ(power->unit, "W");
  EXPECT_EQ(file.markers.find("RWristPower"), std::nullopt);
  EXPECT_TRUE(file.markers.find("LASI"));
}

TEST(ReadC3d, NumbersFramesAndEventsAsTheFileDoes) {
  const C3dFile file = read_c3d(kWalk);
  EXPECT_EQ(file.first_frame, 221U);
  EXPECT_EQ(file.markers.frames.size(), 40U);
  ASSERT_EQ(file.events.size(), 4U);
  EXPECT_EQ(file.events[0].label, "Foot Strike");
  EXPECT_EQ(file.events[0].context, "Left");
  EXPECT_NEAR(file.events[0].time, 2.28, 1e-6);
  // The foot comes down on the first force plate, whose samples are ten a frame.
  const std::size_t strike = 229 - 221;
  ASSERT_EQ(file.analog.at(2).name, "Fz1");
  const std::vector<double>& force = file.analog[2].values;
  ASSERT_EQ(force.size(), 400U);
  for (std::size_t s = 0; s < 10 * (strike - 1); ++s) ASSERT_LT(std::abs(force[s]), 5.0) << s;
  for (std::size_t s = 10 * (strike + 2); s < 400; ++s) ASSERT_LT(force[s], -50.0) << s;
  const auto reaction = std::find_if(file.derived.begin(), file.derived.end(), [](const auto& d) {
    return d.name == "LGroundReactionForce";
  });
  ASSERT_NE(reaction, file.derived.end());
  EXPECT_EQ(std::find(reaction->valid.begin(), reaction->valid.end(), 1) - reaction->valid.begin(),
            static_cast<std::ptrdiff_t>(strike));
}

TEST(ReadC3d, KeepsAPrefixAndReadsMetres) {
  const C3dFile file = read_c3d(kServe);
  EXPECT_EQ(file.markers.names[0], "Derrick:C7");
  ASSERT_TRUE(file.markers.find("LFHD"));
  const Eigen::Vector3d head = file.markers.frames[0].p_WM[*file.markers.find("LFHD")];
  const Eigen::Vector3d heel = file.markers.frames[0].p_WM[*file.markers.find("LHEE")];
  EXPECT_NEAR(head.z() - heel.z(), 1.6, 0.1);
  EXPECT_EQ(file.marker_descriptions[0], "P005");
}

TEST(ReadC3d, KeepsEveryParameter) {
  const C3dFile file = read_c3d(kVariants / "dec_real.c3d");
  const C3dParameter* corners = file.find("force_platform", "Corners");
  ASSERT_NE(corners, nullptr) << "capitals do not matter";
  EXPECT_THAT(corners->dimensions, ElementsAre(3, 4, 2));
  EXPECT_NEAR(corners->numbers()[1], 1239.0626, 1e-3);
  EXPECT_THAT(file.find("SUBJECT", "NAME")->strings(), ElementsAre("Norm Walker"));
  EXPECT_NEAR(file.find("SUBJECT", "HEIGHT")->numbers()[0], 1.78, 1e-6);
  EXPECT_THAT(file.find("SUBJECT", "DOB")->numbers(), ElementsAre(28, 3, 65));
  EXPECT_EQ(file.find("SUBJECT", "EYES"), nullptr);
  EXPECT_TRUE(file.find("POINT", "USED")->locked);
}

TEST(ReadC3d, HidesPointsThatWereNotMeasured) {
  C3dFile content = small();
  content.derived.clear();
  content.analog.clear();
  std::string bytes = encode(content);
  const std::size_t data = data_of(bytes), point = 16, frame = 32;
  put_real(bytes, data + 12, -1.0F);                                         // frame 0, LASI
  put_real(bytes, data + point, NAN);                                        // frame 0, RASI
  for (int k = 0; k < 3; ++k) put_real(bytes, data + frame + 4U * k, 0.0F);  // frame 1, LASI
  put_real(bytes, data + frame + point + 12, -2.0F);                         // frame 1, RASI
  put_real(bytes, data + 2 * frame + 12, 258.0F);  // frame 2: residual 2 steps, camera 1
  put_real(bytes, data + 2 * frame + point + 12, NAN);
  const C3dFile file = parse(bytes);
  EXPECT_THAT(file.markers.frames[0].visible, ElementsAre(0, 0));
  EXPECT_THAT(file.markers.frames[1].visible, ElementsAre(0, 0));
  EXPECT_THAT(file.markers.frames[2].visible, ElementsAre(1, 0));
  const double scale = std::abs(file.find("POINT", "SCALE")->numbers()[0]);
  EXPECT_NEAR(file.markers.frames[2].residual[0], 0.002 * scale, 1e-9);
}

TEST(ReadC3d, TakesAZeroAngleForAnAngle) {
  C3dFile content = small();
  content.derived[0].values[2].setZero();
  const C3dFile file = parse(encode(content));
  EXPECT_THAT(file.derived[0].valid, ElementsAre(1, 0, 1));
  EXPECT_TRUE(file.derived[0].values[2].isZero(0.0));
}

TEST(ReadC3d, ReadsEveryUnitAsMetres) {
  std::string bytes = encode(small());
  const std::size_t unit = values_of(bytes, "UNITS");
  const auto x_of = [&](std::string_view text) {
    bytes.replace(unit, 2, text);
    return parse(bytes).markers.frames[0].p_WM[0].x();
  };
  EXPECT_NEAR(x_of("mm"), 0.1, 1e-6);
  EXPECT_NEAR(x_of("CM"), 1.0, 1e-6);
  EXPECT_NEAR(x_of("m "), 100.0, 1e-4);
  EXPECT_NEAR(x_of(std::string_view("m\0", 2)), 100.0, 1e-4);
  EXPECT_NEAR(x_of("in"), 2.54, 1e-5);
  EXPECT_NEAR(x_of("  "), 0.1, 1e-6) << "millimetres where nothing is said";
  bytes.replace(unit, 2, "km");
  EXPECT_THAT(complaint(bytes),
              AllOf(HasSubstr("test.c3d: POINT:UNITS"), HasSubstr("\"km\""), HasSubstr("mm, cm")));
}

TEST(ReadC3d, ReadsUnsignedAnalogSamples) {
  C3dFile content = small();
  content.analog[0].values = {0.0, 1.0, 30000.0, 32768.0, 40000.0, 65535.0};
  content.set("ANALOG", {.name = "FORMAT", .dimensions = {8}, .values = std::string("UNSIGNED")});
  std::string bytes = encode(content, kSix[0]);
  EXPECT_EQ(parse(bytes).analog[0].values, content.analog[0].values);
  // The same bits, read as signed.
  rename(bytes, "UNSIGNED", "SIGNED  ");
  EXPECT_THAT(parse(bytes).analog[0].values, ElementsAre(0, 1, 30000, -32768, -25536, -1));
}

TEST(ReadC3d, AppliesGeneralScaleScaleAndOffset) {
  C3dFile content = small();
  content.analog[0].scale = -0.5;
  content.analog[0].offset = 2048.0;
  content.set("ANALOG", {.name = "GEN_SCALE", .values = std::vector<float>{0.25F}});
  const std::string bytes = encode(content, kSix[0]);
  const C3dFile file = parse(bytes);
  EXPECT_THAT(file.find("ANALOG", "SCALE")->numbers(), ElementsAre(-2.0));
  EXPECT_THAT(file.find("ANALOG", "OFFSET")->numbers(), ElementsAre(2048.0));
  EXPECT_EQ(file.analog[0].values, content.analog[0].values);
  // The first sample, 1 N, behind three points of 8 bytes.
  const std::size_t at = data_of(bytes) + 24;
  EXPECT_EQ(static_cast<std::uint8_t>(bytes[at]) + 256 * static_cast<std::uint8_t>(bytes[at + 1]),
            2046);
}

TEST(ReadC3d, CountsMoreFramesThanAWordHolds) {
  C3dFile content;
  content.markers.names = {"A"};
  content.markers.rate_hz = 240.0;
  content.first_frame = 7;
  constexpr std::size_t kFrames = 70000;
  MarkerFrame frame(1);
  frame.visible = {1};
  for (std::size_t f = 0; f < kFrames; ++f) {
    frame.p_WM[0] = {1e-3 * static_cast<double>(f % 30000), 1.0, 1.0};
    content.markers.frames.push_back(frame);
  }
  std::string bytes = encode(content, kSix[0]);
  for (const bool has_long_frames : {true, false}) {
    if (!has_long_frames) rename(bytes, "LONG_FRAMES", "XONG_FRAMES");
    const C3dFile file = parse(bytes);
    ASSERT_EQ(file.markers.frames.size(), kFrames);
    EXPECT_EQ(file.first_frame, 7U);
    EXPECT_NEAR(file.markers.frames[69999].p_WM[0].x(), 9.999, 1e-3);
  }
  // Without either parameter the word is all there is.
  rename(bytes, "ACTUAL_END_FIELD", "XCTUAL_END_FIELD");
  EXPECT_EQ(parse(bytes).markers.frames.size(), 65535U);
}

TEST(ReadC3d, NamesPointsWithoutALabelAndWithOneTwice) {
  C3dFile content = small();
  content.derived.clear();
  content.markers.names = {"A", "A"};
  EXPECT_THAT(parse(encode(content)).markers.names, ElementsAre("A", "A_2"));
  std::string bytes = encode(content);
  rename(bytes, "LABELS", "XABELS");
  EXPECT_THAT(parse(bytes).markers.names, ElementsAre("*1", "*2"));
}

TEST(ReadC3d, LetsTheDatasLengthDecideWhereHeaderAndParametersDisagree) {
  const std::string bytes = encode(small());
  std::string header_wrong = bytes;
  put_word(header_wrong, 2, 30);
  EXPECT_EQ(parse(header_wrong).markers.frames.size(), 3U);
  std::string parameter_wrong = bytes;
  put_word(parameter_wrong, values_of(bytes, "USED"), 40);
  EXPECT_EQ(parse(parameter_wrong).derived.size(), 1U);
  std::string both_wrong = parameter_wrong;
  put_word(both_wrong, 2, 30);
  EXPECT_THAT(complaint(both_wrong), AllOf(HasSubstr("byte 2"), HasSubstr("3 frames of 30 points"),
                                           HasSubstr("3 frames of 40 points")));
  std::string pointer_wrong = bytes;
  put_word(pointer_wrong, 16, 60000);
  EXPECT_EQ(parse(pointer_wrong).markers.frames.size(), 3U) << "POINT:DATA_START is right";
}

TEST(ReadC3d, SaysWhatIsWrongAndWhere) {
  const std::string bytes = encode(small());
  const auto with_byte = [&](std::size_t at, unsigned value) {
    std::string other = bytes;
    other[at] = static_cast<char>(value);
    return other;
  };
  const auto with_word = [&](std::string_view name, unsigned value) {
    std::string other = bytes;
    put_word(other, values_of(bytes, name), value);
    return other;
  };
  const auto with_real = [&](std::string_view name, float value, std::size_t header) {
    std::string other = bytes;
    put_real(other, values_of(bytes, name), value);
    put_real(other, header, value);
    return other;
  };
  EXPECT_THAT(complaint(""), HasSubstr("test.c3d: byte 0: found the end of the file"));
  EXPECT_THAT(complaint(bytes.substr(0, 511)), HasSubstr("byte 511: found the end of the file"));
  EXPECT_THAT(complaint(with_byte(1, 0x51)), HasSubstr("byte 1: found 0x51, expected 0x50"));
  EXPECT_THAT(complaint(with_byte(0, 0)), HasSubstr("byte 0: found 0 as the block"));
  EXPECT_THAT(complaint(with_byte(0, 200)), HasSubstr("byte 0: found 200 as the block"));
  EXPECT_THAT(complaint(with_byte(515, 83)), HasSubstr("byte 515: found processor 83"));
  EXPECT_THAT(complaint(with_byte(516, 0)), HasSubstr("byte 516: found no parameters"));
  const std::size_t used = values_of(bytes, "USED");
  EXPECT_THAT(complaint(with_byte(used - 2, 3)), HasSubstr("type 3 of parameter \"USED\""));
  EXPECT_THAT(complaint(with_byte(used - 1, 8)), HasSubstr("8 dimensions of parameter \"USED\""));
  EXPECT_THAT(complaint(with_byte(used - 4, 2)),
              HasSubstr(std::to_string(used - 4) + ": found 2 bytes to the next record"));
  std::string longer = with_word("FRAMES", 50);
  EXPECT_EQ(complaint(longer), "accepted") << "the header's three frames fill the file";
  put_word(longer, 8, 50);
  EXPECT_THAT(complaint(longer), AllOf(HasSubstr("the end of the file after 9 frames"),
                                       HasSubstr("expected 50 frames of 3 points")));
  EXPECT_THAT(complaint(with_real("SCALE", 0.0F, 12)), HasSubstr("POINT:SCALE: found 0"));
  EXPECT_THAT(complaint(with_real("RATE", -5.0F, 20)), HasSubstr("POINT:RATE: found -5"));
  EXPECT_THAT(complaint(with_real("RATE", NAN, 20)), HasSubstr("POINT:RATE: found nan"));
  std::string huge = bytes;
  put_real(huge, data_of(bytes), 2e9F);
  EXPECT_THAT(complaint(huge), AllOf(HasSubstr("byte " + std::to_string(data_of(bytes))),
                                     HasSubstr("2e+09 of point \"LASI\" in frame 1")));
  EXPECT_THROW(read_c3d(kData / "missing.c3d"), C3dError);
  EXPECT_THROW(read_c3d(kData), C3dError);
}

TEST(ReadC3d, RefusesAFileThatIsTornAnywhere) {
  const std::string bytes = encode(small());
  const std::size_t data = data_of(bytes), end = data + 3 * (3 * 16 + 2 * 4);
  ASSERT_LT(end, bytes.size());
  for (std::size_t size = 0; size < bytes.size(); ++size) {
    const std::string said = complaint(bytes.substr(0, size));
    if (size < end) {
      ASSERT_THAT(said, HasSubstr("test.c3d: ")) << size;
    } else {
      ASSERT_EQ(said, "accepted") << "only the last block's filling is missing, " << size;
    }
  }
  for (const char* file : kSixFiles) {
    const std::string whole = contents(kVariants / file);
    EXPECT_THAT(complaint(whole.substr(0, whole.size() - 1024)),
                HasSubstr("found the end of the file after 8"));
  }
}

// Whatever the bytes, either a file or a C3dError comes out, and never more than was put in.
TEST(ReadC3d, SurvivesAnyDamage) {
  std::mt19937 generator(33);
  const auto below = [&](std::size_t n) { return generator() % n; };
  std::vector<std::pair<std::string, int>> files;
  for (const char* file : kSixFiles) files.emplace_back(contents(kVariants / file), 500);
  files.emplace_back(contents(kStatic), 500);
  files.emplace_back(contents(kServe), 500);
  files.emplace_back(contents(kWalk), 100);
  files.emplace_back(encode(small()), 3000);
  files.emplace_back(encode(small(), kSix[2]), 3000);
  std::size_t accepted = 0, refused = 0;
  for (const auto& [whole, rounds] : files) {
    ASSERT_EQ(complaint(whole), "accepted");
    const std::size_t head = data_of(whole);
    for (int round = 0; round < rounds; ++round) {
      std::string bytes = whole;
      for (std::size_t damage = 1 + below(8); damage-- > 0;) {
        // Most of it in header and parameters, where it matters.
        const std::size_t reach = std::min(bytes.size(), below(4) > 0 ? head : bytes.size());
        if (reach < 2) break;
        const std::size_t at = below(reach - 1);
        switch (below(8)) {
          case 0:
            bytes[at] = static_cast<char>(generator());
            break;
          case 1:
            bytes[at] = static_cast<char>(bytes[at] ^ 1 << below(8));
            break;
          case 2:
            put_word(bytes, at, 0xFFFF);
            break;
          case 3:
            put_word(bytes, at, generator() & 0xFFFFU);
            break;
          case 4:
            bytes[at] = '\0';
            break;
          case 5:
            bytes[below(24)] = static_cast<char>(generator());
            break;
          case 6:
            bytes.erase(at, 1 + below(4));
            break;
          default:
            if (below(8) == 0) bytes.resize(below(bytes.size()));
            break;
        }
      }
      try {
        const C3dFile file = parse(bytes);
        ++accepted;
        const std::size_t points = file.markers.names.size() + file.derived.size();
        ASSERT_LE(file.markers.frames.size() * points * 8, bytes.size());
        ASSERT_LE(file.markers.frames.size(), bytes.size());
        for (const MarkerFrame& frame : file.markers.frames) {
          ASSERT_EQ(frame.p_WM.size(), file.markers.names.size());
        }
      } catch (const C3dError&) {
        ++refused;
      }
    }
  }
  EXPECT_GT(accepted, 100U);
  EXPECT_GT(refused, 100U);
}

// ---------------------------------------------------------------------------------------------

struct Random {
  explicit Random(unsigned seed) : generator(seed) {}
  double real(double low, double high) {
    return std::uniform_real_distribution<double>(low, high)(generator);
  }
  std::size_t number(std::size_t low, std::size_t high) {
    return std::uniform_int_distribution<std::size_t>(low, high)(generator);
  }
  bool one_in(std::size_t n) { return number(1, n) == 1; }
  std::string word(std::size_t most) {
    std::string text;
    for (std::size_t i = number(1, most); i-- > 0;) {
      text += static_cast<char>('A' + number(0, 25));
    }
    return text;
  }

  C3dFile file() {
    C3dFile file;
    const std::size_t frames = number(1, 12), markers = number(0, one_in(6) ? 300 : 8);
    file.markers.rate_hz = static_cast<float>(real(1.0, 1000.0));
    file.first_frame = number(0, one_in(4) ? 200000 : 500);
    for (std::size_t i = 0; i < markers; ++i) {
      file.markers.names.push_back(word(12) + std::to_string(i));
      file.marker_descriptions.push_back(one_in(2) ? word(40) : "");
    }
    if (one_in(3)) file.marker_descriptions.assign(markers, "");
    for (std::size_t f = 0; f < frames; ++f) {
      MarkerFrame frame(markers);
      for (std::size_t i = 0; i < markers; ++i) {
        if (one_in(4)) continue;
        frame.p_WM[i] = {real(-3, 3), real(-3, 3), real(-3, 3)};
        frame.visible[i] = 1;
        if (one_in(2)) frame.residual[i] = static_cast<float>(real(0, 0.01));
      }
      file.markers.frames.push_back(frame);
    }
    for (std::size_t i = markers == 0 ? 1 : number(0, 6); i-- > 0;) {
      static constexpr std::array<const char*, 6> kUnits{"deg", "N", "Nmm", "W", "mm", ""};
      const std::size_t kind = number(0, 5);
      C3dDerived d{.name = "D" + std::to_string(i) + word(6),
                   .description = one_in(2) ? word(8) : "",
                   .kind = static_cast<C3dKind>(kind),
                   .unit = kUnits[kind]};
      for (std::size_t f = 0; f < frames; ++f) {
        d.valid.push_back(one_in(4) ? 0 : 1);
        d.values.emplace_back(0, 0, 0);
        if (d.valid[f]) d.values[f] = {real(-180, 180), real(-180, 180), real(-180, 180)};
      }
      file.derived.push_back(d);
    }
    const std::size_t samples = number(1, 5);
    for (std::size_t i = one_in(3) ? 0 : number(0, one_in(5) ? 300 : 5); i-- > 0;) {
      C3dAnalog channel{.name = "Ch" + std::to_string(i), .description = word(9), .unit = "V"};
      channel.scale = real(0.001, 1.0) * (one_in(2) ? -1 : 1);
      channel.offset = one_in(2) ? 0.0 : std::floor(real(-3000, 3000));
      for (std::size_t s = 0; s < samples * frames; ++s) {
        channel.values.push_back(real(-100, 100));
      }
      file.analog.push_back(channel);
    }
    for (std::size_t i = number(0, 4); i-- > 0;) {
      file.events.push_back({word(9), one_in(2) ? "Left" : "", real(0, 100)});
    }
    C3dParameter bytes{.name = "FLAGS", .description = word(30), .locked = true};
    bytes.dimensions = {static_cast<std::uint8_t>(number(0, 255))};
    bytes.values = std::vector<std::int8_t>(bytes.dimensions[0], -3);
    file.set("OWN", bytes);
    file.set("OWN", {.name = "MATRIX",
                     .dimensions = {2, 3},
                     .values = std::vector<float>{1.5F, -2e-20F, 3e30F, 0.0F, 0.1F, -1.0F}});
    file.set("OWN", {.name = "TEXT", .dimensions = {3, 2}, .values = std::string("ab c  ")});
    if (one_in(2)) file.set("ANALOG", {.name = "GEN_SCALE", .values = std::vector<float>{0.3F}});
    if (one_in(3)) {
      file.set("POINT", {.name = "UNITS", .dimensions = {2}, .values = std::string("cm")});
    }
    return file;
  }

  std::mt19937 generator;
};

void expect_near(const std::vector<Eigen::Vector3d>& a, const std::vector<Eigen::Vector3d>& b,
                 const std::vector<std::uint8_t>& valid, double tolerance) {
  ASSERT_EQ(a.size(), b.size());
  for (std::size_t i = 0; i < a.size(); ++i) {
    if (valid[i]) {
      ASSERT_LE((a[i] - b[i]).cwiseAbs().maxCoeff(), tolerance) << i;
    }
  }
}

void expect_same(const C3dFile& expected, const C3dFile& file) {
  const bool real = file.storage == C3dStorage::kReal;
  const double scale = std::abs(file.find("POINT", "SCALE")->numbers().at(0));
  const std::string unit = file.find("POINT", "UNITS")->strings().at(0);
  const double metres = unit == "cm" ? 0.01 : unit == "m" ? 1.0 : 0.001;
  EXPECT_EQ(file.markers.names, expected.markers.names);
  EXPECT_EQ(file.markers.rate_hz, expected.markers.rate_hz);
  EXPECT_EQ(file.first_frame, expected.first_frame);
  ASSERT_EQ(file.markers.frames.size(), expected.markers.frames.size());
  const double point_tolerance = real ? 4e-7 : 0.501 * scale * metres;
  for (std::size_t f = 0; f < expected.markers.frames.size(); ++f) {
    const MarkerFrame &a = expected.markers.frames[f], &b = file.markers.frames[f];
    ASSERT_EQ(b.visible, a.visible);
    ASSERT_NO_FATAL_FAILURE(expect_near(b.p_WM, a.p_WM, a.visible, point_tolerance));
    for (std::size_t i = 0; i < a.visible.size(); ++i) {
      if (!a.visible[i]) continue;
      ASSERT_EQ(a.residual[i] > 0.0F, b.residual[i] > 0.0F) << "0 means unknown";
      if (a.residual[i] < 255 * scale * metres) {
        ASSERT_NEAR(a.residual[i], b.residual[i], 1.0001 * scale * metres);
      }
    }
  }
  ASSERT_EQ(file.derived.size(), expected.derived.size());
  for (std::size_t i = 0; i < expected.derived.size(); ++i) {
    const C3dDerived &a = expected.derived[i], &b = file.derived[i];
    EXPECT_EQ(b.name, a.name);
    EXPECT_EQ(b.description, a.description);
    EXPECT_EQ(b.kind, a.kind);
    EXPECT_EQ(b.unit, a.unit);
    ASSERT_EQ(b.valid, a.valid);
    double largest = 0.0;
    for (const auto& v : a.values) largest = std::max(largest, v.cwiseAbs().maxCoeff());
    ASSERT_NO_FATAL_FAILURE(
        expect_near(b.values, a.values, a.valid, real ? 1e-7 * largest : 0.501 * scale));
  }
  ASSERT_EQ(file.analog.size(), expected.analog.size());
  for (std::size_t i = 0; i < expected.analog.size(); ++i) {
    const C3dAnalog &a = expected.analog[i], &b = file.analog[i];
    EXPECT_EQ(b.name, a.name);
    EXPECT_EQ(b.unit, a.unit);
    EXPECT_EQ(b.description, a.description);
    ASSERT_EQ(b.values.size(), a.values.size());
    for (std::size_t s = 0; s < a.values.size(); ++s) {
      const double stored = a.values[s] / b.scale + b.offset;
      const double error = real ? std::abs(stored) * 6e-8 : 0.501;
      ASSERT_NEAR(b.values[s], a.values[s],
                  error * std::abs(b.scale) + 1e-7 * std::abs(a.values[s]));
    }
  }
  ASSERT_EQ(file.events.size(), expected.events.size());
  for (std::size_t i = 0; i < expected.events.size(); ++i) {
    EXPECT_EQ(file.events[i].label, expected.events[i].label);
    EXPECT_EQ(file.events[i].context, expected.events[i].context);
    EXPECT_NEAR(file.events[i].time, expected.events[i].time, 1e-5);
  }
}

TEST(WriteC3d, WhatIsWrittenIsReadBackInAllSixKinds) {
  Random random(34);
  for (int draw = 0; draw < 300; ++draw) {
    const C3dFile content = random.file();
    for (const Variant& variant : kSix) {
      SCOPED_TRACE(testing::Message()
                   << "draw " << draw << " processor " << static_cast<int>(variant.processor)
                   << " storage " << static_cast<int>(variant.storage));
      const std::string bytes = encode(content, variant);
      ASSERT_EQ(bytes.size() % 512, 0U);
      const C3dFile file = parse(bytes);
      EXPECT_EQ(file.processor, variant.processor);
      EXPECT_EQ(file.storage, variant.storage);
      ASSERT_NO_FATAL_FAILURE(expect_same(content, file));
      ASSERT_FALSE(testing::Test::HasFailure());
      for (const char* name : {"FLAGS", "MATRIX", "TEXT"}) {
        const C3dParameter &a = *content.find("OWN", name), *b = file.find("OWN", name);
        ASSERT_NE(b, nullptr);
        EXPECT_EQ(b->description, a.description);
        EXPECT_EQ(b->locked, a.locked);
        EXPECT_EQ(b->dimensions, a.dimensions);
        EXPECT_EQ(b->values, a.values);
      }
      // Nothing more is lost the second time.
      ASSERT_EQ(encode(file, variant), bytes);
    }
  }
}

TEST(WriteC3d, TurnsEachKindOfTheSameWalkIntoEachOther) {
  const C3dFile expected = read_c3d(kVariants / "pc_int.c3d");
  for (const char* name : kSixFiles) {
    const C3dFile source = read_c3d(kVariants / name);
    for (const Variant& variant : kSix) {
      const C3dFile file = parse(encode(source, variant));
      EXPECT_EQ(file.find("FORCE_PLATFORM", "CORNERS")->values,
                source.find("FORCE_PLATFORM", "CORNERS")->values);
      ASSERT_EQ(file.markers.frames.size(), 89U);
      for (std::size_t f = 0; f < 89; ++f) {
        const MarkerFrame &a = expected.markers.frames[f], &b = file.markers.frames[f];
        ASSERT_EQ(b.visible, a.visible);
        ASSERT_EQ(b.residual, a.residual);
        ASSERT_NO_FATAL_FAILURE(expect_near(b.p_WM, a.p_WM, a.visible, 0.000282));
      }
      ASSERT_EQ(file.analog.size(), 16U);
      for (std::size_t i = 0; i < 16; ++i) {
        ASSERT_EQ(file.analog[i].values, expected.analog[i].values) << name;
      }
    }
  }
}

// 290 points, LABELS2, 24 channels, six groups of lists.
TEST(WriteC3d, KeepsAPlugInGaitFile) {
  const C3dFile source = read_c3d(kWalk);
  const C3dFile file = parse(encode(source));
  ASSERT_NO_FATAL_FAILURE(expect_same(source, file));
  EXPECT_EQ(file.marker_descriptions, source.marker_descriptions);
  ASSERT_NE(file.find("PROCESSING", "LLegLength"), nullptr);
  EXPECT_EQ(file.find("PROCESSING", "LLegLength")->numbers().at(0), 740.0);
  EXPECT_EQ(file.find("EVENT", "SUBJECTS")->strings(), source.find("EVENT", "SUBJECTS")->strings());
}

TEST(WriteC3d, KeepsIntegersAsTheyWere) {
  const std::string bytes = contents(kVariants / "sgi_int.c3d");
  const C3dFile source = parse(bytes);
  const std::string written = encode(source, kSix[4]);
  // SGI: the data's block is the second byte of word 9.
  const std::size_t block = static_cast<std::uint8_t>(written[17]);
  const std::size_t size = 89 * (36 * 8 + 64 * 2);
  std::size_t differing = 0;
  for (std::size_t i = 0; i < size; ++i) {
    // Cameras, the upper byte of every fourth word, are not kept.
    const std::size_t in_frame = i % (36 * 8 + 64 * 2);
    if (in_frame < 36 * 8 && in_frame % 8 == 6) continue;
    differing += written[(block - 1) * 512 + i] != bytes[12 * 512 + i];
  }
  EXPECT_EQ(differing, 0U);
}

// The serve's file is real, in metres, with a POINT:SCALE of 1 that means nothing; the walk's
// channels have a scale of 1, and some are in volts.
TEST(WriteC3d, TakesTheFinestStepsWhereTheOldOnesWouldRound) {
  const C3dFile serve = read_c3d(kServe);
  const C3dFile integers = parse(encode(serve, kSix[0]));
  for (std::size_t f = 0; f < serve.markers.frames.size(); ++f) {
    ASSERT_NO_FATAL_FAILURE(expect_near(integers.markers.frames[f].p_WM,
                                        serve.markers.frames[f].p_WM,
                                        serve.markers.frames[f].visible, 5e-5));
  }
  // Steps that were the finest once, and one value that is none of them any more.
  C3dFile moved = integers;
  moved.markers.frames[1].p_WM[2].x() += 1e-5;
  const C3dFile integers_again = parse(encode(moved, kSix[0]));
  EXPECT_EQ(integers_again.find("POINT", "SCALE")->values, integers.find("POINT", "SCALE")->values);
  ASSERT_NO_FATAL_FAILURE(expect_near(integers_again.markers.frames[1].p_WM,
                                      moved.markers.frames[1].p_WM, moved.markers.frames[1].visible,
                                      5e-5));

  const C3dFile walk = read_c3d(kWalk);
  const C3dFile integer_walk = parse(encode(walk, kSix[0]));
  for (std::size_t i = 0; i < walk.analog.size(); ++i) {
    double largest = 0.0;
    for (const double value : walk.analog[i].values) largest = std::max(largest, std::abs(value));
    for (std::size_t s = 0; s < walk.analog[i].values.size(); ++s) {
      ASSERT_NEAR(integer_walk.analog[i].values[s], walk.analog[i].values[s], largest / 60000);
    }
  }
}

TEST(WriteC3d, RefusesWhatTheFormatCannotHold) {
  C3dFile file = small();
  file.markers.frames.clear();
  EXPECT_THAT(refusal(file), HasSubstr("no frames"));
  file = small();
  file.markers.frames[1].visible.pop_back();
  EXPECT_THAT(refusal(file), HasSubstr("a frame of 2 markers"));
  file = small();
  file.markers.names[0] = std::string(256, 'A');
  EXPECT_THAT(refusal(file), HasSubstr("POINT:LABELS"));
  file = small();
  file.markers.rate_hz = 0.0;
  EXPECT_THAT(refusal(file), HasSubstr("a rate of 0 Hz"));
  file = small();
  file.markers.frames[0].p_WM[0].x() = NAN;
  EXPECT_THAT(refusal(file), HasSubstr("a point in frame 1 is not finite"));
  file = small();
  file.analog[0].values.pop_back();
  EXPECT_THAT(refusal(file), HasSubstr("5 samples of channel Fz1"));
  file = small();
  file.derived[0].values.pop_back();
  EXPECT_THAT(refusal(file), HasSubstr("2 values of LKneeAngles"));
  file = small();
  file.derived.push_back(file.derived[0]);
  file.derived[1].unit = "rad";
  EXPECT_THAT(refusal(file), HasSubstr("in rad, others of POINT:ANGLES in deg"));
  file = small();
  file.set("OWN", {.name = "ODD", .dimensions = {3}, .values = std::vector<float>{1.0F}});
  EXPECT_THAT(refusal(file), HasSubstr("OWN:ODD has 1 values"));
  file = small();
  file.set("OWN", {.name = "HUGE", .values = std::vector<float>{3e38F}});
  EXPECT_EQ(refusal(file), "accepted");
  EXPECT_THAT(refusal(file, kSix[3]), HasSubstr("more than a DEC file can hold"));
  file = small();
  file.analog[0].values[0] = NAN;
  EXPECT_EQ(refusal(file), "accepted");
  EXPECT_THAT(refusal(file, kSix[0]), HasSubstr("channel Fz1"));
}

TEST(WriteC3d, LeavesAWholeFileOrNone) {
  const auto folder = std::filesystem::path(testing::TempDir()) / "secondskin_write_c3d";
  std::filesystem::remove_all(folder);
  std::filesystem::create_directories(folder);
  const auto write = [&](const C3dFile& file, const char* name) {
    write_c3d(file, folder / name, C3dProcessor::kIntel, C3dStorage::kReal);
  };
  write(small(), "a.c3d");
  C3dFile wrong = small();
  wrong.markers.frames.clear();
  EXPECT_THROW(write(wrong, "a.c3d"), C3dError);
  EXPECT_EQ(read_c3d(folder / "a.c3d").markers.frames.size(), 3U);
  std::filesystem::create_directories(folder / "b.c3d" / "inside");
  EXPECT_THROW(write(small(), "b.c3d"), std::system_error);
  EXPECT_THROW(write(small(), "missing/c.c3d"), std::system_error);
  if (std::filesystem::exists("/dev/full")) {
    std::filesystem::create_symlink("/dev/full", folder / "d.c3d.partial");
    EXPECT_THROW(write(small(), "d.c3d"), std::system_error);
  }
  std::size_t files = 0;
  for ([[maybe_unused]] const auto& entry : std::filesystem::directory_iterator(folder)) ++files;
  EXPECT_EQ(files, 2U);
  std::filesystem::remove_all(folder);
}

}  // namespace
}  // namespace secondskin
