#include "coach/tactile/calibration.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <fstream>
#include <random>

namespace secondskin::coach {
namespace {

using testing::HasSubstr;

const std::filesystem::path kMaps = std::filesystem::path(SECONDSKIN_SOURCE_DIR) / "body_maps";

TEST(ThresholdStaircase, FindsWhatAPersonFeels) {
  std::mt19937 generator(1);
  std::normal_distribution<double> noise(0.0, 0.10);  // of the logarithm
  double worst = 0.0, sum = 0.0;
  constexpr int kPeople = 200;
  for (int person = 0; person < kPeople; ++person) {
    const double truth = 0.33 + 0.4 * (person / double{kPeople});
    ThresholdStaircase staircase(0.30, 1.0, static_cast<std::uint32_t>(person));
    int trials = 0;
    while (const auto level = staircase.next()) {
      ASSERT_LT(++trials, 70);
      ASSERT_TRUE(*level == 0.0 || (*level >= 0.30 && *level <= 1.0));
      staircase.answer(*level > 0.0 && std::log(*level / truth) + noise(generator) > 0.0);
    }
    ASSERT_TRUE(staircase.felt());
    const double off = std::log(staircase.threshold() / truth);
    worst = std::max(worst, std::abs(off));
    sum += off;
    EXPECT_EQ(staircase.false_alarms(), 0u);
  }
  EXPECT_LT(worst, std::log(1.45));  // two noticeable steps
  EXPECT_LT(std::abs(sum / kPeople), std::log(1.2));
}

TEST(ThresholdStaircase, EndsForThoseWhoFeelAllNothingOrAnswerAtRandom) {
  std::mt19937 generator(2);
  for (int kind = 0; kind < 3; ++kind) {
    for (std::uint32_t seed = 0; seed < 300; ++seed) {
      ThresholdStaircase staircase(0.30, 0.8, seed);
      int trials = 0;
      while (const auto level = staircase.next()) {
        ASSERT_LT(++trials, 120);
        ASSERT_LE(*level, 0.8);
        staircase.answer(kind == 0 ? true : kind == 1 ? false : generator() % 2 == 0);
      }
      if (kind == 0) {
        EXPECT_DOUBLE_EQ(staircase.threshold(), 0.30);
        EXPECT_EQ(staircase.false_alarms(), staircase.catch_trials());
      }
      if (kind == 1) {
        EXPECT_FALSE(staircase.felt());
      }
    }
  }
}

TEST(ComfortRamp, StopsBelowWhatIsTooStrongAndAtTheCeiling) {
  for (const double limit : {0.2, 0.5, 0.9, 2.0}) {
    ComfortRamp ramp(0.36, 0.8);
    double strongest = 0.0;
    while (const auto level = ramp.next()) {
      ASSERT_LE(*level, 0.8);
      strongest = *level;
      ramp.answer(*level > limit);
    }
    EXPECT_LE(ramp.comfortable(), std::max(limit, 0.36));
    EXPECT_GE(ramp.comfortable(), 0.36);
    if (limit > 0.8) {
      EXPECT_DOUBLE_EQ(ramp.comfortable(), 0.8);
    }
    EXPECT_LE(strongest, 1.2 * ramp.comfortable() + 1e-12);
  }
}

TEST(WhichOneTest, PresentsEachSiteEquallyOftenAndCounts) {
  WhichOneTest test({3, 5, 9}, 4, 7);
  std::array<int, wire::kTactorCount> shown{};
  while (const auto channel = test.next()) {
    ++shown[*channel];
    test.answer(*channel == 9 ? 5 : *channel);
  }
  EXPECT_EQ(shown[3], 4);
  EXPECT_EQ(shown[5], 4);
  EXPECT_EQ(shown[9], 4);
  EXPECT_EQ(test.confusion()[9][5], 4u);
  EXPECT_EQ(test.confusion()[3][3], 4u);
  EXPECT_EQ(test.left(), 0u);
}

SiteProfile site(std::size_t channel, double threshold, double ceiling) {
  SiteProfile made;
  made.channel = channel;
  made.threshold = threshold;
  made.ceiling = ceiling;
  made.named[channel] = 4;
  return made;
}

TEST(LearnerProfile, IsReadAsItWasWritten) {
  LearnerProfile profile;
  profile.body_map = "a \"map\"";
  profile.sites = {site(0, 0.37123456789012345, 0.8), site(15, 0.3, 1.0)};
  profile.sites[1].named[3] = 2;
  const auto file = std::filesystem::path(testing::TempDir()) / "secondskin_profile_written.toml";
  profile.save(file);
  const LearnerProfile again = LearnerProfile::load(file);
  EXPECT_EQ(again.body_map, profile.body_map);
  ASSERT_EQ(again.sites.size(), 2u);
  EXPECT_EQ(again.sites[0].threshold, profile.sites[0].threshold);
  EXPECT_EQ(again.sites[1].ceiling, 1.0);
  EXPECT_EQ(again.sites[1].named, profile.sites[1].named);
  EXPECT_THROW(profile.save("/proc/nowhere/profile.toml"), std::runtime_error);
}

TEST(LearnerProfile, ShapesTheMap) {
  BodyMap map = BodyMap::load(kMaps / "right_arm.toml");
  for (Tactor& tactor : map.tactors) tactor.ceiling = 0.7;
  LearnerProfile profile;
  profile.body_map = "right_arm";
  profile.sites = {site(0, 0.4, 0.6), site(1, 0.4, 1.0), site(2, 0.9, 1.0),
                   site(3, 0.4, 0.6), site(4, 0.4, 0.6), site(5, 0.4, 0.6)};
  profile.sites[3].named = {};
  profile.sites[3].named[7] = 4;  // never recognised
  profile.sites[4].named[4] = 2, profile.sites[4].named[5] = 2;
  profile.sites[5].named[5] = 3, profile.sites[5].named[4] = 2;
  const BodyMap shaped = profile.shape(map);
  ASSERT_EQ(shaped.tactors.size(), 6u);  // 2 is felt only above its ceiling
  EXPECT_DOUBLE_EQ(shaped.tactors[0].threshold, 0.4);
  EXPECT_DOUBLE_EQ(shaped.tactors[0].ceiling, 0.6);
  EXPECT_DOUBLE_EQ(shaped.tactors[1].ceiling, 0.7);  // never above the map's
  EXPECT_EQ(shaped.tactors[0].no_phantom_with, 0);
  EXPECT_EQ(shaped.tactors[2].channel, 4u);
  EXPECT_EQ(shaped.tactors[2].no_phantom_with, 1u << 5);
  EXPECT_EQ(shaped.tactors[3].no_phantom_with, 1u << 4);
  EXPECT_EQ(shaped.tactors[5].threshold, 0.3);  // 7 was not measured

  LearnerProfile other = profile;
  other.body_map = "arms";
  EXPECT_THROW((void)other.shape(map), std::runtime_error);
  LearnerProfile numb;
  numb.body_map = "right_arm";
  for (std::size_t c = 0; c < 8; ++c) numb.sites.push_back(site(c, 1.0, 0.0));
  EXPECT_THROW((void)numb.shape(map), std::runtime_error);
}

TEST(LearnerProfile, SaysFileLineAndFieldOfWhatIsWrong) {
  const std::string head = "body_map = \"m\"\n[[site]]\nchannel = 1\n";
  const std::vector<std::pair<std::string, std::string>> cases{
      {"[[site]]\n", "body_map: missing"},
      {"body_map = \"m\"\n", "site: missing"},
      {head + "threshold = 2\nceiling = 1\nnamed = []\n", ":4: threshold"},
      {head + "threshold = 0.3\nceiling = 1\nnamed = [1]\n", ":6: named: expected sixteen counts"},
      {head + "threshold = 0.3\nceiling = 1\nnamed = [0,0,0,0,0,0,0,0,0,0,0,0,0,0,0,-1]\n",
       ":6: named"}};
  const auto file = std::filesystem::path(testing::TempDir()) / "secondskin_profile_wrong.toml";
  for (const auto& [text, what] : cases) {
    std::ofstream(file) << text;
    try {
      (void)LearnerProfile::load(file);
      ADD_FAILURE() << text;
    } catch (const std::runtime_error& error) {
      EXPECT_THAT(error.what(), HasSubstr(what));
    }
  }
}

}  // namespace
}  // namespace secondskin::coach
