#pragma once

#include <SQLiteCpp/Database.h>

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "clients/history/records.h"

/// The history's database: one SQLite file, in WAL mode so that pages are read while a session is
/// written. docs/history.md has the tables.
///
/// synchronous is FULL: a finished repetition is on the disk before the next one, also when the
/// power fails. A repetition takes seconds, one flush of the disk milliseconds.
namespace secondskin::history {

/// One connection; one thread at a time. Several, also of other processes, may have the same file.
class History {
 public:
  /// Opens the file, makes it (folder 0700, file 0600) or brings it to the present version.
  /// @throws std::runtime_error naming the file: it is no history, is damaged or is of a newer
  /// version. Such a file is left as it is.
  explicit History(const std::filesystem::path& file);

  // ---- learners

  /// With a new random pseudonym.
  Learner add_learner(const std::string& note);
  std::vector<Learner> learners();
  std::optional<Learner> learner(const std::string& id);
  /// @returns false when there is no such learner
  bool note(const std::string& id, const std::string& note);
  /// Removes all that is known of them, also from the file's unused parts and its log.
  /// @returns false when there is no such learner
  /// @throws std::runtime_error when other programs read for so long that traces may remain
  bool forget(const std::string& id);

  // ---- what a session writes; each call is one transaction

  /// Makes learner, plan, reference, session and block, where they are new, and what changed of
  /// them. Its blocks: the one under way, or none; its exposure: as it is now.
  /// @param may_be_new  false: the session was booked before
  /// @returns false when it is not there but was: it was removed with its learner while it ran
  bool book(const Session& now, bool may_be_new);

  enum class Booked { kNew, kKnown, kNoSession };
  /// Adds a repetition to the block that had begun by then in the subject's session of that time.
  /// Where nobody heard one begin, or it has that number already, it gets a block without a name.
  Booked book(const std::string& subject, const Repetition& repetition);

  // ---- what pages and reports read

  /// The newest first, without blocks. @param learner  empty: of all
  std::vector<Session> sessions(const std::string& learner);
  std::optional<Session> session(std::int64_t id);
  /// All of a learner's sessions, whole, the earliest first.
  std::vector<Session> course(const std::string& learner);

  const std::filesystem::path& file() const noexcept { return file_; }

 private:
  std::vector<Session> list(const std::string& condition, const std::string& key);
  void fill(Session& session);
  std::optional<std::int64_t> block_for(const std::string& subject, const Repetition& repetition);

  std::filesystem::path file_;
  SQLite::Database database_;
};

/// 'L-' and six signs that are not mistaken for one another, from the system's random source.
std::string new_pseudonym();

}  // namespace secondskin::history
