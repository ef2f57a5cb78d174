#include "clients/players/recordings_api.h"

#include <gmock/gmock.h>
#include <unistd.h>

#include <fstream>
#include <nlohmann/json.hpp>
#include <thread>

#include "bus/pose_messages.h"
#include "clients/players/topic_file.h"
#include "motion/anatomy.h"

namespace secondskin::players {
namespace {

namespace fs = std::filesystem;
using dashboard::HttpResponse;
using nlohmann::json;
using testing::HasSubstr;

constexpr std::int64_t kStart = 1'700'000'000'000'000'000;

class RecordingsApiTest : public testing::Test {
 protected:
  RecordingsApiTest() {
    std::string name = (fs::temp_directory_path() / "secondskin_XXXXXX").string();
    root_ = ::mkdtemp(name.data());
    folder_ = root_ / "recordings";
    fs::create_directory(folder_);
    write(folder_ / "poses.mcap");
    const auto unknown = [](const char* kind, const std::string& asked) {
      return std::runtime_error(std::string(kind) + " '" + asked + "' is not known");
    };
    api_ = recordings_api(
        {.folder = folder_,
         .idl = fs::path(SECONDSKIN_SOURCE_DIR) / "idl" / "secondskin_msgs.idl",
         .library = {
             .reference = [=](const std::string& n) -> std::shared_ptr<const coach::Reference> {
               throw unknown("reference", n);
             },
             .body_map = [=](const std::string& n) -> coach::BodyMap {
               throw unknown("body map", n);
             },
             .plan = [=](const std::string& n) -> coach::SessionPlan {
               throw unknown("plan", n);
             }}});
  }
  ~RecordingsApiTest() override {
    api_ = nullptr;
    fs::remove_all(root_);
  }

  /// Two seconds of a body at rest, without a coach; sessions of these learners.
  static void write(const fs::path& file, const std::vector<std::string>& learners = {}) {
    TopicFile out(file, fs::path(SECONDSKIN_SOURCE_DIR) / "idl" / "secondskin_msgs.idl", "test");
    const Skeleton skeleton = canonical_skeleton(1.7);
    bus::msg::SkeletonDefinition body;
    bus::to_message(skeleton, "test", 50.0, body);
    out.write(kStart, body);
    bus::msg::SessionState state;
    for (const auto& learner : learners) {
      state.learner(learner);
      out.write(kStart, state);
    }
    bus::msg::SkeletonPose message;
    for (int i = 0; i <= 100; ++i) {
      StampedPose pose;
      pose.frame = static_cast<std::uint64_t>(i) + 1;
      pose.stamp_ns = kStart + i * 20'000'000;
      pose.pose = Pose(kJointCount);
      bus::to_message(pose, body.skeleton_id(), message);
      out.write(pose.stamp_ns, message);
    }
    out.close();
  }

  HttpResponse ask(const std::string& path, const std::string& method = "GET",
                   const std::string& body = {}, std::map<std::string, std::string> query = {}) {
    auto answer = api_({method, path, std::move(query), body});
    EXPECT_TRUE(answer) << path;
    return answer.value_or(HttpResponse{});
  }
  /// Asks until it is no longer being made.
  HttpResponse made(const std::string& path) {
    for (int i = 0; i < 1000; ++i) {
      auto answer = ask(path);
      if (answer.status != 202) return answer;
      std::this_thread::sleep_for(std::chrono::milliseconds(5));
    }
    ADD_FAILURE() << path << " is never made";
    return {};
  }

  /// Deletes their recordings, and waits until it is done.
  json removed(const std::string& learner) {
    const auto begun = ask("/api/recordings", "DELETE", {}, {{"learner", learner}});
    EXPECT_EQ(begun.status, 202u) << begun.body;
    const std::string job = json::parse(begun.body)["job"];
    for (int i = 0; i < 1000; ++i) {
      const auto now = json::parse(ask("/api/recordings/removals/" + job).body);
      if (now.contains("result")) return now["result"];
      if (now["state"] == "failed") break;
      std::this_thread::sleep_for(std::chrono::milliseconds(5));
    }
    ADD_FAILURE() << learner << "'s recordings are never removed";
    return {};
  }

  fs::path root_, folder_;
  dashboard::HttpHandler api_;
};

TEST_F(RecordingsApiTest, ListsWhatIsInTheFolder) {
  std::ofstream(folder_ / "broken.mcap") << "no recording";
  std::ofstream(folder_ / "notes.txt") << "no recording either";
  const auto list = json::parse(ask("/api/recordings").body);
  ASSERT_EQ(list.size(), 2u) << list;
  EXPECT_EQ(list[0]["name"], "poses.mcap");
  EXPECT_EQ(list[0]["state"], "finished");
  EXPECT_EQ(list[0]["subject"], "test");
  EXPECT_EQ(list[0]["start"], "2023-11-14T22:13:20.000Z");
  EXPECT_NEAR(list[0]["duration"].get<double>(), 2.0, 1e-9);
  EXPECT_EQ(list[0]["bytes"], fs::file_size(folder_ / "poses.mcap"));
  EXPECT_EQ(list[0]["coached"], false);
  EXPECT_EQ(list[1]["state"], "damaged");
  EXPECT_THAT(list[1]["error"].get<std::string>(), HasSubstr("expected the MCAP magic"));
  EXPECT_THAT(list[1]["error"].get<std::string>(), testing::Not(HasSubstr(root_.string())));
}

TEST_F(RecordingsApiTest, RemovesALearnersRecordingsAndNobodyElses) {
  write(folder_ / "hers.mcap", {"", "L-ANNA"});
  write(folder_ / "his.mcap", {"L-BERT"});
  write(folder_ / "both.mcap", {"L-ANNA", "L-BERT"});
  std::ofstream(folder_ / "broken.mcap") << "no recording";
  fs::create_directory(folder_ / ".players");
  std::ofstream(folder_ / ".players" / "rerun-1.mcap") << "computed of hers";
  std::ofstream(folder_ / ".players" / "rerun-2.part") << "half computed of hers";
  const auto states = made("/api/recordings/hers.mcap/states").file;
  ASSERT_TRUE(fs::exists(states));

  const json answer = removed("L-ANNA");
  EXPECT_EQ(answer["removed"], json::array({"hers.mcap"}));
  ASSERT_EQ(answer["kept"].size(), 2u) << answer;
  EXPECT_EQ(answer["kept"][0]["name"], "both.mcap");
  EXPECT_THAT(answer["kept"][0]["why"].get<std::string>(), HasSubstr("other learners"));
  EXPECT_EQ(answer["kept"][1]["name"], "broken.mcap");
  EXPECT_FALSE(fs::exists(folder_ / "hers.mcap"));
  for (const fs::path& gone :
       {folder_ / ".players" / "rerun-1.mcap", folder_ / ".players" / "rerun-2.part", states}) {
    EXPECT_FALSE(fs::exists(gone)) << gone;
  }
  for (const char* name : {"his.mcap", "both.mcap", "broken.mcap", "poses.mcap"}) {
    EXPECT_TRUE(fs::exists(folder_ / name)) << name;
  }
  EXPECT_EQ(ask("/api/recordings", "DELETE").status, 400u) << "nobody named";
  EXPECT_TRUE(fs::exists(folder_ / "his.mcap"));
  // Once more is not the answer of before.
  write(folder_ / "again.mcap", {"L-ANNA"});
  EXPECT_EQ(removed("L-ANNA")["removed"], json::array({"again.mcap"}));
  EXPECT_EQ(ask("/api/recordings/removals/nix").status, 404u);
}

TEST_F(RecordingsApiTest, ExtractsTheStatesAsTheyAre) {
  write(folder_ / "hers.mcap", {"", "L-ANNA"});
  const auto answer = made("/api/recordings/hers.mcap/states");
  ASSERT_EQ(answer.status, 200u) << answer.body;
  recording::McapReader whole(folder_ / "hers.mcap"), states(answer.file);
  std::map<std::string, std::vector<std::string>> expected, found;
  const auto collect = [](recording::McapReader& from, auto& into) {
    std::map<std::uint16_t, std::string> topics;
    for (const auto& channel : from.channels()) topics[channel.id] = channel.topic;
    from.for_each([&](const recording::McapMessage& raw) {
      into[topics.at(raw.channel)].emplace_back(raw.data.begin(), raw.data.end());
      return true;
    });
  };
  collect(whole, expected);
  collect(states, found);
  EXPECT_EQ(expected.erase("/secondskin/test/pose"), 1u);
  EXPECT_EQ(found, expected);
  EXPECT_EQ(found.at("/secondskin/test/session_state").size(), 2u);
  EXPECT_EQ(states.channels().front().schema_text, whole.channels().front().schema_text);
}

TEST_F(RecordingsApiTest, WhatTheDiskRefusedIsTriedAgain) {
  std::ofstream(folder_ / ".players") << "where a folder should be";
  const auto refused = made("/api/recordings/poses.mcap/states");
  EXPECT_EQ(refused.status, 503u) << refused.body;
  fs::remove(folder_ / ".players");
  EXPECT_EQ(made("/api/recordings/poses.mcap/states").status, 200u);
}

TEST_F(RecordingsApiTest, LeavesNeitherItsPathNorItsFolder) {
  write(root_ / "outside.mcap");
  fs::create_symlink(root_ / "outside.mcap", folder_ / "link.mcap");
  for (const char* name :
       {"../outside.mcap", "link.mcap", "..", "", ".mcap", "a/../../outside.mcap", "poses",
        "/etc/passwd", "poses.mcap/../../outside.mcap"}) {
    const auto answer = ask(std::string("/api/recordings/") + name + "/file");
    EXPECT_EQ(answer.status, 404u) << name;
    EXPECT_TRUE(answer.file.empty()) << name;
  }
  EXPECT_EQ(ask("/api/recordings/poses.mcap/file").file, fs::canonical(folder_ / "poses.mcap"));
  EXPECT_FALSE(api_({"GET", "/api/recordingsx", {}, {}}));
  EXPECT_FALSE(api_({"GET", "/api/other", {}, {}}));
  EXPECT_EQ(ask("/api/recordings/poses.mcap/file", "DELETE").status, 405u);
  EXPECT_EQ(ask("/api/recordings", "POST").status, 405u);
  EXPECT_EQ(json::parse(ask("/api/recordings").body).size(), 1u);  // the link is not listed
}

TEST_F(RecordingsApiTest, OpensAnUnfinishedFileUpToWhatIsStored) {
  const auto whole = fs::file_size(folder_ / "poses.mcap");
  fs::copy_file(folder_ / "poses.mcap", folder_ / "torn.mcap");
  // The index and the end of the last chunk's record are gone.
  fs::resize_file(folder_ / "torn.mcap", whole - 60);
  const auto about = json::parse(ask("/api/recordings/torn.mcap").body);
  EXPECT_EQ(about["state"], "being recorded");  // it was written to just now
  EXPECT_FALSE(about.contains("start")) << "it is read beside the requests";
  fs::last_write_time(folder_ / "torn.mcap",
                      fs::file_time_type::clock::now() - std::chrono::minutes(1));
  EXPECT_EQ(json::parse(ask("/api/recordings/torn.mcap").body)["state"], "unfinished");
  json later;
  for (int i = 0; i < 1000 && !later.contains("start"); ++i) {
    later = json::parse(ask("/api/recordings/torn.mcap").body);
    std::this_thread::sleep_for(std::chrono::milliseconds(5));
  }
  EXPECT_EQ(later["start"], "2023-11-14T22:13:20.000Z");
  const auto repaired = made("/api/recordings/torn.mcap/repaired");
  ASSERT_EQ(repaired.status, 200u) << repaired.body;
  recording::McapReader reader(repaired.file);
  EXPECT_TRUE(reader.finished());
  EXPECT_EQ(reader.messages(), 102u);
}

TEST_F(RecordingsApiTest, ACopyOfAFileThatGrowsStaysWhatItIs) {
  const fs::path file = folder_ / "growing.mcap";
  fs::copy_file(folder_ / "poses.mcap", file);
  fs::resize_file(file, fs::file_size(file) - 60);
  const std::string path = "/api/recordings/growing.mcap/repaired";
  const auto job = json::parse(ask(path, "POST").body)["job"].get<std::string>();
  int asked = 0;
  HttpResponse copy{.status = 202, .body = {}, .file_name = {}};
  for (; copy.status == 202 && asked < 1000; ++asked) {
    std::ofstream(file, std::ios::app) << "more";
    copy = ask(path + "/" + job);
    std::this_thread::sleep_for(std::chrono::milliseconds(5));
  }
  ASSERT_EQ(copy.status, 200u) << copy.body;
  EXPECT_EQ(recording::McapReader(copy.file).messages(), 102u);
  const auto ghost = made(path + "/" + job + "/expert");
  EXPECT_EQ(ghost.status, 409u);
  EXPECT_THAT(ghost.body, HasSubstr("holds no coached session"));
  EXPECT_EQ(ask(path + "/repaired-0").status, 404u);
}

TEST_F(RecordingsApiTest, SaysWhyThereIsNoGhostAndNoRerun) {
  const auto ghost = made("/api/recordings/poses.mcap/expert");
  EXPECT_EQ(ghost.status, 409u);
  EXPECT_THAT(ghost.body, HasSubstr("holds no coached session"));
  const auto job = json::parse(ask("/api/recordings/poses.mcap/rerun", "POST").body);
  const std::string at = "/api/recordings/poses.mcap/reruns/" + job["job"].get<std::string>();
  const auto rerun = made(at + "/file");
  EXPECT_EQ(rerun.status, 409u);
  EXPECT_THAT(rerun.body, HasSubstr("holds no coached session"));
  EXPECT_EQ(json::parse(ask(at).body)["state"], "failed");
}

TEST_F(RecordingsApiTest, AFailedJobDoesNotSayWhereTheFolderIs) {
  std::ofstream(folder_ / "noise.mcap") << "no recording at all";
  const auto states = made("/api/recordings/noise.mcap/states");
  EXPECT_EQ(states.status, 409u);
  EXPECT_THAT(json::parse(states.body)["error"].get<std::string>(),
              testing::StartsWith("noise.mcap: offset 0"));
  const auto job = json::parse(ask("/api/recordings/noise.mcap/rerun", "POST").body);
  const std::string at = "/api/recordings/noise.mcap/reruns/" + job["job"].get<std::string>();
  made(at + "/file");
  const auto error = json::parse(ask(at).body)["error"].get<std::string>();
  EXPECT_THAT(error, HasSubstr("expected the MCAP magic"));
  EXPECT_THAT(error, testing::Not(HasSubstr(root_.string())));
}

TEST_F(RecordingsApiTest, NamesTheSettingThatIsWrong) {
  const std::pair<const char*, const char*> wrong[] = {
      {R"({"tolerance_scale": 0})", "tolerance_scale: expected"},
      {R"({"tolerance_scale": "wide"})", "tolerance_scale: expected"},
      {R"({"max_cues": 0})", "max_cues: expected 1 to 22"},
      {R"({"max_cues": 1.5})", "max_cues: expected"},
      {R"({"reference": 7})", "reference: expected a name"},
      {R"({"reference": "nix"})", "reference 'nix' is not known"},
      {R"({"plan": "nix"})", "plan 'nix'"},
      {R"({"body_map": "nix"})", "body map 'nix'"},
      {R"({"tolerance": 2})", "tolerance: expected reference, tolerance_scale"},
      {"[1]", "body: expected a JSON object"},
      {"{", "body: expected a JSON object"}};
  for (const auto& [body, expected] : wrong) {
    const auto answer = ask("/api/recordings/poses.mcap/rerun", "POST", body);
    EXPECT_EQ(answer.status, 400u) << body;
    EXPECT_THAT(answer.body, HasSubstr(expected)) << body;
  }
  EXPECT_EQ(ask("/api/recordings/poses.mcap/reruns/rerun-0123").status, 404u);
  EXPECT_EQ(ask("/api/recordings/poses.mcap/reruns/../../x").status, 404u);
  EXPECT_EQ(ask("/api/recordings/poses.mcap/nix").status, 404u);
}

}  // namespace
}  // namespace secondskin::players
