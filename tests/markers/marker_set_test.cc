#include "server/markers/marker_set.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>

namespace secondskin::server {
namespace {

using testing::HasSubstr;

const std::filesystem::path kSets = std::filesystem::path(SECONDSKIN_SOURCE_DIR) / "marker_sets";

// What load throws of a file with this text.
std::string error_of(const std::string& text) {
  const std::filesystem::path file =
      std::filesystem::path(testing::TempDir()) / "secondskin_marker_set_test.toml";
  std::ofstream(file) << text;
  try {
    (void)MarkerSet::load(file);
  } catch (const std::runtime_error& error) {
    return error.what();
  }
  return "";
}

constexpr const char* kGood =
    "name = \"two\"\nstature = 1.75\n"
    "[[marker]]\nnames = [\"LKNE\", \"KNEE\"]\nmirror = \"RKNE\"\nsegment = \"left_hip\"\n"
    "at = [0.0, 0.05, -0.4]\nspread = 0.01\n";

TEST(MarkerSet, MirrorsTheOtherSide) {
  EXPECT_EQ(error_of(kGood), "");
  const MarkerSet set = MarkerSet::load(std::filesystem::path(testing::TempDir()) /
                                        "secondskin_marker_set_test.toml");
  ASSERT_EQ(set.places().size(), 2u);
  EXPECT_EQ(set.places()[1].segment, Joint::kRightHip);
  EXPECT_EQ(set.places()[1].p_BM, Eigen::Vector3d(0.0, -0.05, -0.4));
}

TEST(MarkerSet, SaysFileAndLineOfWhatIsWrong) {
  EXPECT_THAT(
      error_of("stature = 1.75\n[[marker]]\nnames = \"A\"\nsegment = \"tail\"\nat = [0,0,0]"),
      testing::AllOf(HasSubstr(".toml:4:"), HasSubstr("canonical joint")));
  EXPECT_THAT(error_of("stature = 1.75\n[[marker]]\nnames = \"A\"\nsegment = \"head\"\nat = [0,0]"),
              testing::AllOf(HasSubstr(".toml:5:"), HasSubstr("[x, y, z]")));
  EXPECT_THAT(error_of("stature = 175\n[[marker]]\nnames = \"A\""), HasSubstr("stature"));
  EXPECT_THAT(error_of(std::string(kGood) + "colour = \"red\"\n"), HasSubstr("colour"));
  EXPECT_THAT(error_of(std::string(kGood) + "[[marker]]\nnames = \"rkne\"\nsegment = \"head\"\n"
                                            "at = [0,0,0]\n"),
              HasSubstr("named twice"));
  EXPECT_THAT(error_of("stature = 1.75\n[[marker]\n"), HasSubstr(".toml:2:"));
}

TEST(MarkerSet, KnowsPlugInGaitWithAndWithoutASubjectsPrefix) {
  const std::vector<std::string> plain{"LASI", "RASI", "LPSI", "RPSI", "C7",
                                       "LKNE", "RKNE", "LANK", "RANK"};
  std::vector<std::string> prefixed;
  for (const std::string& name : plain) prefixed.push_back("Derrick:" + name);
  for (const auto& names : {plain, prefixed}) {
    const MarkerSet set = MarkerSet::choose(kSets, names);
    EXPECT_EQ(set.name(), "Plug-in Gait");
    std::size_t found = 0;
    for (const auto& marker : set.match(names)) found += marker ? 1 : 0;
    EXPECT_EQ(found, plain.size());
  }
}

TEST(MarkerSet, ListsTheNamesThatNoSetKnows) {
  try {
    (void)MarkerSet::choose(kSets, {"M001", "M002", "M003"});
    FAIL();
  } catch (const std::runtime_error& error) {
    EXPECT_THAT(error.what(), testing::AllOf(HasSubstr("M001"), HasSubstr("M003")));
  }
}

TEST(MarkerSet, PlacesASuitsDetectorsOnTheSkin) {
  Suit suit;
  suit.name = "one";
  suit.detectors.push_back({"left_arm_1", 0, 0, Joint::kLeftShoulder, 0.5, 0.0});
  const Skeleton body = canonical_skeleton(1.8);
  const MarkerSet set = MarkerSet::from_suit(suit, body);
  ASSERT_EQ(set.places().size(), 1u);
  EXPECT_EQ(set.places()[0].segment, Joint::kLeftShoulder);
  EXPECT_GT(set.places()[0].p_BM.x(), 0.02);  // angle 0 is the front
  EXPECT_LT(set.places()[0].p_BM.z(), -0.1);  // half-way down the arm
}

}  // namespace
}  // namespace secondskin::server
