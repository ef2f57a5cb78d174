#include "motion/angle_csv.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <sstream>
#include <vector>

namespace secondskin {
namespace {

std::vector<std::string> fields(const std::string& text) {
  std::vector<std::string> result(1);
  for (const char c : text) {
    if (c == ',') {
      result.emplace_back();
    } else if (c != '\n') {
      result.back() += c;
    }
  }
  return result;
}

struct Table {
  std::vector<std::string> names, values;
  std::string at(const std::string& name) const {
    const auto found = std::find(names.begin(), names.end(), name);
    return found == names.end() ? "no such column"
                                : values[static_cast<std::size_t>(found - names.begin())];
  }
};

Table write(double time, const Pose& pose) {
  std::ostringstream header, row;
  write_angle_csv_header(header);
  write_angle_csv_row(row, time, pose);
  return {fields(header.str()), fields(row.str())};
}

TEST(AngleCsv, StartsWithTimeAndRootAndNamesMovementsThatExist) {
  const Table table = write(0.0, Pose(kJointCount));
  ASSERT_EQ(table.names.size(), table.values.size());
  EXPECT_EQ(std::vector<std::string>(table.names.begin(), table.names.begin() + 4),
            (std::vector<std::string>{"t", "root_x", "root_y", "root_z"}));
  EXPECT_THAT(table.names, testing::Contains("left_knee_flexion_deg"));
  EXPECT_THAT(table.names, testing::Contains("right_shoulder_abduction_deg"));
  EXPECT_THAT(table.names, testing::Contains("left_elbow_rotation_deg"));
  EXPECT_THAT(table.names, testing::Not(testing::Contains("left_knee_abduction_deg")));
}

TEST(AngleCsv, WritesDegreesSecondsAndMetres) {
  Pose pose(kJointCount);
  pose.p_WR = {1.5, -2.25, 0.875};
  pose.q_PB[index(Joint::kRightKnee)] =
      joint_rotation(Joint::kRightKnee, {std::numbers::pi / 3, 0, 0});
  const Table table = write(12.5, pose);
  EXPECT_DOUBLE_EQ(std::stod(table.at("t")), 12.5);
  EXPECT_DOUBLE_EQ(std::stod(table.at("root_y")), -2.25);
  EXPECT_NEAR(std::stod(table.at("right_knee_flexion_deg")), 60.0, 1e-3);
  EXPECT_NEAR(std::stod(table.at("left_knee_flexion_deg")), 0.0, 1e-3);
}

TEST(AngleCsv, LeavesFieldsOfUnmeasuredJointsEmpty) {
  Pose pose(kJointCount);
  pose.confidence[index(Joint::kNeck)] = 0.0F;
  const Table table = write(0.0, pose);
  EXPECT_EQ(table.at("neck_flexion_deg"), "");
  EXPECT_EQ(table.at("neck_rotation_deg"), "");
  EXPECT_NE(table.at("head_flexion_deg"), "");
  ASSERT_EQ(table.names.size(), table.values.size());
}

}  // namespace
}  // namespace secondskin
