#include "clients/history/history.h"

#include <SQLiteCpp/SQLiteCpp.h>
#include <gtest/gtest.h>
#include <sys/stat.h>

#include <fstream>
#include <set>
#include <sstream>

#include "clients/history/database.h"
#include "course.h"
#include "tests/session/process.h"

namespace secondskin::history {
namespace {

using session::Folder;
using session::read_text;

std::string bytes_of_all(const std::string& database) {
  return read_text(database) + read_text(database + "-wal") + read_text(database + "-shm");
}

void store(History& history, const Session& session) {
  Session part = session;
  for (const Block& block : session.blocks) {
    part.blocks = {block};
    part.end_ns.reset();
    ASSERT_TRUE(history.book(part, true));
    for (const Repetition& repetition : block.repetitions) {
      ASSERT_EQ(history.book(session.subject, repetition), History::Booked::kNew);
    }
  }
  part.end_ns = session.end_ns;
  ASSERT_TRUE(history.book(part, false));
}

Session two_blocks() {
  return session_of(0, kMorning,
                    {block_of(0, "always", kMorning, {40, 50, 60}),
                     block_of(1, "off", kMorning + 300 * kSecond, {44, 48})});
}

std::string failure(const std::string& file) {
  try {
    History history(file);
  } catch (const std::exception& error) {
    return error.what();
  }
  return "no failure";
}

TEST(History, GivesBackWhatWasBooked) {
  const Folder folder;
  const Session told = two_blocks();
  {
    History history(folder / "h.db");
    store(history, told);
  }
  History history(folder / "h.db");
  const auto listed = history.sessions("L-TEST34");
  ASSERT_EQ(listed.size(), 1u);
  EXPECT_EQ(listed[0].repetitions, 5u);
  EXPECT_DOUBLE_EQ(listed[0].mean_total.value(), 48.4);
  EXPECT_EQ(listed[0].cues, 21u);
  EXPECT_TRUE(listed[0].blocks.empty());
  const auto kept = history.session(listed[0].id);
  ASSERT_TRUE(kept);
  EXPECT_EQ(kept->start_ns, told.start_ns);
  EXPECT_EQ(kept->end_ns, told.end_ns);
  EXPECT_EQ(kept->reference.name, "squat");
  EXPECT_EQ(kept->reference.fingerprint, 7u);
  EXPECT_EQ(kept->reference.description, told.reference.description);
  EXPECT_EQ(kept->plan, "retention");
  EXPECT_EQ(kept->source, told.source);
  ASSERT_EQ(kept->blocks.size(), 2u);
  EXPECT_EQ(kept->blocks[1].schedule, "off");
  EXPECT_EQ(kept->blocks[1].start_ns, told.blocks[1].start_ns);
  const Repetition& repetition = kept->blocks[0].repetitions.at(2);
  EXPECT_EQ(repetition.number, 3u);
  EXPECT_EQ(repetition.end_ns, told.blocks[0].repetitions[2].end_ns);
  EXPECT_EQ(repetition.cued, true);
  ASSERT_EQ(repetition.joints.size(), 2u);
  EXPECT_EQ(repetition.joints[0].joint, "left_knee");
  EXPECT_DOUBLE_EQ(repetition.joints[0].rms, 0.3 / 3);
  EXPECT_DOUBLE_EQ(repetition.joints[0].timing_error.value(), 0.02);
  EXPECT_FALSE(repetition.joints[1].measured);
  EXPECT_FALSE(repetition.joints[1].smoothness);
  ASSERT_EQ(kept->exposure.size(), 1u);
  EXPECT_DOUBLE_EQ(kept->exposure[0].dose, 12.5);
}

TEST(History, ARepetitionIsKeptOnce) {
  const Folder folder;
  History history(folder / "h.db");
  const Session told = two_blocks();
  store(history, told);
  for (const Block& block : told.blocks) {
    for (const Repetition& repetition : block.repetitions) {
      EXPECT_EQ(history.book("learner", repetition), History::Booked::kKnown);
    }
  }
  EXPECT_EQ(history.sessions("")[0].repetitions, 5u);
}

TEST(History, BooksByTimeToTheBlockThatHadBegun) {
  const Folder folder;
  History history(folder / "h.db");
  Session told = two_blocks();
  auto repetitions = told.blocks[0].repetitions;
  told.end_ns.reset();
  told.blocks[0].repetitions.clear();
  told.blocks[1].repetitions.clear();
  ASSERT_TRUE(history.book(told, true));
  // The second block is known already when the first one's repetitions arrive.
  for (const auto& repetition : repetitions) {
    EXPECT_EQ(history.book("learner", repetition), History::Booked::kNew);
  }
  EXPECT_EQ(history.book("somebody_else", repetitions[0]), History::Booked::kNoSession);
  repetitions[0].stamp_ns = repetitions[0].start_ns = kMorning - kHour;
  EXPECT_EQ(history.book("learner", repetitions[0]), History::Booked::kNoSession);
  const auto kept = history.session(1);
  EXPECT_EQ(kept->blocks[0].repetitions.size(), 3u);
  EXPECT_EQ(kept->blocks[1].repetitions.size(), 0u);
}

TEST(History, ABlockThatNobodyHeardBeginIsMadeForItsRepetitions) {
  const Folder folder;
  History history(folder / "h.db");
  const std::int64_t unheard = kMorning + 300 * kSecond, last = kMorning + 600 * kSecond;
  Session told = two_blocks();
  told.end_ns.reset();
  told.blocks = {told.blocks[0], block_of(2, "off", last, {70})};
  ASSERT_TRUE(history.book(told, true));
  auto all = told.blocks[0].repetitions;
  for (const Block& block : {block_of(1, "", unheard, {61, 62}), told.blocks[1]}) {
    all.insert(all.end(), block.repetitions.begin(), block.repetitions.end());
  }
  for (const auto& repetition : all) {
    EXPECT_EQ(history.book("learner", repetition), History::Booked::kNew);
  }
  const auto blocks = history.session(1)->blocks;
  ASSERT_EQ(blocks.size(), 3u);
  EXPECT_EQ(blocks[0].repetitions.size(), 3u);
  EXPECT_EQ(blocks[1].repetitions.size(), 2u);
  EXPECT_FALSE(blocks[1].tempo) << "unknown";
  EXPECT_EQ(blocks[2].repetitions.size(), 1u);
}

TEST(History, ASessionThatNeverSaidItsEndEndsWithItsLastRepetition) {
  const Folder folder;
  History history(folder / "h.db");
  Session first = two_blocks(), second = session_of(0, kMorning + kDay, {});
  first.end_ns.reset();
  ASSERT_TRUE(history.book(first, true));
  ASSERT_EQ(history.book("learner", first.blocks[0].repetitions[0]), History::Booked::kNew);
  ASSERT_TRUE(history.book(second, true));
  EXPECT_EQ(history.session(1)->end_ns, first.blocks[0].repetitions[0].end_ns);
}

TEST(History, IsForItsOwnerOnly) {
  const Folder folder;
  History history(folder / "new_folder/h.db");
  history.add_learner("somebody");
  const auto mode = [&](const std::string& name) {
    struct stat facts {};
    EXPECT_EQ(::stat((folder / name).c_str(), &facts), 0) << name;
    return facts.st_mode & 0777u;
  };
  EXPECT_EQ(mode("new_folder"), 0700u);
  EXPECT_EQ(mode("new_folder/h.db"), 0600u);
  EXPECT_EQ(mode("new_folder/h.db-wal"), 0600u);
}

TEST(History, PseudonymsAreRandomAndReadable) {
  std::set<std::string> seen;
  for (int i = 0; i < 2000; ++i) {
    const std::string id = new_pseudonym();
    EXPECT_EQ(id.size(), 8u) << id;
    EXPECT_TRUE(id.starts_with("L-")) << id;
    EXPECT_EQ(id.find_first_not_of("34679ACDEFGHJKLMNPQRTWXY", 2), std::string::npos) << id;
    seen.insert(id);
  }
  // Of 24^6 there should be a hundredth of a pair of equals.
  EXPECT_GT(seen.size(), 1998u);
}

TEST(History, ForgettingALearnerLeavesNothingOfThemInTheFiles) {
  const Folder folder;
  const std::string file = folder / "h.db";
  History history(file);
  const Learner gone = history.add_learner("Marie Musterfrau wants to jump again");
  const Learner stays = history.add_learner("the other one");
  // Enough of both, interleaved, that pages are split and balanced.
  for (int day = 0; day < 40; ++day) {
    for (const Learner* learner : {&gone, &stays}) {
      const std::int64_t start = kMorning + day * kDay + (learner == &gone ? 0 : 4 * kHour);
      Session session = session_of(0, start, {block_of(0, "always", start, {40, 50, 60, 70})});
      session.learner = learner->id;
      session.plan = learner == &gone ? "Maries_plan" : "common_plan";
      session.source = learner == &gone ? "replay:marie.bvh" : "replay:other.bvh";
      for (auto& block : session.blocks) block.name = session.plan;
      store(history, session);
    }
  }
  const std::vector<std::string> words{gone.id, "Musterfrau", "Maries_plan", "marie.bvh"};
  for (const auto& word : words) {
    ASSERT_NE(bytes_of_all(file).find(word), std::string::npos) << "the test looks in vain";
  }
  History reader(file);  // as a page that is open meanwhile
  reader.sessions("");
  ASSERT_TRUE(history.forget(gone.id));
  const std::string bytes = bytes_of_all(file);
  for (const auto& word : words) EXPECT_EQ(bytes.find(word), std::string::npos) << word;
  EXPECT_NE(bytes.find(stays.id), std::string::npos);
  EXPECT_EQ(history.sessions("").size(), 40u);
  EXPECT_EQ(reader.course(stays.id).at(39).blocks.at(0).repetitions.size(), 4u);
  EXPECT_FALSE(history.forget(gone.id));
  SQLite::Database raw(file);
  EXPECT_EQ(raw.execAndGet("SELECT count(*) FROM joint_scores").getInt(), 40 * 4 * 2);
  EXPECT_EQ(raw.execAndGet("SELECT count(*) FROM exposure").getInt(), 40);
}

TEST(History, ASessionWhoseLearnerWasForgottenDoesNotComeBack) {
  const Folder folder;
  History history(folder / "h.db");
  Session told = two_blocks();
  told.end_ns.reset();
  ASSERT_TRUE(history.book(told, true));
  ASSERT_TRUE(History(folder / "h.db").forget("L-TEST34"));
  EXPECT_FALSE(history.book(told, false));
  EXPECT_EQ(history.book("learner", told.blocks[0].repetitions[0]), History::Booked::kNoSession);
  EXPECT_TRUE(history.learners().empty());
}

TEST(HistoryFile, OfAnotherKindIsRefusedAndLeftAsItIs) {
  const Folder folder;
  std::ofstream(folder / "text.db") << "Dear diary, this is no database at all.";
  std::ofstream(folder / "short.db") << "SQL";
  {
    SQLite::Database other(folder / "other.db", SQLite::OPEN_READWRITE | SQLite::OPEN_CREATE);
    other.exec("CREATE TABLE recipes (name TEXT)");
  }
  for (const char* name : {"text.db", "short.db", "other.db"}) {
    const std::string before = read_text(folder / name), words = failure(folder / name);
    EXPECT_NE(words.find(name), std::string::npos) << words;
    EXPECT_NE(words.find("expected a history"), std::string::npos) << words;
    EXPECT_EQ(read_text(folder / name), before) << name;
  }
}

TEST(HistoryFile, TornIsRefusedAndLeftAsItIs) {
  const Folder folder;
  const std::string file = folder / "h.db";
  {
    History history(file);
    for (int day = 0; day < 20; ++day) {
      store(history, session_of(0, kMorning + day * kDay,
                                {block_of(0, "always", kMorning + day * kDay, {40, 50})}));
    }
  }
  const std::string whole = read_text(file);
  ASSERT_GT(whole.size(), 20'000u);
  const auto refused = [&](const std::string& bytes, const char* how) {
    std::ofstream(file, std::ios::binary) << bytes;
    const std::string words = failure(file);
    EXPECT_NE(words.find(file), std::string::npos) << how << ": " << words;
    EXPECT_NE(words.find("damaged"), std::string::npos) << how << ": " << words;
    EXPECT_EQ(read_text(file), bytes) << how;
  };
  refused(whole.substr(0, whole.size() / 2), "cut");
  std::string smeared = whole;
  for (std::size_t i = 8192; i < 16384; ++i) smeared[i] = static_cast<char>(i * 37);
  refused(smeared, "smeared");
  std::ofstream(file, std::ios::binary) << whole;
  EXPECT_EQ(History(file).sessions("").size(), 20u);
}

TEST(HistoryFile, OfANewerVersionIsRefusedByNameAndVersion) {
  const Folder folder;
  { History history(folder / "h.db"); }
  SQLite::Database(folder / "h.db", SQLite::OPEN_READWRITE).exec("PRAGMA user_version = 99");
  const std::string words = failure(folder / "h.db");
  EXPECT_NE(words.find("h.db"), std::string::npos) << words;
  EXPECT_NE(words.find("version 99"), std::string::npos) << words;
}

TEST(HistoryFile, IsBroughtToTheNextVersionAsAWholeOrNotAtAll) {
  const Folder folder;
  const std::string file = folder / "h.db";
  {
    History history(file);
    store(history, two_blocks());
  }
  std::vector<const char*> steps(migrations().begin(), migrations().end());
  const int now = static_cast<int>(steps.size());
  steps.push_back("ALTER TABLE learners ADD COLUMN handed TEXT NOT NULL DEFAULT ''");
  steps.push_back("CREATE TABLE more (a); INSERT INTO nowhere VALUES (1)");
  EXPECT_ANY_THROW(open_database(file, steps));
  {
    SQLite::Database raw(file);
    EXPECT_EQ(raw.execAndGet("PRAGMA user_version").getInt(), now) << "nothing of it was done";
    EXPECT_FALSE(raw.tableExists("more"));
    EXPECT_ANY_THROW(raw.execAndGet("SELECT handed FROM learners"));
  }
  steps.pop_back();
  auto opened = open_database(file, steps);
  EXPECT_EQ(opened.execAndGet("PRAGMA user_version").getInt(), now + 1);
  EXPECT_EQ(opened.execAndGet("SELECT count(*) FROM repetitions").getInt(), 5);
  EXPECT_EQ(opened.execAndGet("SELECT handed FROM learners").getString(), "");
  EXPECT_EQ(opened.execAndGet("PRAGMA journal_mode").getString(), "wal");
  EXPECT_EQ(opened.execAndGet("PRAGMA foreign_keys").getInt(), 1);
  EXPECT_EQ(opened.execAndGet("PRAGMA synchronous").getInt(), 2);
}

TEST(HistoryFile, InAFolderThatCannotBeIsAnErrorWithItsName) {
  const Folder folder;
  std::ofstream(folder / "file") << "no folder";
  EXPECT_NE(failure(folder / "file/h.db").find("file/h.db"), std::string::npos);
}

}  // namespace
}  // namespace secondskin::history
