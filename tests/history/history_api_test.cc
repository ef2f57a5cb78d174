#include "clients/history/history_api.h"

#include <gtest/gtest.h>

#include <fstream>
#include <nlohmann/json.hpp>

#include "clients/history/history.h"
#include "clients/history/profiles.h"
#include "course.h"
#include "tests/session/process.h"

namespace secondskin::history {
namespace {

using dashboard::HttpRequest;
using dashboard::HttpResponse;
using nlohmann::json;

class HistoryApi : public testing::Test {
 protected:
  HttpResponse ask(const std::string& method, const std::string& path,
                   std::map<std::string, std::string> query = {}, const std::string& body = {}) {
    return handler({method, "/api/history/" + path, std::move(query), body}).value();
  }
  void fill() {
    History history(file);
    Session session = session_of(0, kMorning,
                                 {block_of(0, "always", kMorning, {40, 50, 60}),
                                  block_of(1, "off", kMorning + 300 * kSecond, {44, 48})});
    ASSERT_TRUE(history.book(session, true));
    for (const Block& block : session.blocks) {
      for (const Repetition& repetition : block.repetitions) {
        ASSERT_EQ(history.book("learner", repetition), History::Booked::kNew);
      }
    }
  }

  session::Folder folder;
  std::string file = folder / "h.db";
  dashboard::HttpHandler handler = history_api(file, folder / "learners");
};

TEST_F(HistoryApi, LeavesOtherPathsToOthers) {
  EXPECT_FALSE(handler({"GET", "/api/plans", {}, {}}));
  EXPECT_FALSE(handler({"GET", "/", {}, {}}));
}

TEST_F(HistoryApi, MakesNotesAndDeletesLearners) {
  const auto made = ask("POST", "learners", {}, R"({"note": "left knee"})");
  EXPECT_EQ(made.status, 201u);
  const std::string id = json::parse(made.body)["id"];
  EXPECT_EQ(ask("PATCH", "learners/" + id, {}, R"({"note": "both knees"})").status, 200u);
  const json all = json::parse(ask("GET", "learners").body);
  ASSERT_EQ(all.size(), 1u);
  EXPECT_EQ(all[0]["note"], "both knees");
  EXPECT_EQ(all[0]["sessions"], 0);
  EXPECT_TRUE(all[0]["last_session"].is_null());
  EXPECT_EQ(ask("DELETE", "learners/" + id).status, 204u);
  EXPECT_EQ(ask("DELETE", "learners/" + id).status, 404u);
  EXPECT_EQ(json::parse(ask("GET", "learners").body), json::array());
}

TEST_F(HistoryApi, DeletesALearnersOwnProfilesWithThem) {
  fill();
  const std::filesystem::path profiles = folder / "learners";
  std::filesystem::create_directory(profiles);
  const auto write = [&](const char* name) { std::ofstream(profiles / name) << "skin"; };
  for (const char* name :
       {"L-TEST34.toml", "L-TEST34.exposure.toml", "L-TEST34.toml.partial", "L-TEST345.toml"}) {
    write(name);
  }
  EXPECT_EQ(profile_of(profiles, "L-TEST34"), profiles / "L-TEST34.toml");
  EXPECT_EQ(ask("DELETE", "learners/L-TEST34").status, 204u);
  std::vector<std::string> left;
  for (const auto& entry : std::filesystem::directory_iterator(profiles)) {
    left.push_back(entry.path().filename());
  }
  EXPECT_EQ(left, std::vector<std::string>{"L-TEST345.toml"});
}

TEST(LearnersProfile, LeavesItsFolderForNoId) {
  const session::Folder folder;
  const std::filesystem::path inside = folder / "learners";
  std::filesystem::create_directory(inside);
  std::ofstream(folder / "other.toml") << "another's";
  EXPECT_TRUE(remove_profile(inside, "../other").empty());
  EXPECT_TRUE(std::filesystem::exists(folder / "other.toml"));
  for (const char* id : {"../other", "", ".", "a/b"}) {
    EXPECT_THROW(profile_of(inside, id), std::runtime_error) << id;
  }
}

TEST_F(HistoryApi, GivesSessionsProgressReportAndExport) {
  fill();
  const json sessions = json::parse(ask("GET", "sessions", {{"learner", "L-TEST34"}}).body);
  ASSERT_EQ(sessions.size(), 1u);
  EXPECT_EQ(sessions[0]["repetitions"], 5);
  EXPECT_EQ(sessions[0]["subject"], "learner");
  EXPECT_DOUBLE_EQ(sessions[0]["mean_total"], 48.4);
  const std::string id = std::to_string(sessions[0]["id"].get<int>());
  const json whole = json::parse(ask("GET", "sessions/" + id).body);
  EXPECT_EQ(whole["blocks"][1]["repetitions"][0]["joints"][0]["name"], "left_knee");
  EXPECT_EQ(whole["exposure"][0]["channel"], 3);
  const json progress =
      json::parse(ask("GET", "progress", {{"learner", "L-TEST34"}, {"reference", "squat"}}).body);
  ASSERT_EQ(progress["points"].size(), 2u);
  EXPECT_DOUBLE_EQ(progress["points"][0]["mean_total"], 50.0);
  EXPECT_DOUBLE_EQ(progress["retention"][0]["change"], -4.0);
  EXPECT_EQ(progress["schedules"][0]["schedule"], "always");
  const auto report = ask("GET", "report", {{"learner", "L-TEST34"}, {"format", "html"}});
  EXPECT_EQ(report.content_type, "text/html; charset=utf-8");
  EXPECT_TRUE(report.body.starts_with("<!DOCTYPE html>"));
  const auto csv = ask("GET", "export", {{"learner", "L-TEST34"}, {"format", "csv"}});
  EXPECT_EQ(csv.file_name, "history_L-TEST34.csv");
  const auto all = ask("GET", "export", {{"learner", "L-TEST34"}, {"format", "json"}});
  EXPECT_EQ(json::parse(all.body)["sessions"][0]["blocks"].size(), 2u);
}

TEST_F(HistoryApi, SaysWhatWasExpected) {
  fill();
  const auto refused = [&](unsigned status, const std::string& words, const HttpResponse& got) {
    EXPECT_EQ(got.status, status) << got.body;
    const json body = json::parse(got.body);
    EXPECT_NE(body["error"].get<std::string>().find(words), std::string::npos) << got.body;
  };
  const std::string learner = "L-TEST34";
  refused(404, "path", ask("GET", "nothing"));
  refused(405, "method", ask("PUT", "learners"));
  refused(405, "method", ask("POST", "sessions/1"));
  refused(404, "session", ask("GET", "sessions/12x"));
  refused(404, "session", ask("GET", "sessions/99"));
  refused(404, "learner", ask("GET", "sessions", {{"learner", "L-NOBODY"}}));
  refused(400, "learner", ask("GET", "progress", {{"reference", "squat"}}));
  refused(400, "reference: expected one of squat", ask("GET", "progress", {{"learner", learner}}));
  refused(400, "format", ask("GET", "report", {{"learner", learner}}));
  refused(400, "got \"doc\"", ask("GET", "report", {{"learner", learner}, {"format", "doc"}}));
  refused(400, "body", ask("POST", "learners", {}, "not json"));
  refused(400, "name", ask("POST", "learners", {}, R"({"name": "Marie"})"));
  refused(400, "note", ask("PATCH", "learners/" + learner, {}, R"({"note": 3})"));
  refused(400, "note", ask("PATCH", "learners/" + learner, {}, "{}"));
  refused(404, "learner", ask("PATCH", "learners/L-NOBODY", {}, R"({"note": "x"})"));
}

TEST_F(HistoryApi, AFileThatIsNoHistoryIsSaidAndTriedAgain) {
  std::ofstream(file) << "this is something else entirely";
  const auto got = ask("GET", "learners");
  EXPECT_EQ(got.status, 503u);
  EXPECT_NE(got.body.find("expected a history"), std::string::npos) << got.body;
  std::filesystem::remove(file);
  EXPECT_EQ(ask("GET", "learners").status, 200u);
}

}  // namespace
}  // namespace secondskin::history
