#include <gtest/gtest.h>

#include <fstream>
#include <nlohmann/json.hpp>

#include "recording/mcap_reader.h"
#include "session.h"

namespace secondskin::session {
namespace {

TEST(Train, RunsTheLearnerOnceAndItsRecordingReplaysToTheSameCommands) {
  const Session session;
  const std::string file = session.folder / "session.mcap";
  Process train = session.start(
      "train", session.on_bus({"train", "--reference", "low_block", "--recording", file}));
  ASSERT_TRUE(train.wait(90s)) << train.output();
  const std::string said = train.output();
  ASSERT_EQ(train.exit_code(), 0) << said;
  for (const char* words :
       {"repetition 1: score", "worst:", "Cues:", "Solver:", "Latency", "Recording:"}) {
    EXPECT_NE(said.find(words), std::string::npos) << words << " is missing in\n" << said;
  }
  EXPECT_EQ(said.find("Cues: 0 given"), std::string::npos) << said;

  recording::McapReader reader(file);
  EXPECT_TRUE(reader.finished());
  EXPECT_TRUE(reader.damage().empty());
  for (const char* topic : {"/skeleton", "/pose", "/session_state", "/alignment", "/correction",
                            "/tactors", "/repetition", "/health", "/references"}) {
    const auto channel = reader.find(topic);
    ASSERT_TRUE(channel) << topic;
    EXPECT_GT(channel->messages, 0u) << topic;
    EXPECT_EQ(channel->schema_encoding, "omgidl");
  }
  EXPECT_EQ(reader.metadata().at("settings").at("reference"), "low_block");
  EXPECT_EQ(reader.metadata().at("skeleton").at("rate_hz"), "60");
  EXPECT_EQ(reader.find("/alignment")->messages, reader.find("/tactors")->messages - 1)
      << "one command a frame, and a last one that turns everything off";

  Process replay = session.start("replay", {"replay", file, "--coach", "--json"});
  ASSERT_TRUE(replay.wait(90s));
  const auto result = nlohmann::json::parse(replay.output());
  EXPECT_EQ(replay.exit_code(), 0) << replay.output();
  EXPECT_EQ(result["commands_different"], 0) << replay.output();
  EXPECT_EQ(result["commands_compared"], reader.find("/alignment")->messages);
  EXPECT_GT(result["corrections"], 20);
  EXPECT_TRUE(result["remarks"].empty()) << replay.output();
  EXPECT_EQ(result["repetitions"], reader.find("/repetition")->messages);
}

TEST(Train, FollowsABodyInASuitOfPhotodetectors) {
  const Session session;
  const std::string file = session.folder / "optical.mcap";
  const std::string learner = SECONDSKIN_SOURCE_DIR "/reference_motions/squat/learner.bvh";
  Process train = session.start(
      "train", session.on_bus({"train", "--reference", "squat", "--learner", "sim:" + learner,
                               "--tolerance-scale", "0.2", "--recording", file}));
  ASSERT_TRUE(train.wait(90s)) << train.output();
  const std::string said = train.output();
  ASSERT_EQ(train.exit_code(), 0) << said;
  EXPECT_NE(said.find("repetition 1: score"), std::string::npos) << said;
  EXPECT_EQ(said.find("Cues: 0 given"), std::string::npos) << said;
  const recording::McapReader reader(file);
  for (const char* topic : {"/pose", "/points", "/raw", "/tactors"}) {
    const auto channel = reader.find(topic);
    ASSERT_TRUE(channel) << topic;
    EXPECT_GT(channel->messages, 150u) << topic;
  }
  EXPECT_EQ(reader.metadata().at("skeleton").at("rate_hz"), "62.5");
}

TEST(Commands, CalibrateProjectorsAndWearerFromTheBytesOfVirtualTags) {
  const Session session;
  const auto run = [&](const std::string& name, const std::vector<std::string>& arguments) {
    Process process = session.start(name, arguments);
    EXPECT_TRUE(process.wait(120s)) << name;
    EXPECT_EQ(process.exit_code(), 0) << process.output();
    return process.output();
  };
  const std::string folder = session.folder / "";
  const std::string learner = SECONDSKIN_SOURCE_DIR "/reference_motions/squat/learner.bvh";
  run("wand", {"virtual-tags", "wand", "--files", folder + "wand"});
  const auto said = run("calibrate", {"calibrate", "optical", "wand", folder + "wand0.tag", "--out",
                                      folder + "projectors.txt"});
  EXPECT_NE(said.find("calibration of 16 of 16 projectors"), std::string::npos) << said;
  run("suit", {"virtual-tags", learner, "--files", folder + "suit"});
  std::string source = "optical:";
  for (int tag = 0; tag < 5; ++tag) {
    source += (tag > 0 ? "," : "") + folder + "suit" + std::to_string(tag) + ".tag";
  }
  run("skeleton", {"calibrate", "skeleton", source, "--projectors", folder + "projectors.txt",
                   "--out", folder + "body.toml"});
  run("export", {"export", source, "--projectors", folder + "projectors.txt", "--body",
                 folder + "body.toml", "--to", folder + "out.csv"});
  std::ifstream csv(folder + "out.csv");
  std::string line;
  std::size_t rows = 0;
  while (std::getline(csv, line)) ++rows;
  EXPECT_GT(rows, 200u);
}

TEST(SeparateProcesses, ARecordingAcrossACoachsRestartReplaysAsTwoSessions) {
  const Session session;
  const std::string file = session.folder / "restart.mcap";
  Process recorder = session.start("record", session.on_bus({"record", file}));
  Process coach = session.coach();
  ASSERT_TRUE(eventually([&] { return recorder.says("recording to"); }, 10s));
  std::this_thread::sleep_for(
      2s);  // the recorder finds the coach's topics before anything goes out
  const std::string learner = SECONDSKIN_SOURCE_DIR "/reference_motions/low_block/learner.bvh";
  const auto capture_command = session.on_bus({"capture", learner, "--wait-for", "2"});
  Process first_capture = session.start("capture", capture_command);
  ASSERT_TRUE(eventually([&] { return coach.says("session 1"); }, 20s));
  std::this_thread::sleep_for(4s);
  coach.end(SIGKILL);
  ASSERT_TRUE(coach.wait(5s));
  first_capture.end(SIGTERM);
  ASSERT_TRUE(first_capture.wait(5s));
  Process again = session.start(
      "again", session.on_bus({"coach", "--reference", "low_block", "--tolerance-scale", "0.2"}));
  std::this_thread::sleep_for(2s);
  Process capture = session.start("capture", capture_command);
  ASSERT_TRUE(eventually([&] { return again.says("session 1"); }, 20s));
  std::this_thread::sleep_for(4s);
  for (Process* part : {&capture, &again, &recorder}) {
    part->end(SIGTERM);
    ASSERT_TRUE(part->wait(10s));
  }
  Process replay = session.start("replay", {"replay", file, "--coach", "--json"});
  ASSERT_TRUE(replay.wait(60s));
  const auto result = nlohmann::json::parse(replay.output());
  EXPECT_EQ(result["sessions"], 2) << replay.output();
  EXPECT_EQ(result["commands_different"], 0) << replay.output();
  EXPECT_GT(result["commands_compared"], 300) << replay.output();
}

TEST(SeparateProcesses, WorkStartedInAnyOrderAndRestarted) {
  const Session session;
  Process coach = session.coach();
  Process recorder =
      session.start("record", session.on_bus({"record", session.folder / "separate.mcap"}));
  Process tactors = session.tactors();  // the board is not there yet
  Process capture = session.capture();
  ASSERT_TRUE(eventually([&] { return coach.says("session 1"); }, 20s)) << coach.output();
  Process board = session.board();
  const auto on = [&] { return session.tactors_are_on(); };
  ASSERT_TRUE(eventually(on, 60s)) << coach.output() << tactors.output() << capture.output();

  // Each goes and comes back; the others carry on.
  const auto restarted = [&](Process& part, Process (Session::*start)() const) {
    part.end(SIGKILL);
    ASSERT_TRUE(part.wait(5s));
    ASSERT_TRUE(eventually([&] { return !on(); }, 5s));
    Process again = (session.*start)();
    EXPECT_TRUE(eventually(on, 60s)) << again.output();
    part.~Process();
    new (&part) Process(std::move(again));
  };
  restarted(capture, &Session::capture);
  restarted(coach, &Session::coach);
  restarted(tactors, &Session::tactors);

  // A port that vanishes and returns.
  board.end(SIGKILL);
  ASSERT_TRUE(board.wait(5s));
  EXPECT_TRUE(eventually([&] { return tactors.says("waiting for it"); }, 5s)) << tactors.output();
  std::filesystem::remove(session.waveform());
  Process new_board = session.board();
  EXPECT_TRUE(eventually(on, 60s)) << tactors.output();
  std::this_thread::sleep_for(2s);  // and it goes on, so that there is something to record

  recorder.end(SIGTERM);
  ASSERT_TRUE(recorder.wait(10s));
  EXPECT_EQ(recorder.exit_code(), 0) << recorder.output();
  recording::McapReader reader(session.folder / "separate.mcap");
  EXPECT_TRUE(reader.finished());
  EXPECT_GT(reader.find("/pose")->messages, 100u);
  EXPECT_GT(reader.find("/tactors")->messages, 100u);
}

}  // namespace
}  // namespace secondskin::session
