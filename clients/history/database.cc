#include "clients/history/database.h"

#include <SQLiteCpp/Statement.h>
#include <SQLiteCpp/Transaction.h>
#include <fcntl.h>
#include <fmt/format.h>
#include <sqlite3.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <cstring>
#include <fstream>
#include <stdexcept>
#include <string_view>

namespace secondskin::history {
namespace {

namespace fs = std::filesystem;

constexpr int kApplicationId = 0x53534869;  // "SSHi": in the file's header
constexpr int kBusyMilliseconds = 5000;
constexpr std::string_view kMagic{"SQLite format 3\0", 16};
constexpr const char* kLeft = "it was left as it is; docs/history.md says how to restore a backup";

// Times are ns since the Unix epoch, all else SI. A block's start_ns is the stamp from which on
// repetitions are its own.
constexpr const char* kVersion1 = R"(
CREATE TABLE learners (
  id TEXT PRIMARY KEY,
  note TEXT NOT NULL,
  created_ns INTEGER NOT NULL
) WITHOUT ROWID;
CREATE TABLE plans (
  id INTEGER PRIMARY KEY,
  name TEXT NOT NULL UNIQUE
);
CREATE TABLE reference_motions (
  id INTEGER PRIMARY KEY,
  name TEXT NOT NULL,
  fingerprint INTEGER NOT NULL,
  description TEXT NOT NULL,
  duration REAL NOT NULL,
  UNIQUE (name, fingerprint)
);
CREATE TABLE sessions (
  id INTEGER PRIMARY KEY AUTOINCREMENT,
  learner TEXT NOT NULL REFERENCES learners ON DELETE CASCADE,
  subject TEXT NOT NULL,
  start_ns INTEGER NOT NULL,
  end_ns INTEGER,
  reference INTEGER NOT NULL REFERENCES reference_motions,
  plan INTEGER REFERENCES plans,
  source TEXT NOT NULL,
  body_map TEXT NOT NULL,
  UNIQUE (subject, start_ns)
);
CREATE INDEX sessions_of_learner ON sessions (learner, start_ns);
CREATE TABLE blocks (
  id INTEGER PRIMARY KEY,
  session INTEGER NOT NULL REFERENCES sessions ON DELETE CASCADE,
  number INTEGER NOT NULL,
  name TEXT NOT NULL,
  start_ns INTEGER NOT NULL,
  tempo REAL,
  schedule TEXT NOT NULL,
  planned INTEGER NOT NULL,
  tolerance_scale REAL NOT NULL,
  max_cues INTEGER NOT NULL,
  UNIQUE (session, number)
);
CREATE TABLE repetitions (
  id INTEGER PRIMARY KEY,
  block INTEGER NOT NULL REFERENCES blocks ON DELETE CASCADE,
  number INTEGER NOT NULL,
  stamp_ns INTEGER NOT NULL,
  start_ns INTEGER NOT NULL,
  end_ns INTEGER NOT NULL,
  total REAL NOT NULL,
  cues INTEGER NOT NULL,
  cued INTEGER,
  UNIQUE (block, number)
);
CREATE INDEX repetitions_by_stamp ON repetitions (stamp_ns);
CREATE TABLE joint_scores (
  repetition INTEGER NOT NULL REFERENCES repetitions ON DELETE CASCADE,
  position INTEGER NOT NULL,
  joint TEXT NOT NULL,
  measured INTEGER NOT NULL,
  rms REAL,
  peak REAL,
  in_band REAL,
  timing_error REAL,
  smoothness REAL,
  range REAL,
  reference_range REAL,
  PRIMARY KEY (repetition, position)
) WITHOUT ROWID;
CREATE TABLE exposure (
  session INTEGER NOT NULL REFERENCES sessions ON DELETE CASCADE,
  channel INTEGER NOT NULL,
  segment TEXT NOT NULL,
  dose_before REAL NOT NULL,
  dose REAL NOT NULL,
  duty REAL NOT NULL,
  heat REAL NOT NULL,
  PRIMARY KEY (session, channel)
) WITHOUT ROWID;
)";

constexpr std::array kMigrations{kVersion1};

[[noreturn]] void refuse(const fs::path& file, std::string_view why) {
  throw std::runtime_error(fmt::format("{}: {}", file.string(), why));
}

// SQLite alone would make the file readable for everybody.
void make(const fs::path& file) {
  const fs::path folder = file.parent_path();
  if (!folder.empty() && !fs::exists(folder)) {
    fs::create_directories(folder);
    fs::permissions(folder, fs::perms::owner_all);
  }
  const int fd = ::open(file.c_str(), O_CREAT | O_EXCL | O_WRONLY | O_CLOEXEC, 0600);
  if (fd < 0 && errno != EEXIST) {
    refuse(file, fmt::format("the history cannot be made: {}", std::strerror(errno)));
  }
  if (fd >= 0) ::close(fd);
}

// SQLite takes a short file for an empty one and would write over it.
void check_beginning(const fs::path& file) {
  std::ifstream in(file, std::ios::binary);
  if (!in) refuse(file, fmt::format("the history cannot be read: {}", std::strerror(errno)));
  std::array<char, kMagic.size()> head{};
  in.read(head.data(), head.size());
  const std::string_view got(head.data(), static_cast<std::size_t>(in.gcount()));
  if (!got.empty() && got != kMagic) {
    refuse(file, fmt::format("expected a history, an SQLite database; {}", kLeft));
  }
}

int pragma(SQLite::Database& database, const char* statement) {
  return database.execAndGet(statement).getInt();
}

void check(SQLite::Database& database, const fs::path& file, int newest) {
  const int application = pragma(database, "PRAGMA application_id");
  const int version = pragma(database, "PRAGMA user_version");
  const int tables = pragma(database, "SELECT count(*) FROM sqlite_master");
  if (application == 0 && version == 0 && tables == 0) return;  // new
  if (application != kApplicationId) {
    refuse(file, fmt::format("expected a history of secondskin, found a database of another "
                             "program; {}",
                             kLeft));
  }
  if (version > newest) {
    refuse(file, fmt::format("history of version {}, this program knows up to version {}; take "
                             "the newer program",
                             version, newest));
  }
  const std::string found = database.execAndGet("PRAGMA quick_check(1)").getString();
  if (found != "ok") refuse(file, fmt::format("the history is damaged: {}; {}", found, kLeft));
}

void migrate(SQLite::Database& database, std::span<const char* const> migrations) {
  const auto newest = static_cast<int>(migrations.size());
  if (pragma(database, "PRAGMA user_version") == newest) return;
  SQLite::Transaction transaction(database, SQLite::TransactionBehavior::IMMEDIATE);
  // Another program may have done it meanwhile.
  for (int v = pragma(database, "PRAGMA user_version"); v < newest; ++v) {
    database.exec(migrations[static_cast<std::size_t>(v)]);
  }
  database.exec(
      fmt::format("PRAGMA application_id = {}; PRAGMA user_version = {}", kApplicationId, newest));
  transaction.commit();
}

}  // namespace

std::span<const char* const> migrations() noexcept { return kMigrations; }

SQLite::Database open_database(const fs::path& file, std::span<const char* const> migrations) {
  try {
    make(file);
    check_beginning(file);
    SQLite::Database database(file.string(), SQLite::OPEN_READWRITE, kBusyMilliseconds);
    check(database, file, static_cast<int>(migrations.size()));
    // temp_store: what VACUUM sorts must not lie in a temporary file either.
    database.exec(
        "PRAGMA journal_mode = WAL; PRAGMA synchronous = FULL; PRAGMA foreign_keys = ON;"
        "PRAGMA secure_delete = ON; PRAGMA temp_store = MEMORY");
    migrate(database, migrations);
    return database;
  } catch (const SQLite::Exception& error) {
    const bool torn =
        error.getErrorCode() == SQLITE_CORRUPT || error.getErrorCode() == SQLITE_NOTADB;
    refuse(file, torn ? fmt::format("the history is damaged: {}; {}", error.what(), kLeft)
                      : fmt::format("the history cannot be opened: {}", error.what()));
  } catch (const fs::filesystem_error& error) {
    refuse(file, fmt::format("the history cannot be made: {}", error.code().message()));
  }
}

}  // namespace secondskin::history
