#include "motion/skeleton.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <limits>
#include <stdexcept>

namespace secondskin {
namespace {

using testing::HasSubstr;

Segment segment(std::string name, std::optional<std::size_t> parent) {
  return Segment{.name = std::move(name), .parent = parent};
}

std::string complaint(std::vector<Segment> segments) {
  try {
    const Skeleton skeleton(std::move(segments));
  } catch (const std::invalid_argument& error) {
    return error.what();
  }
  return "accepted";
}

TEST(Skeleton, FindsSegmentsByName) {
  const Skeleton skeleton({segment("root", {}), segment("arm", 0), segment("hand", 1)});
  EXPECT_EQ(skeleton.size(), 3U);
  EXPECT_EQ(skeleton.find("hand"), 2U);
  EXPECT_EQ(skeleton.find("foot"), std::nullopt);
}

TEST(Skeleton, RefusesWhatIsNoTreeAndNamesTheSegment) {
  EXPECT_THAT(complaint({}), HasSubstr("no segments"));
  EXPECT_THAT(complaint({segment("root", 0)}), HasSubstr("\"root\""));
  EXPECT_THAT(complaint({segment("root", {}), segment("second", {})}), HasSubstr("\"second\""));
  EXPECT_THAT(complaint({segment("root", {}), segment("self", 1)}), HasSubstr("\"self\""));
  EXPECT_THAT(complaint({segment("root", {}), segment("early", 2), segment("late", 0)}),
              HasSubstr("\"early\""));
}

TEST(Skeleton, RefusesMissingAndDoubledNames) {
  EXPECT_THAT(complaint({segment("", {})}), HasSubstr("no name"));
  EXPECT_THAT(complaint({segment("a", {}), segment("a", 0)}), HasSubstr("twice"));
}

TEST(Skeleton, RefusesNumbersThatAreNotFinite) {
  for (const double bad :
       {std::numeric_limits<double>::quiet_NaN(), std::numeric_limits<double>::infinity()}) {
    Segment s = segment("root", {});
    s.p_PB.x() = bad;
    EXPECT_THAT(complaint({s}), HasSubstr("not finite"));
    s = segment("root", {});
    s.p_BC.z() = bad;
    EXPECT_THAT(complaint({s}), HasSubstr("not finite"));
    s = segment("root", {});
    s.mass_fraction = bad;
    EXPECT_THAT(complaint({s}), HasSubstr("mass"));
  }
  Segment s = segment("root", {});
  s.mass_fraction = -0.1;
  EXPECT_THAT(complaint({s}), HasSubstr("mass"));
}

TEST(Pose, AtRestIsValidAndConfident) {
  const Pose pose(4);
  EXPECT_EQ(pose.q_PB.size(), 4U);
  EXPECT_EQ(pose.confidence, std::vector<float>(4, 1.0F));
  EXPECT_TRUE(pose.is_valid());
}

TEST(Pose, IsInvalidWithANumberThatIsNotFiniteOrAQuaternionNotOfUnitLength) {
  constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
  Pose pose(2);
  pose.p_WR.y() = kNan;
  EXPECT_FALSE(pose.is_valid());
  pose = Pose(2);
  pose.q_PB[1].x() = kNan;
  EXPECT_FALSE(pose.is_valid());
  pose = Pose(2);
  pose.q_PB[1].w() = 1.002;
  EXPECT_FALSE(pose.is_valid());
  pose.q_PB[1].w() = 1.0005;
  EXPECT_TRUE(pose.is_valid());
  pose.confidence[0] = std::numeric_limits<float>::quiet_NaN();
  EXPECT_FALSE(pose.is_valid());
  pose.confidence = {1.0F};
  EXPECT_FALSE(pose.is_valid());
}

}  // namespace
}  // namespace secondskin
