#include <gtest/gtest.h>

#include <cstdio>
#include <nlohmann/json.hpp>

#include "bus/topics.h"
#include "recording/mcap_reader.h"
#include "session.h"

// A recording of a live session, as the official MCAP reader (npm: @mcap/core) and the IDL parser
// that Foxglove uses see it: nothing of ours takes part in the reading.

namespace secondskin::session {
namespace {

using nlohmann::json;
namespace msg = bus::msg;

json official_reading(const std::string& file, const std::string& topic) {
  const std::string command =
      "node '" SECONDSKIN_MCAP_CHECK "' '" + file + "' --decode " + topic + " 2>&1";
  std::string said;
  FILE* pipe = ::popen(command.c_str(), "r");
  char buffer[4096];
  for (std::size_t got; (got = std::fread(buffer, 1, sizeof buffer, pipe)) > 0;) {
    said.append(buffer, got);
  }
  EXPECT_EQ(::pclose(pipe), 0) << said;
  return json::parse(said, nullptr, false);
}

TEST(OfficialReader, ReadsTrueValuesOfALiveSession) {
  const Session session;
  const std::string file = session.folder / "live.mcap";
  Process recorder = session.start("record", session.on_bus({"record", file}));
  Process coach = session.coach();
  ASSERT_TRUE(eventually([&] { return recorder.says("recording to"); }, 10s));
  Process capture = session.start(
      "capture",
      session.on_bus({"capture", SECONDSKIN_SOURCE_DIR "/reference_motions/squat/learner.bvh",
                      "--speed", "4", "--wait-for", "2"}));
  ASSERT_TRUE(capture.wait(30s)) << capture.output();
  coach.end(SIGTERM);
  ASSERT_TRUE(coach.wait(10s));
  recorder.end(SIGTERM);
  ASSERT_TRUE(recorder.wait(10s));
  ASSERT_EQ(recorder.exit_code(), 0) << recorder.output();

  // What we read ourselves.
  recording::McapReader ours(file);
  const auto channel = ours.find("/pose");
  ASSERT_TRUE(channel);
  std::vector<msg::SkeletonPose> poses;
  ours.for_each([&](const recording::McapMessage& message) {
    if (message.channel == channel->id) {
      EXPECT_TRUE(bus::decode(message.data, poses.emplace_back()));
    }
    return true;
  });
  ASSERT_GT(poses.size(), 100u);

  const json theirs = official_reading(file, "/pose");
  ASSERT_TRUE(theirs.is_object());
  EXPECT_EQ(theirs["finished"], true);
  EXPECT_EQ(theirs["messages"], ours.messages());
  const json& decoded = theirs["decoded"];
  ASSERT_EQ(decoded.size(), poses.size());
  for (std::size_t i = 0; i < poses.size(); i += 10) {
    // 64-bit numbers come as text.
    const json& value = decoded[i].contains("value") ? decoded[i]["value"] : decoded[i];
    EXPECT_EQ(value["header"]["frame"], std::to_string(poses[i].header().frame()));
    EXPECT_EQ(value["header"]["stamp_ns"], std::to_string(poses[i].header().stamp_ns()));
    EXPECT_EQ(value["root_position"]["z"], poses[i].root_position().z());
    ASSERT_EQ(value["orientations"].size(), poses[i].orientations().size());
    EXPECT_EQ(value["orientations"][7]["w"], poses[i].orientations()[7].w());
  }
  for (const char* topic : {"skeleton", "alignment", "correction", "tactors", "session_state"}) {
    const auto name = "/secondskin/test_" + std::to_string(::getpid()) + "/" + topic;
    ASSERT_TRUE(theirs["topics"].contains(name)) << name;
    EXPECT_EQ(theirs["topics"][name]["messages"], ours.find(name)->messages) << name;
  }
}

}  // namespace
}  // namespace secondskin::session
