#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cstdio>
#include <cstring>
#include <fstream>
#include <nlohmann/json.hpp>
#include <sstream>

#include "recording/mcap_format.h"
#include "recording/mcap_reader.h"
#include "tests/recording/mcap_files.h"

/// Recordings as the official MCAP reader (npm: @mcap/core) sees them.
namespace secondskin::recording {
namespace {

using nlohmann::json;
using testing::kEpoch;
using testing::Message;
using testing::messages_of;
using testing::TemporaryFolder;

struct Check {
  int status = -1;
  json found;
  std::string said;
};

Check official_check(const std::filesystem::path& file, const std::string& options = "") {
  const std::string command = std::string("node ") + SECONDSKIN_MCAP_CHECK + " '" + file.string() +
                              "' " + options + " 2>&1";
  Check check;
  FILE* pipe = ::popen(command.c_str(), "r");
  if (pipe == nullptr) return check;
  char buffer[4096];
  for (std::size_t got; (got = std::fread(buffer, 1, sizeof buffer, pipe)) > 0;) {
    check.said.append(buffer, got);
  }
  check.status = ::pclose(pipe);
  check.found = json::parse(check.said, nullptr, false);
  return check;
}

/// The CRC that check.mjs takes over the messages of a topic.
std::uint32_t crc_of(const std::vector<Message>& messages, std::string_view topic) {
  std::uint32_t crc = 0;
  for (const Message& message : messages) {
    if (message.topic != topic) continue;
    mcap::Encoder out;
    out.number(std::uint64_t{message.sequence});
    out.number(message.log_time_ns);
    out.number(message.publish_time_ns);
    out.raw(message.data);
    crc = mcap::crc32(crc, out.out);
  }
  return crc;
}

/// Common Data Representation, version 1, little-endian: as DDS puts the messages on the wire.
class Cdr {
 public:
  template <typename Number>
  Cdr& number(Number value) {
    while ((out.size() - 4) % sizeof value != 0) out.push_back(0);
    std::uint8_t raw[sizeof value];
    std::memcpy(raw, &value, sizeof value);
    out.insert(out.end(), raw, raw + sizeof value);
    return *this;
  }
  Cdr& string(std::string_view text) {
    number(static_cast<std::uint32_t>(text.size() + 1));
    out.insert(out.end(), text.begin(), text.end());
    out.push_back(0);
    return *this;
  }
  Cdr& header(std::uint64_t frame) {
    return number(frame).number(std::int64_t{kEpoch}).number(std::int64_t{kEpoch + 5});
  }
  std::vector<std::uint8_t> out{0, 1, 0, 0};
};

std::string our_idl() {
  std::stringstream idl;
  idl << std::ifstream(SECONDSKIN_SOURCE_DIR "/idl/secondskin_msgs.idl").rdbuf();
  return idl.str();
}

TEST(OfficialReader, FindsEverythingThatWasWritten) {
  const TemporaryFolder folder;
  const auto file = folder / "session.mcap";
  const std::string idl = our_idl();
  ASSERT_FALSE(idl.empty());
  std::vector<Message> written;
  {
    McapWriter writer(file,
                      {.chunk_bytes = 8192, .chunk_seconds = 0.5, .library = "secondskin test"});
    const auto pose = writer.add_channel("rt/secondskin/anna/pose",
                                         "secondskin_msgs::msg::SkeletonPose", "omgidl", idl);
    const auto health = writer.add_channel("rt/secondskin/anna/health",
                                           "secondskin_msgs::msg::ServiceHealth", "omgidl", idl);
    writer.add_channel("rt/secondskin/anna/stop", "secondskin_msgs::msg::EmergencyStop", "omgidl",
                       idl);
    writer.write_metadata("settings", {{"subject", "anna"}, {"a", ""}, {"umlaut", "\xC3\xBC"}});
    writer.write_metadata("skeleton", {{"joints", "22"}});
    for (std::uint32_t i = 0; i < 1000; ++i) {
      const bool slow = i % 62 == 0;
      // Now and then one that was received before its predecessor.
      const std::int64_t time = kEpoch + i * 16'000'000LL - (i % 10 == 9 ? 20'000'000 : 0);
      Message message{slow ? "rt/secondskin/anna/health" : "rt/secondskin/anna/pose", i, time,
                      time - 1000, testing::bytes(i, i % 300)};
      writer.write(slow ? health : pose, i, time, message.publish_time_ns, message.data);
      written.push_back(std::move(message));
      if (i == 500)
        writer.write_attachment("motion.bvh", "text/plain", kEpoch, testing::bytes(1, 70'000));
    }
    writer.write_attachment("empty", "application/octet-stream", kEpoch + 1, {});
    writer.close();
  }
  const Check check = official_check(file);
  ASSERT_EQ(check.status, 0) << check.said;
  const json& found = check.found;
  EXPECT_EQ(found["profile"], "");
  EXPECT_EQ(found["library"], "secondskin test");
  EXPECT_EQ(found["messages"], 1000);
  EXPECT_GT(found["chunks"], 10);
  EXPECT_EQ(found["compressions"], json({"zstd"}));
  EXPECT_EQ(found["ordered"], true);
  EXPECT_EQ(found["first"], std::to_string(kEpoch));
  EXPECT_EQ(found["last"], std::to_string(kEpoch + 998 * 16'000'000LL));
  EXPECT_EQ(found["summary_offsets"], json({3, 4, 8, 10, 11, 13}));
  EXPECT_EQ(found["metadata"],
            json({{"settings", {{"subject", "anna"}, {"a", ""}, {"umlaut", "\xC3\xBC"}}},
                  {"skeleton", {{"joints", "22"}}}}));

  std::stable_sort(written.begin(), written.end(), [](const Message& a, const Message& b) {
    return a.log_time_ns < b.log_time_ns;
  });
  ASSERT_EQ(found["topics"].size(), 3u);
  for (const std::string name : {"pose", "health", "stop"}) {
    const std::string topic = "rt/secondskin/anna/" + name;
    const json& there = found["topics"][topic];
    EXPECT_EQ(there["messages"], std::count_if(written.begin(), written.end(),
                                               [&](const Message& m) { return m.topic == topic; }));
    EXPECT_EQ(there["crc"], crc_of(written, topic)) << topic;
    EXPECT_EQ(there["message_encoding"], "cdr");
    EXPECT_EQ(there["schema_encoding"], "omgidl");
    EXPECT_EQ(there["schema_text"], idl);
  }
  EXPECT_EQ(found["topics"]["rt/secondskin/anna/pose"]["schema_name"],
            "secondskin_msgs::msg::SkeletonPose");
  ASSERT_EQ(found["attachments"].size(), 2u);
  EXPECT_EQ(found["attachments"][0]["name"], "motion.bvh");
  EXPECT_EQ(found["attachments"][0]["media_type"], "text/plain");
  EXPECT_EQ(found["attachments"][0]["crc"], mcap::crc32(0, testing::bytes(1, 70'000)));
  EXPECT_EQ(found["attachments"][1]["size"], 0);

  // Our own reader is of the same opinion.
  McapReader reader(file);
  EXPECT_EQ(messages_of(reader), written);
}

TEST(OfficialReader, OpensARecordingThatHoldsNothing) {
  const TemporaryFolder folder;
  McapWriter(folder / "empty.mcap").close();
  const Check check = official_check(folder / "empty.mcap");
  ASSERT_EQ(check.status, 0) << check.said;
  EXPECT_EQ(check.found["messages"], 0);
}

TEST(OfficialReader, ReadsTheWholeChunksOfACutRecording) {
  const TemporaryFolder folder;
  const auto recording = testing::make_recording(folder / "whole.mcap", 5, 20, 100);
  auto file = recording.file;
  file.resize(recording.chunk_ends[3] + 5);
  testing::write_contents(folder / "cut.mcap", file);
  const Check check = official_check(folder / "cut.mcap", "--stream");
  ASSERT_EQ(check.status, 0) << check.said;
  EXPECT_EQ(check.found["finished"], false);
  EXPECT_EQ(check.found["messages"], 80);
  McapReader reader(folder / "cut.mcap");
  const auto ours = messages_of(reader);
  for (const McapChannel& channel : reader.channels()) {
    EXPECT_EQ(check.found["topics"][channel.topic]["crc"], crc_of(ours, channel.topic));
  }

  repair(folder / "cut.mcap", folder / "repaired.mcap");
  const Check repaired = official_check(folder / "repaired.mcap");
  ASSERT_EQ(repaired.status, 0) << repaired.said;
  EXPECT_EQ(repaired.found["messages"], 80);
}

TEST(OfficialReader, RefusesARecordingWithAFlippedByte) {
  const TemporaryFolder folder;
  auto file = testing::make_recording(folder / "whole.mcap", 5, 20, 100).file;
  file[file.size() / 3] ^= 1;
  testing::write_contents(folder / "flipped.mcap", file);
  EXPECT_NE(official_check(folder / "flipped.mcap").status, 0);
}

TEST(OfficialReader, DecodesOurMessagesWithTheSchemaInTheFile) {
  const TemporaryFolder folder;
  const auto file = folder / "session.mcap";
  {
    McapWriter writer(file);
    const auto add = [&](const std::string& topic, const std::string& type, const Cdr& message) {
      const auto channel =
          writer.add_channel("rt/secondskin/anna/" + topic, type, "omgidl", our_idl());
      writer.write(channel, 7, kEpoch, kEpoch, message.out);
    };
    Cdr pose;
    pose.header(41).number(std::uint32_t{3});
    for (const double metres : {0.5, -1.0, 0.9}) pose.number(metres);
    pose.number(std::uint32_t{2});
    for (const double part : {0.0, 0.0, 0.0, 1.0, 0.6, 0.0, 0.8, 0.0}) pose.number(part);
    pose.number(std::uint32_t{2}).number(1.0f).number(0.25f);
    add("pose", "secondskin_msgs::msg::SkeletonPose", pose);

    Cdr tactors;
    tactors.header(42).number(std::uint64_t{1} << 60).number(std::int64_t{100'000'000});
    for (std::uint8_t i = 0; i < 40; ++i) tactors.number(i);
    add("tactors", "secondskin_msgs::msg::dds_::TactorCommand_", tactors);

    Cdr health;  // strings of odd lengths, an enumerator, structures in a sequence
    health.number(std::int64_t{kEpoch}).string("coach").string("host:12").number(std::uint32_t{2});
    health.string("").number(62.5).number(std::uint64_t{9}).number(std::uint64_t{1});
    for (const double value : {0.001, 0.004, 1.0}) health.number(value);
    health.number(std::uint32_t{1}).string("left wrist").number(60.0).number(0.25).number(0.5);
    add("health", "secondskin_msgs/msg/ServiceHealth", health);
    writer.close();
  }
  const auto decoded = [&](const std::string& topic) {
    const Check check = official_check(file, "--decode /" + topic);
    EXPECT_EQ(check.status, 0) << check.said;
    return check.status == 0 ? check.found["decoded"].at(0)["value"] : json();
  };
  const json pose = decoded("pose");
  EXPECT_EQ(pose["header"]["frame"], "41");
  EXPECT_EQ(pose["header"]["stamp_ns"], std::to_string(kEpoch));
  EXPECT_EQ(pose["skeleton_id"], 3);
  EXPECT_EQ(pose["root_position"], json({{"x", 0.5}, {"y", -1.0}, {"z", 0.9}}));
  EXPECT_EQ(pose["orientations"].at(1), json({{"x", 0.6}, {"y", 0.0}, {"z", 0.8}, {"w", 0.0}}));
  EXPECT_EQ(pose["confidences"], json({1.0, 0.25}));

  const json tactors = decoded("tactors");
  EXPECT_EQ(tactors["command_number"], "1152921504606846976");
  EXPECT_EQ(tactors["intensities"].size(), 40u);
  EXPECT_EQ(tactors["intensities"].at(39), 39);

  const json health = decoded("health");
  EXPECT_EQ(health["service"], "coach");
  EXPECT_EQ(health["state"], 2);
  EXPECT_EQ(health["rate_hz"], 62.5);
  EXPECT_EQ(health["lost"], "1");
  EXPECT_EQ(health["sensors"].at(0)["name"], "left wrist");
  EXPECT_EQ(health["sensors"].at(0)["confidence"], 0.5);
}

}  // namespace
}  // namespace secondskin::recording
