#include <gtest/gtest.h>

#include <cmath>
#include <fstream>
#include <map>
#include <nlohmann/json.hpp>

#include "session.h"

namespace secondskin::session {
namespace {

TEST(CommandLine, EveryCommandHasHelpWithAnExample) {
  const Session session;
  for (const std::vector<std::string>& command : {std::vector<std::string>{"train"},
                                                  {"capture"},
                                                  {"coach"},
                                                  {"tactors"},
                                                  {"record"},
                                                  {"virtual-board"},
                                                  {"stop"},
                                                  {"session"},
                                                  {"export"},
                                                  {"info"},
                                                  {"replay"},
                                                  {"align"},
                                                  {"score"},
                                                  {"reference"},
                                                  {"reference", "list"},
                                                  {"reference", "show"},
                                                  {"reference", "add"},
                                                  {"doctor"}}) {
    auto arguments = command;
    arguments.push_back("--help");
    Process help = session.start("help", arguments);
    ASSERT_TRUE(help.wait(10s));
    EXPECT_EQ(help.exit_code(), 0) << help.output();
    EXPECT_TRUE(help.says("Example:  secondskin " + command[0])) << help.output();
  }
}

TEST(CommandLine, TakesEveryOptionFromAFileToo) {
  const Session session;
  std::ofstream(session.folder / "secondskin.toml")
      << "[export]\nto = \"" << (session.folder / "from_file.csv") << "\"\n";
  Process process =
      session.start("export", {"--config", session.folder / "secondskin.toml", "export",
                               SECONDSKIN_SOURCE_DIR "/reference_motions/squat/motion.bvh"});
  ASSERT_TRUE(process.wait(20s));
  EXPECT_EQ(process.exit_code(), 0) << process.output();
  EXPECT_TRUE(std::filesystem::exists(session.folder / "from_file.csv")) << process.output();
}

TEST(CommandLine, AReferenceThatIsAddedCanBeUsedAtOnce) {
  const Session session;
  ::setenv("XDG_DATA_HOME", (session.folder / "data").c_str(), 1);
  Process add = session.start(
      "add",
      {"reference", "add", SECONDSKIN_SOURCE_DIR "/reference_motions/squat/learner.bvh", "--name",
       "my squat", "--description", "with \"quotes\"", "--start", "0.5", "--end", "2.5"});
  ASSERT_TRUE(add.wait(20s));
  ASSERT_EQ(add.exit_code(), 0) << add.output();
  Process show = session.start("show", {"reference", "show", "my squat"});
  ASSERT_TRUE(show.wait(20s));
  EXPECT_EQ(show.exit_code(), 0) << show.output();
  EXPECT_TRUE(show.says("with \"quotes\"")) << show.output();
  EXPECT_TRUE(show.says("2.00 s")) << show.output();
  Process list = session.start("list", {"reference", "list"});
  ASSERT_TRUE(list.wait(20s));
  EXPECT_TRUE(list.says("my squat")) << list.output();
  EXPECT_TRUE(list.says("low_block")) << list.output();
  Process again = session.start(
      "again", {"reference", "add", SECONDSKIN_SOURCE_DIR "/reference_motions/squat/learner.bvh",
                "--name", "my squat"});
  ASSERT_TRUE(again.wait(20s));
  EXPECT_NE(again.exit_code(), 0);
  EXPECT_TRUE(again.says("exists already")) << again.output();
  ::unsetenv("XDG_DATA_HOME");
}

TEST(CommandLine, EveryShippedLearnerIsScoredAsOftenAsItRepeats) {
  // Counted by eye in the recordings (docs/reference-motions.md).
  const std::map<std::string, std::size_t> repetitions{
      {"low_block", 3},        {"roundhouse_kick", 1},   {"stepping_punch", 2}, {"squat", 1},
      {"knife_hand_block", 3}, {"jumping_jack", 2},      {"wave_hello", 1},     {"deep_squat", 3},
      {"sit_to_stand", 3},     {"shoulder_abduction", 3}};
  const Session session;
  for (const auto& [name, expected] : repetitions) {
    Process process = session.start(
        "score", {"score", "--reference", name,
                  SECONDSKIN_SOURCE_DIR "/reference_motions/" + name + "/learner.bvh", "--json"});
    ASSERT_TRUE(process.wait(20s)) << name;
    ASSERT_EQ(process.exit_code(), 0) << process.output();
    const auto scores = nlohmann::json::parse(process.output())["repetitions"];
    EXPECT_EQ(scores.size(), expected) << name;
    double last_end = 0.0;
    for (const auto& score : scores) {
      EXPECT_GE(score["start_s"], last_end) << name;
      EXPECT_GT(score["end_s"], score["start_s"]) << name;
      last_end = score["end_s"];
      EXPECT_GT(score["total"], 40.0) << name;  // the same performer, the same technique
      EXPECT_LE(score["total"], 100.0) << name;
    }
  }
}

TEST(CommandLine, ScoresAWholeFileAsOneRepetition) {
  const Session session;
  const std::string folder = SECONDSKIN_SOURCE_DIR "/reference_motions/deep_squat/";
  Process process =
      session.start("score", {"score", "--reference", "deep_squat", folder + "expert_2.bvh",
                              folder + "expert_3.bvh", "--whole", "--json"});
  ASSERT_TRUE(process.wait(20s));
  ASSERT_EQ(process.exit_code(), 0) << process.output();
  const auto scores = nlohmann::json::parse(process.output())["repetitions"];
  ASSERT_EQ(scores.size(), 2U);
  for (const auto& score : scores) {
    EXPECT_GT(score["total"], 80.0);
    EXPECT_FALSE(score["mirrored"]);
    EXPECT_LT(score["lost"]["depth"], 0.2);
    const auto& knee = score["joints"]["left_knee"];
    EXPECT_LT(std::abs(knee["timing_error_s"].get<double>()), 0.2);
    EXPECT_LT(knee["smoothness"], -1.0);
    EXPECT_GT(knee["range_deg"], 60.0);
    EXPECT_NEAR(knee["range_deg"].get<double>(), knee["reference_range_deg"].get<double>(), 20.0);
    EXPECT_TRUE(score["joints"]["left_wrist"].contains("timing_error_s"));
  }
}

TEST(CommandLine, DoctorFindsNothingWrongHereAndNamesAMissingPort) {
  const Session session;
  Process good = session.start("doctor", session.on_bus({"doctor"}));
  ASSERT_TRUE(good.wait(30s));
  EXPECT_EQ(good.exit_code(), 0) << good.output();
  Process bad = session.start("doctor", session.on_bus({"doctor", "--port", "/dev/nothing"}));
  ASSERT_TRUE(bad.wait(30s));
  EXPECT_EQ(bad.exit_code(), 1);
  EXPECT_TRUE(bad.says("PROBLEM port /dev/nothing")) << bad.output();
}

TEST(CommandLine, ExportsAnglesThatAreTheMotions) {
  const Session session;
  const std::string csv = session.folder / "angles.csv";
  Process process = session.start(
      "export",
      {"export", SECONDSKIN_SOURCE_DIR "/reference_motions/squat/motion.bvh", "--to", csv});
  ASSERT_TRUE(process.wait(20s));
  ASSERT_EQ(process.exit_code(), 0) << process.output();
  std::ifstream in(csv);
  std::string header, line;
  std::getline(in, header);
  std::size_t column = 0;
  std::istringstream names(header);
  for (std::string name; std::getline(names, name, ',') && name != "left_knee_flexion_deg";) {
    ++column;
  }
  double deepest = 0.0;
  while (std::getline(in, line)) {
    std::istringstream fields(line);
    std::string field;
    for (std::size_t i = 0; i <= column; ++i) std::getline(fields, field, ',');
    deepest = std::max(deepest, std::stod(field));
  }
  EXPECT_GT(deepest, 90.0);  // a deep squat
  EXPECT_LT(deepest, 165.0);
}

}  // namespace
}  // namespace secondskin::session
