#include <SQLiteCpp/SQLiteCpp.h>
#include <gtest/gtest.h>

#include <chrono>
#include <map>
#include <random>
#include <sstream>
#include <thread>

#include "clients/history/history.h"
#include "program.h"
#include "tests/session/process.h"

namespace secondskin::history {
namespace {

TEST(HistoryUnderKill, LosesNothingThatWasFinished) {
  const session::Folder folder;
  const std::string file = folder / "h.db";
  std::mt19937 random(7);
  std::uniform_int_distribution<int> moment(20, 220);
  std::size_t told = 0;
  std::map<std::int64_t, int> all;
  for (int round = 0; round < 20; ++round) {
    const std::string said = folder / "said";
    {
      Program writer("history_writer", {file, std::to_string(round)}, said);
      std::this_thread::sleep_for(std::chrono::milliseconds(moment(random)));
      writer.end(SIGKILL);
    }
    History history(file);  // checks that it is whole
    std::map<std::int64_t, int> kept;
    for (const Session& session : history.course("L-TEST34")) {
      for (const Block& block : session.blocks) {
        for (const Repetition& repetition : block.repetitions) {
          ++kept[repetition.stamp_ns];
          EXPECT_EQ(repetition.joints.size(), 2u) << "a repetition without its joints";
        }
      }
    }
    std::istringstream lines(session::read_text(said));
    for (std::string line; std::getline(lines, line) && !lines.eof(); ++told) {
      all[std::stoll(line)] = 1;
    }
    for (const auto& [stamp, once] : all) {
      ASSERT_EQ(kept[stamp], once) << "round " << round << ", repetition " << stamp;
    }
  }
  EXPECT_GT(told, 100u) << "the writer was killed before it wrote";
  SQLite::Database raw(file);
  EXPECT_EQ(raw.execAndGet("PRAGMA integrity_check").getString(), "ok");
  EXPECT_FALSE(SQLite::Statement(raw, "PRAGMA foreign_key_check").executeStep());
}

}  // namespace
}  // namespace secondskin::history
