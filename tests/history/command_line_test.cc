#include <gtest/gtest.h>

#include <chrono>
#include <nlohmann/json.hpp>

#include "clients/history/history.h"
#include "course.h"
#include "tests/session/process.h"

namespace secondskin::history {
namespace {

using nlohmann::json;

class HistoryCommand : public testing::Test {
 protected:
  struct Result {
    int exit_code;
    std::string output;
  };
  Result run(std::vector<std::string> words) {
    words.insert(words.begin(), "history");
    words.insert(words.end(), {"--database", file});
    session::Process program(words, folder / "output");
    EXPECT_TRUE(program.wait(std::chrono::seconds(60)));
    return {program.exit_code(), program.output()};
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
};

TEST_F(HistoryCommand, ListsShowsReportsExportsAndDeletes) {
  fill();
  const auto added = run({"add", "--note", "left knee"});
  ASSERT_EQ(added.exit_code, 0) << added.output;
  const json learners = json::parse(run({"learners", "--json"}).output);
  ASSERT_EQ(learners.size(), 2u);
  EXPECT_EQ(learners[1]["id"].get<std::string>() + "\n", added.output);
  EXPECT_NE(run({"sessions", "L-TEST34"}).output.find("48.4"), std::string::npos);
  EXPECT_EQ(json::parse(run({"show", "1", "--json"}).output)["blocks"].size(), 2u);
  const json progress = json::parse(run({"progress", "L-TEST34", "--json"}).output);
  EXPECT_DOUBLE_EQ(progress["retention"][0]["change"], -4.0);
  EXPECT_EQ(run({"report", "L-TEST34", "--to", folder / "r.html"}).exit_code, 0);
  EXPECT_NE(session::read_text(folder / "r.html").find("L-TEST34"), std::string::npos);
  EXPECT_EQ(run({"export", "L-TEST34", "--to", folder / "e.csv"}).exit_code, 0);
  EXPECT_TRUE(session::read_text(folder / "e.csv").starts_with("learner,session,"));
  const auto asked = run({"delete", "L-TEST34"});
  EXPECT_NE(asked.exit_code, 0) << "nobody was there to say yes";
  EXPECT_NE(asked.output.find("--yes"), std::string::npos) << asked.output;
  EXPECT_EQ(run({"delete", "L-TEST34", "--yes"}).exit_code, 0);
  EXPECT_EQ(json::parse(run({"sessions", "--json"}).output), json::array());
}

TEST_F(HistoryCommand, SaysWhatIsWrongAndMakesNoFileByReading) {
  const auto none = run({"learners"});
  EXPECT_NE(none.exit_code, 0);
  EXPECT_NE(none.output.find("no history yet"), std::string::npos) << none.output;
  EXPECT_FALSE(std::filesystem::exists(file));
  fill();
  const auto refused = [&](const std::vector<std::string>& words, const std::string& why) {
    const auto got = run(words);
    EXPECT_NE(got.exit_code, 0) << got.output;
    EXPECT_NE(got.output.find(why), std::string::npos) << got.output;
  };
  refused({"sessions", "L-NOBODY"}, "L-NOBODY");
  refused({"show", "77"}, "SESSION 77");
  refused({"progress", "L-TEST34", "--reference", "punch"}, "practised squat");
  refused({"report", "L-TEST34", "--to", "report.doc"}, ".html or .pdf");
  refused({"export", "L-TEST34"}, "--format");
}

}  // namespace
}  // namespace secondskin::history
