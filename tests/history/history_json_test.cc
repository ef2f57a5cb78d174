#include "clients/history/history_json.h"

#include <gtest/gtest.h>

#include <nlohmann/json.hpp>
#include <sstream>

#include "course.h"

namespace secondskin::history {
namespace {

using nlohmann::json;

TEST(HistoryJson, TimesAreUtcWithMilliseconds) {
  EXPECT_EQ(iso_time(1'700'000'000'123'456'789), "2023-11-14T22:13:20.123Z");
  EXPECT_EQ(iso_time(0), "1970-01-01T00:00:00.000Z");
}

TEST(HistoryJson, AnglesAreInDegreesAndWhatWasNotMeasuredIsNull) {
  const json session =
      to_json(session_of(3, kMorning, {block_of(0, "always", kMorning, {40, 50})}), true);
  const json& joints = session["blocks"][0]["repetitions"][0]["joints"];
  EXPECT_NEAR(joints[0]["rms_deg"], 17.188733853924695, 1e-12);  // 0.3 rad
  EXPECT_NEAR(joints[0]["reference_range_deg"], 85.94366926962348, 1e-12);
  EXPECT_EQ(joints[1]["measured"], false);
  EXPECT_TRUE(joints[1]["rms_deg"].is_null());
  EXPECT_TRUE(joints[1]["timing_error"].is_null());
  EXPECT_EQ(session["start"], "2024-10-04T10:00:00.000Z");
  EXPECT_EQ(session["exposure"][0]["segment"], "left_thigh");
}

TEST(HistoryCsv, HasOneRowForEachRepetitionAndJointAndAsManyFieldsAsItsHead) {
  Session session = session_of(3, kMorning, {block_of(0, "always", kMorning, {40, 50})});
  session.blocks[0].name = "slow, \"then\" fast";
  session.blocks[0].repetitions.push_back(session.blocks[0].repetitions[1]);
  session.blocks[0].repetitions[2].joints.clear();
  std::istringstream lines(export_csv(std::vector{session}));
  std::vector<std::vector<std::string>> rows;
  for (std::string line; std::getline(lines, line);) {
    ASSERT_EQ(line.back(), '\r');
    line.pop_back();
    std::vector<std::string> cells(1);
    bool inside = false;
    for (std::size_t i = 0; i < line.size(); ++i) {  // RFC 4180
      if (line[i] == '"') {
        if (inside && i + 1 < line.size() && line[i + 1] == '"') {
          cells.back() += '"';
          ++i;
        } else {
          inside = !inside;
        }
      } else if (line[i] == ',' && !inside) {
        cells.emplace_back();
      } else {
        cells.back() += line[i];
      }
    }
    rows.push_back(cells);
  }
  ASSERT_EQ(rows.size(), 1u + 2u * 2u + 1u);
  for (const auto& row : rows) EXPECT_EQ(row.size(), rows[0].size());
  const auto column = [&](const std::string& name) {
    return static_cast<std::size_t>(std::find(rows[0].begin(), rows[0].end(), name) -
                                    rows[0].begin());
  };
  EXPECT_EQ(rows[1][column("block_name")], "slow, \"then\" fast");
  EXPECT_EQ(rows[1][column("joint")], "left_knee");
  EXPECT_NEAR(std::stod(rows[1][column("rms_deg")]), 17.188733853924695, 1e-12);
  EXPECT_EQ(rows[2][column("joint")], "right_hip");
  EXPECT_EQ(rows[2][column("rms_deg")], "");
  EXPECT_EQ(rows[5][column("joint")], "");
}

}  // namespace
}  // namespace secondskin::history
