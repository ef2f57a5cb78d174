#include "motion/markers.h"

#include <gtest/gtest.h>

namespace secondskin {
namespace {

TEST(MarkerMotion, FindsAMarkerByNameAndBehindASubjectsPrefix) {
  MarkerMotion motion;
  motion.names = {"Derrick:LFHD", "LFHD", "Derrick:Trial:RFHD", "C7"};
  EXPECT_EQ(motion.find("C7"), 3U);
  EXPECT_EQ(motion.find("LFHD"), 1U) << "the exact name goes before a prefixed one";
  EXPECT_EQ(motion.find("Derrick:LFHD"), 0U);
  EXPECT_EQ(motion.find("RFHD"), 2U) << "the prefix reaches to the last colon";
  EXPECT_EQ(motion.find("FHD"), std::nullopt);
  EXPECT_EQ(motion.find("Other:C7"), std::nullopt);
  EXPECT_EQ(motion.find(""), std::nullopt);
}

TEST(MarkerFrame, BeginsWithNoMarkerVisible) {
  const MarkerFrame frame(3);
  EXPECT_EQ(frame.visible, std::vector<std::uint8_t>(3, 0));
  EXPECT_EQ(frame.residual, std::vector<float>(3, 0.0F));
  EXPECT_EQ(frame.p_WM.size(), 3U);
}

}  // namespace
}  // namespace secondskin
