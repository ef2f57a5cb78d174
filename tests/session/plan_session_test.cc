#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

#include "recording/mcap_reader.h"
#include "session.h"

namespace secondskin::session {
namespace {

constexpr const char* kPlan = R"(name = "two"
[[block]]
name = "slow"
repetitions = 1
tempo = 0.8
tolerance_scale = 0.3
max_cues = 1
rest_s = 0.5
schedule = { kind = "always" }
[[block]]
name = "alone"
repetitions = 1
tolerance_scale = 0.3
schedule = { kind = "off" }
)";

TEST(TrainWithPlan, EndsAfterTheLastBlockAndItsRecordingReplaysToTheSameCommands) {
  const Session session;
  const std::string plan = session.folder / "two.toml", file = session.folder / "planned.mcap";
  std::ofstream(plan) << kPlan;
  Process train =
      session.start("train", session.on_bus({"train", "--reference", "low_block", "--plan", plan,
                                             "--recording", file, "--loop"}));
  ASSERT_TRUE(train.wait(90s)) << "the plan did not end the session\n" << train.output();
  const std::string said = train.output();
  ASSERT_EQ(train.exit_code(), 0) << said;
  EXPECT_NE(said.find("block 'slow' (tempo 0.8): 1 repetitions, mean score"), std::string::npos)
      << said;
  EXPECT_NE(said.find("block 'alone' (tempo 1): 1 repetitions, mean score"), std::string::npos)
      << said;
  EXPECT_NE(said.find(", 0 cues\nCues:"), std::string::npos) << "the block alone has none\n"
                                                             << said;
  EXPECT_EQ(said.find("Cues: 0 given"), std::string::npos) << "the slow block has some\n" << said;
  EXPECT_EQ(recording::McapReader(file).find("/repetition")->messages, 2u);

  Process replay = session.start("replay", {"replay", file, "--coach", "--json"});
  ASSERT_TRUE(replay.wait(90s));
  const auto result = nlohmann::json::parse(replay.output());
  EXPECT_EQ(replay.exit_code(), 0) << replay.output();
  EXPECT_EQ(result["sessions"], 1);
  EXPECT_EQ(result["commands_different"], 0) << replay.output();
  EXPECT_EQ(result["repetitions"], 2);
  EXPECT_TRUE(result["remarks"].empty()) << replay.output();

  // Somebody else gets the cues of that session.
  const std::string yoked = session.folder / "yoked.toml", other = session.folder / "other.mcap";
  std::ofstream(yoked) << "name = \"yoked\"\n[[block]]\nname = \"other's\"\nrepetitions = 1\n"
                          "schedule = { kind = \"yoked\", session = \"planned.mcap\" }\n";
  Process second = session.start(
      "second", session.on_bus({"train", "--reference", "low_block", "--plan", yoked, "--recording",
                                other, "--loop", "--tolerance-scale", "10"}));
  ASSERT_TRUE(second.wait(90s)) << second.output();
  ASSERT_EQ(second.exit_code(), 0) << second.output();
  EXPECT_EQ(second.output().find("Cues: 0 given"), std::string::npos) << second.output();
  Process again = session.start("again", {"replay", other, "--coach", "--json"});
  ASSERT_TRUE(again.wait(90s));
  EXPECT_EQ(again.exit_code(), 0) << again.output();
}

TEST(TrainWithPlan, NamesWhatIsWrongInAPlan) {
  const Session session;
  const std::string plan = session.folder / "bad.toml";
  std::ofstream(plan) << "name = \"bad\"\n[[block]]\nname = \"b\"\nrepetitions = 0\n";
  Process bad = session.start("bad", {"train", "--plan", plan});
  ASSERT_TRUE(bad.wait(30s));
  EXPECT_NE(bad.exit_code(), 0);
  EXPECT_TRUE(bad.says("bad.toml:4: repetitions: expected a whole number from 1 to 1000"))
      << bad.output();
  Process unknown = session.start("unknown", {"train", "--plan", "nobody"});
  ASSERT_TRUE(unknown.wait(30s));
  EXPECT_TRUE(unknown.says("slow_first")) << unknown.output();
}

}  // namespace
}  // namespace secondskin::session
