#include "coach/tactile/body_map.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>
#include <numbers>
#include <set>

namespace secondskin::coach {
namespace {

using testing::HasSubstr;

const std::filesystem::path kMaps = std::filesystem::path(SECONDSKIN_SOURCE_DIR) / "body_maps";

std::filesystem::path written(const std::string& text) {
  const auto* test = testing::UnitTest::GetInstance()->current_test_info();
  const auto file = std::filesystem::path(testing::TempDir()) /
                    (std::string("secondskin_") + test->name() + ".toml");
  std::ofstream(file) << text;
  return file;
}

std::string error_of(const std::string& text) {
  try {
    (void)BodyMap::load(written(text));
  } catch (const std::runtime_error& error) {
    return error.what();
  }
  return "no error";
}

const std::string kHead = "name = \"m\"\ncue = \"repulsive\"\n";
const std::string kTactor =
    "[[tactor]]\nchannel = 3\nsegment = \"left_elbow\"\nalong = 0.9\nangle_deg = 90\n"
    "actuator = \"voice_coil\"\nthreshold = 0.3\nceiling = 0.8\n";

std::string with(std::string text, const std::string& from, const std::string& to) {
  return text.replace(text.find(from), from.size(), to);
}

TEST(BodyMap, ReadsEveryField) {
  const BodyMap map = BodyMap::load(written(kHead + kTactor));
  EXPECT_EQ(map.name, "m");
  EXPECT_TRUE(map.repulsive);
  ASSERT_EQ(map.tactors.size(), 1u);
  const Tactor& tactor = map.tactors[0];
  EXPECT_EQ(tactor.channel, 3u);
  EXPECT_EQ(tactor.segment, Joint::kLeftElbow);
  EXPECT_DOUBLE_EQ(tactor.along, 0.9);
  EXPECT_DOUBLE_EQ(tactor.angle, 0.5 * std::numbers::pi);
  EXPECT_EQ(tactor.actuator, wire::Actuator::kVoiceCoil);
  EXPECT_DOUBLE_EQ(tactor.threshold, 0.3);
  EXPECT_DOUBLE_EQ(tactor.ceiling, 0.8);
  EXPECT_NEAR(tactor.acceleration, 6.34, 1e-9);  // 100 m/s^2 at 250 Hz, Wh = 0.0634
  EXPECT_DOUBLE_EQ(
      BodyMap::load(written(kHead + kTactor + "acceleration = 2\n")).tactors[0].acceleration, 2.0);
  EXPECT_FALSE(BodyMap::load(written(with(kHead, "repulsive", "attractive") + kTactor)).repulsive);
}

TEST(BodyMap, SaysFileLineAndFieldOfWhatIsWrong) {
  struct Case {
    std::string text, where, what;
  };
  const std::vector<Case> cases{
      {with(kHead + kTactor, "channel = 3", "channel = 16"), ":4: channel", "0 to 15"},
      {with(kHead + kTactor, "channel = 3", "channel = 1.5"), ":4: channel", "whole number"},
      {with(kHead + kTactor, "left_elbow", "left_arm"), ":5: segment", "canonical segment"},
      {with(kHead + kTactor, "left_elbow", "left_ankle"), ":5: segment", "upright at rest"},
      {with(kHead + kTactor, "along = 0.9", "along = 1.1"), ":6: along", "0 to 1"},
      {with(kHead + kTactor, "angle_deg = 90", "angle_deg = nan"), ":7: angle_deg", "number"},
      {with(kHead + kTactor, "voice_coil", "piezo"), ":8: actuator", "dc_motor"},
      {with(kHead + kTactor, "threshold = 0.3", "threshold = 0.9"), ":10: ceiling", "threshold"},
      {with(kHead + kTactor, "ceiling = 0.8", "ceiling = 2"), ":10: ceiling", "0 to 1"},
      {with(kHead + kTactor, "ceiling = 0.8\n", ""), ":3: ceiling", "missing"},
      {kHead + kTactor + kTactor, ":12: channel", "no other tactor"},
      {kHead + kTactor + "colour = 1\n", ":11: colour", "unknown"},
      {with(kHead, "repulsive", "pushy") + kTactor, ":2: cue", "attractive"},
      {"cue = \"repulsive\"\n" + kTactor, "name", "missing"},
      {kHead, "tactor", "missing"},
      {"name = \n", ":1:", ""}};
  for (const Case& c : cases) {
    const std::string error = error_of(c.text);
    EXPECT_THAT(error, HasSubstr(".toml"));
    EXPECT_THAT(error, HasSubstr(c.where));
    EXPECT_THAT(error, HasSubstr(c.what));
  }
  EXPECT_THROW((void)BodyMap::load("/nonexistent/map.toml"), std::runtime_error);
}

TEST(BodyMap, ShippedMapsAreTheLayoutsThatTheySay) {
  const auto right = BodyMap::load(kMaps / "right_arm.toml");
  EXPECT_EQ(right.tactors.size(), 8u);
  const auto arms = BodyMap::load(kMaps / "arms.toml");
  EXPECT_EQ(arms.tactors.size(), 16u);
  // Second Skin, 4.1: four around the wrist, four around the upper arm close to the elbow.
  for (const Joint segment :
       {Joint::kLeftElbow, Joint::kRightElbow, Joint::kLeftShoulder, Joint::kRightShoulder}) {
    std::set<int> quarters;
    for (const Tactor& tactor : arms.tactors) {
      if (tactor.segment != segment) continue;
      EXPECT_GE(tactor.along, 0.75);
      quarters.insert(static_cast<int>(std::lround(tactor.angle / (0.5 * std::numbers::pi))));
    }
    EXPECT_EQ(quarters, (std::set<int>{0, 1, 2, 3}));
  }
  const auto full = BodyMap::load(kMaps / "full_body.toml");
  EXPECT_EQ(full.tactors.size(), 16u);
  std::set<Joint> segments;
  for (const Tactor& tactor : full.tactors) segments.insert(tactor.segment);
  EXPECT_EQ(segments, (std::set<Joint>{Joint::kSpineUpper, Joint::kLeftElbow, Joint::kRightElbow,
                                       Joint::kLeftHip, Joint::kRightHip}));
  EXPECT_EQ(BodyMap::load(kMaps / "limbs.toml").tactors.size(), 16u);
}

}  // namespace
}  // namespace secondskin::coach
