#include <gmock/gmock.h>
#include <unistd.h>

#include <algorithm>
#include <condition_variable>
#include <iterator>
#include <map>
#include <mutex>
#include <set>

#include "clients/dashboard/live_scene.h"
#include "clients/players/coach_rerun.h"
#include "clients/players/topic_file.h"
#include "session.h"

// A session of the real services, recorded; then its ghost, and the coach again with other
// settings.
namespace secondskin::players {
namespace {

namespace fs = std::filesystem;
namespace msg = bus::msg;
using session::eventually;
using session::Process;
using namespace std::chrono_literals;
using Bytes = std::vector<std::uint8_t>;

const fs::path kSource = SECONDSKIN_SOURCE_DIR;
const fs::path kIdl = kSource / "idl" / "secondskin_msgs.idl";

std::shared_ptr<const coach::Reference> find(const std::string& name) {
  return std::make_shared<const coach::Reference>(
      coach::load_reference(kSource / "reference_motions" / name, kSource / "joint_maps"));
}

RerunLibrary library() { return {.reference = find, .body_map = {}, .plan = {}}; }

struct Message {
  std::int64_t time_ns;
  Bytes bytes;
};
/// All messages by channel.
std::map<std::string, std::vector<Message>> read(const fs::path& file) {
  recording::McapReader reader(file);
  std::map<std::uint16_t, std::string> names;
  for (const auto& channel : reader.channels()) {
    names[channel.id] = channel.topic.substr(channel.topic.rfind('/') + 1);
  }
  std::map<std::string, std::vector<Message>> out;
  reader.for_each([&](const recording::McapMessage& raw) {
    out[names.at(raw.channel)].push_back(
        {raw.log_time_ns, Bytes(raw.data.begin(), raw.data.end())});
    return true;
  });
  return out;
}

template <class T>
std::set<std::int64_t> stamps(const std::vector<Message>& messages) {
  std::set<std::int64_t> out;
  for (const auto& message : messages) {
    T decoded;
    EXPECT_TRUE(bus::decode(message.bytes, decoded));
    out.insert(decoded.header().stamp_ns());
  }
  return out;
}

std::vector<msg::RepetitionScore> scores(const std::vector<Message>& messages) {
  std::vector<msg::RepetitionScore> out;
  for (const auto& message : messages) {
    EXPECT_TRUE(bus::decode(message.bytes, out.emplace_back()));
  }
  return out;
}

/// What the bridge would have shown, frame by frame.
std::map<std::uint64_t, Bytes> live_ghosts(const fs::path& file) {
  std::mutex mutex;
  std::condition_variable news;
  std::map<std::uint64_t, Bytes> ghosts;
  dashboard::LiveScene scene(
      {.subject = "test",
       .reference = find,
       .wanted = [](dashboard::Drawn drawn) { return drawn == dashboard::Drawn::kExpert; },
       .publish =
           [&](dashboard::Drawn, std::int64_t, Bytes bytes) {
             msg::SkeletonPose pose;
             ASSERT_TRUE(bus::decode(bytes, pose));
             const std::lock_guard lock(mutex);
             pose.header().publish_ns(0);
             ghosts[pose.header().frame()] = bus::encode(pose);
             news.notify_one();
           }});
  std::jthread thread([&](std::stop_token stop) { scene.run(stop); });
  recording::McapReader reader(file);
  const auto topics = topics_of(reader);
  msg::Alignment alignment;
  bool first = true;
  reader.for_each([&](const recording::McapMessage& raw) {
    const auto topic = topics.at(raw.channel);
    scene.take(topic, raw.log_time_ns, raw.data);
    if (topic != bus::kTopicOf<msg::Alignment> || !bus::decode(raw.data, alignment)) return true;
    // Only the newest counts to it: so each is waited for.
    std::unique_lock lock(mutex);
    const bool came = news.wait_for(lock, first ? 2s : 500ms,
                                    [&] { return ghosts.contains(alignment.header().frame()); });
    first = first && !came;
    return true;
  });
  return ghosts;
}

TEST(Rerun, OfARealSession) {
  const session::Session session;
  const fs::path file = session.folder / "live.mcap";
  Process recorder = session.start("record", session.on_bus({"record", file}));
  Process coach = session.start(
      "coach", session.on_bus({"coach", "--reference", "low_block", "--tolerance-scale", "0.5"}));
  ASSERT_TRUE(eventually([&] { return recorder.says("recording to"); }, 10s));
  std::this_thread::sleep_for(2s);  // the recorder finds the coach's topics
  Process capture = session.start(
      "capture",
      session.on_bus({"capture", (kSource / "reference_motions/low_block/learner.bvh").string(),
                      "--speed", "2", "--wait-for", "2"}));
  ASSERT_TRUE(capture.wait(30s)) << capture.output();
  coach.end(SIGTERM);
  ASSERT_TRUE(coach.wait(10s));
  recorder.end(SIGTERM);
  ASSERT_TRUE(recorder.wait(10s));
  const auto recorded = read(file);
  const auto recorded_scores = scores(recorded.at("repetition"));
  ASSERT_GE(recorded_scores.size(), 1u);

  // The ghost: byte for byte what the bridge shows.
  const fs::path ghost_file = session.folder / "ghost.mcap";
  write_expert(file, kIdl, find, ghost_file);
  const auto live = live_ghosts(file);
  std::size_t equal = 0;
  const auto ghosts = read(ghost_file);
  for (const auto& message : ghosts.at("expert")) {
    msg::SkeletonPose ghost;
    ASSERT_TRUE(bus::decode(message.bytes, ghost));
    ghost.header().publish_ns(0);
    const auto shown = live.find(ghost.header().frame());
    if (shown != live.end() && shown->second == bus::encode(ghost)) ++equal;
  }
  EXPECT_GT(equal, 100u);
  EXPECT_EQ(equal, live.size());

  // Unchanged settings: the recorded alignment and scores to the last bit, since neither depends on
  // when the solver was ready; and each time the same messages.
  const fs::path same_file = session.folder / "same.mcap",
                 again_file = session.folder / "again.mcap";
  const auto same_result = rerun_coach(file, kIdl, library(), {}, same_file);
  EXPECT_TRUE(same_result.remarks.empty());
  rerun_coach(file, kIdl, library(), {}, again_file);
  const auto same = read(same_file), again = read(again_file);
  ASSERT_EQ(same.size(), again.size());
  for (const auto& [name, messages] : same) {
    ASSERT_EQ(messages.size(), again.at(name).size()) << name;
    for (std::size_t i = 0; i < messages.size(); ++i) {
      ASSERT_EQ(messages[i].time_ns, again.at(name)[i].time_ns) << name;
      ASSERT_EQ(messages[i].bytes, again.at(name)[i].bytes) << name;
    }
  }
  const auto same_scores = scores(same.at("repetition"));
  ASSERT_EQ(same_scores.size(), recorded_scores.size());
  std::uint32_t cues_recorded = 0, cues_same = 0;
  for (std::size_t i = 0; i < same_scores.size(); ++i) {
    EXPECT_EQ(same_scores[i].total(), recorded_scores[i].total()) << i;
    EXPECT_EQ(same_scores[i].end_ns(), recorded_scores[i].end_ns()) << i;
    cues_recorded += recorded_scores[i].cues();
    cues_same += same_scores[i].cues();
  }
  // The coach may have met the first pose when the recorder had not found the capture yet.
  const auto poses = stamps<msg::SkeletonPose>(recorded.at("pose")),
             judged = stamps<msg::Alignment>(recorded.at("alignment"));
  std::set<std::int64_t> both;
  std::set_intersection(poses.begin(), poses.end(), judged.begin(), judged.end(),
                        std::inserter(both, both.end()));
  ASSERT_EQ(stamps<msg::Alignment>(same.at("alignment")), both);
  EXPECT_GE(both.size() + 1, judged.size());
  EXPECT_EQ(same.at("pose").size(), recorded.at("pose").size());
  ASSERT_GT(cues_same, 0u);
  RecordProperty("cues_recorded", static_cast<int>(cues_recorded));
  RecordProperty("cues_unchanged", static_cast<int>(cues_same));

  // Four times the tolerance: the same scores, fewer cues.
  const fs::path wide_file = session.folder / "wide.mcap";
  RerunSettings wide;
  wide.tolerance_scale = 2.0;
  const auto wide_result = rerun_coach(file, kIdl, library(), wide, wide_file);
  const auto wide_messages = read(wide_file);
  std::uint32_t cues_wide = 0;
  for (const auto& score : scores(wide_messages.at("repetition"))) cues_wide += score.cues();
  EXPECT_LT(cues_wide, cues_same);
  EXPECT_LT(wide_result.cues, same_result.cues);
  msg::SessionState state;
  ASSERT_TRUE(bus::decode(wide_messages.at("session_state").back().bytes, state));
  EXPECT_EQ(state.tolerance_scale(), 2.0);
  EXPECT_EQ(state.repetitions(), recorded_scores.size());

  // Another exercise than was done: other scores, or none at all.
  RerunSettings other;
  other.reference = "squat";
  const auto other_result =
      rerun_coach(file, kIdl, library(), other, session.folder / "other.mcap");
  for (const auto& score : other_result.repetitions) EXPECT_LT(score.total, 60.0);

  // One joint at once: no more are asked for.
  const fs::path one_file = session.folder / "one.mcap";
  RerunSettings one;
  one.max_cues = 1;
  rerun_coach(file, kIdl, library(), one, one_file);
  std::size_t most = 0;
  const auto narrow = read(one_file);
  for (const auto& message : narrow.at("correction")) {
    msg::Correction correction;
    ASSERT_TRUE(bus::decode(message.bytes, correction));
    const auto asked = std::count_if(
        correction.joints().begin(), correction.joints().end(), [](const auto& joint) {
          return joint.target().x() != 0.0 || joint.target().y() != 0.0 ||
                 joint.target().z() != 0.0;
        });
    most = std::max(most, static_cast<std::size_t>(asked));
  }
  EXPECT_EQ(most, 1u);

  RerunSettings wrong;
  wrong.tolerance_scale = 0.0;
  try {
    rerun_coach(file, kIdl, library(), wrong, session.folder / "wrong.mcap");
    FAIL();
  } catch (const std::runtime_error& error) {
    EXPECT_THAT(error.what(), testing::HasSubstr("tolerance_scale 0: expected 0.1 to 10"));
  }
}

}  // namespace
}  // namespace secondskin::players
