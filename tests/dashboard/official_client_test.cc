#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>
#include <nlohmann/json.hpp>
#include <regex>

#include "bus/topics.h"
#include "recording/mcap_reader.h"
#include "tests/session/session.h"

// The bridge of a live session as the official Foxglove client (npm: @foxglove/ws-protocol) sees
// it: nothing of ours takes part in the connection, the decoding or the schemas' check.

namespace secondskin::session {
namespace {

using nlohmann::json;
namespace msg = bus::msg;

json official_client(const std::string& arguments) {
  const std::string command = "node '" SECONDSKIN_FOXGLOVE_CHECK "' " + arguments + " 2>&1";
  std::string said;
  FILE* pipe = ::popen(command.c_str(), "r");
  char buffer[4096];
  for (std::size_t got; (got = std::fread(buffer, 1, sizeof buffer, pipe)) > 0;) {
    said.append(buffer, got);
  }
  EXPECT_EQ(::pclose(pipe), 0) << said.substr(0, 2000);
  return json::parse(said, nullptr, false);
}

class OfficialClient : public testing::Test {
 protected:
  void SetUp() override {
    recorder_.emplace(session_.start("record", session_.on_bus({"record", file_})));
    bridge_.emplace(session_.start("dashboard", session_.on_bus({"dashboard", "--port", "0"})));
    coach_.emplace(session_.coach());
    capture_.emplace(session_.capture());
    ASSERT_TRUE(eventually([&] { return bridge_->says("http://"); }, 10s)) << bridge_->output();
    std::smatch found;
    const std::string said = bridge_->output();
    ASSERT_TRUE(std::regex_search(said, found, std::regex("http://127.0.0.1:([0-9]+)/")));
    url_ = "ws://127.0.0.1:" + found[1].str();
  }
  std::string topic(const std::string& name) const {
    return "/secondskin/test_" + std::to_string(::getpid()) + "/" + name;
  }

  const Session session_;
  const std::string file_ = session_.folder / "live.mcap";
  std::optional<Process> recorder_, bridge_, coach_, capture_;
  std::string url_;
};

TEST_F(OfficialClient, GetsThePosesThatWerePublished) {
  const json got = official_client(url_ + " " + topic("pose") + "=50 " + topic("skeleton") + "=1 " +
                                   topic("expert") + "=5 /tf=5 /scene=5");
  ASSERT_TRUE(got.is_object());
  EXPECT_EQ(got["server"]["capabilities"], json::array({"clientPublish"}));
  EXPECT_EQ(got["channels"][topic("pose")]["schemaName"], "secondskin_msgs::msg::SkeletonPose");
  EXPECT_EQ(got["channels"].size(), bus::kTopics.size() + 3);

  recorder_->end(SIGTERM);
  ASSERT_TRUE(recorder_->wait(10s));
  recording::McapReader recording(file_);
  const auto channel = recording.find("/pose");
  ASSERT_TRUE(channel);
  std::map<std::uint64_t, std::pair<msg::SkeletonPose, std::int64_t>> published;
  recording.for_each([&](const recording::McapMessage& message) {
    msg::SkeletonPose pose;
    if (message.channel == channel->id && bus::decode(message.data, pose)) {
      published[pose.header().frame()] = {pose, message.publish_time_ns};
    }
    return true;
  });
  std::size_t compared = 0;
  for (const json& one : got["messages"][topic("pose")]) {
    const json& value = one["value"];
    const auto found = published.find(std::stoull(value["header"]["frame"].get<std::string>()));
    if (found == published.end()) continue;  // before the recorder was found
    const auto& [pose, source_ns] = found->second;
    EXPECT_EQ(one["time"], std::to_string(source_ns));
    EXPECT_EQ(value["header"]["stamp_ns"], std::to_string(pose.header().stamp_ns()));
    EXPECT_EQ(value["root_position"]["z"], pose.root_position().z());
    ASSERT_EQ(value["orientations"].size(), pose.orientations().size());
    for (std::size_t j = 0; j < pose.orientations().size(); ++j) {
      EXPECT_EQ(value["orientations"][j]["w"], pose.orientations()[j].w());
      EXPECT_EQ(value["orientations"][j]["x"], pose.orientations()[j].x());
    }
    ++compared;
  }
  EXPECT_GT(compared, 30u);
}

TEST_F(OfficialClient, CommandsASession) {
  const std::string states = topic("session_state");
  ASSERT_TRUE(eventually([&] { return coach_->says("session 1"); }, 10s)) << coach_->output();
  json got = official_client(url_ + " --publish " + topic("session") +
                             R"( '{"action": "pause"}' )" + states + "=2");
  ASSERT_TRUE(got.is_object());
  EXPECT_EQ(got["messages"][states][1]["value"]["phase"], static_cast<int>(msg::SESSION_PAUSED));
  EXPECT_TRUE(got["statuses"].empty()) << got["statuses"];
  got = official_client(url_ + " --publish " + topic("stop") +
                        R"( '{"active": true, "reason": "test"}' )" + topic("stop") + "=1");
  EXPECT_EQ(got["messages"][topic("stop")][0]["value"]["reason"], "test");
}

}  // namespace
}  // namespace secondskin::session
