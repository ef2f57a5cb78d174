#include "clients/history/history.h"

#include <SQLiteCpp/Statement.h>
#include <SQLiteCpp/Transaction.h>
#include <fmt/format.h>
#include <sys/random.h>

#include <algorithm>
#include <bit>
#include <cerrno>
#include <chrono>
#include <map>
#include <system_error>

#include "clients/history/database.h"

namespace secondskin::history {
namespace {

using SQLite::Statement;

std::int64_t now_ns() {
  return std::chrono::duration_cast<std::chrono::nanoseconds>(
             std::chrono::system_clock::now().time_since_epoch())
      .count();
}

template <class T>
void bind(Statement& statement, int at, const T& value) {
  statement.bind(at, value);
}
template <class T>
void bind(Statement& statement, int at, const std::optional<T>& value) {
  if (value) {
    bind(statement, at, *value);
  } else {
    statement.bind(at);
  }
}

/// A statement with its values, ready to step.
template <class... Values>
Statement prepare(SQLite::Database& database, const std::string& sql, const Values&... values) {
  Statement statement(database, sql);
  [[maybe_unused]] int at = 0;
  (bind(statement, ++at, values), ...);
  return statement;
}

template <class... Values>
int change(SQLite::Database& database, const std::string& sql, const Values&... values) {
  return prepare(database, sql, values...).exec();
}

/// The first column of the first row.
template <class... Values>
std::optional<std::int64_t> find(SQLite::Database& database, const std::string& sql,
                                 const Values&... values) {
  Statement statement = prepare(database, sql, values...);
  if (!statement.executeStep() || statement.isColumnNull(0)) return std::nullopt;
  return statement.getColumn(0).getInt64();
}

template <class T>
std::optional<T> unless_null(const SQLite::Column& column, T value) {
  return column.isNull() ? std::nullopt : std::optional<T>(value);
}

SQLite::Transaction begin(SQLite::Database& database) {
  return SQLite::Transaction(database, SQLite::TransactionBehavior::IMMEDIATE);
}

std::uint32_t whole(const SQLite::Column& column) { return column.getUInt(); }

}  // namespace

std::string new_pseudonym() {
  // Without 0 O, 1 I, 2 Z, 5 S, 8 B and U V: they are read wrongly from paper.
  constexpr std::string_view kSigns = "34679ACDEFGHJKLMNPQRTWXY";
  constexpr std::size_t kLength = 6;
  constexpr unsigned kFair = 256 / kSigns.size() * kSigns.size();
  std::string id = "L-";
  while (id.size() < 2 + kLength) {
    unsigned char byte = 0;
    if (::getrandom(&byte, 1, 0) != 1) {
      throw std::system_error(errno, std::generic_category(), "the system's random source");
    }
    if (byte < kFair) id += kSigns[byte % kSigns.size()];
  }
  return id;
}

History::History(const std::filesystem::path& file)
    : file_(file), database_(open_database(file, migrations())) {}

// ---- learners

Learner History::add_learner(const std::string& note) {
  Learner learner{.id = {}, .note = note, .created_ns = now_ns(), .last_session_ns = {}};
  do {
    learner.id = new_pseudonym();
  } while (change(database_, "INSERT OR IGNORE INTO learners VALUES (?, ?, ?)", learner.id, note,
                  learner.created_ns) == 0);
  return learner;
}

std::vector<Learner> History::learners() {
  Statement rows(database_,
                 "SELECT l.id, l.note, l.created_ns, count(s.id), max(s.start_ns) FROM learners l "
                 "LEFT JOIN sessions s ON s.learner = l.id GROUP BY l.id ORDER BY l.created_ns");
  std::vector<Learner> all;
  while (rows.executeStep()) {
    all.push_back(
        {.id = rows.getColumn(0),
         .note = rows.getColumn(1),
         .created_ns = rows.getColumn(2),
         .sessions = rows.getColumn(3).getUInt(),
         .last_session_ns = unless_null(rows.getColumn(4), rows.getColumn(4).getInt64())});
  }
  return all;
}

std::optional<Learner> History::learner(const std::string& id) {
  for (const Learner& learner : learners()) {
    if (learner.id == id) return learner;
  }
  return std::nullopt;
}

bool History::note(const std::string& id, const std::string& note) {
  return change(database_, "UPDATE learners SET note = ? WHERE id = ?", note, id) > 0;
}

bool History::forget(const std::string& id) {
  auto transaction = begin(database_);
  if (change(database_, "DELETE FROM learners WHERE id = ?", id) == 0) return false;
  // Plans and references that nobody else used may tell of them, too.
  database_.exec(
      "DELETE FROM plans WHERE id NOT IN (SELECT plan FROM sessions WHERE plan IS NOT NULL);"
      "DELETE FROM reference_motions WHERE id NOT IN (SELECT reference FROM sessions)");
  transaction.commit();
  // secure_delete wipes rows, not the copies that the balancing of pages left in their gaps; the
  // log holds old pages until it is cut.
  database_.exec("VACUUM");
  Statement checkpoint(database_, "PRAGMA wal_checkpoint(TRUNCATE)");
  checkpoint.executeStep();
  if (checkpoint.getColumn(0).getInt() != 0) {
    throw std::runtime_error(fmt::format(
        "{}: learner {} is removed, but another program uses the file; traces stay in {}-wal until "
        "it ends",
        file_.string(), id, file_.filename().string()));
  }
  return true;
}

// ---- writing

bool History::book(const Session& now, bool may_be_new) {
  auto transaction = begin(database_);
  auto id = find(database_, "SELECT id FROM sessions WHERE subject = ? AND start_ns = ?",
                 now.subject, now.start_ns);
  if (!id && !may_be_new) return false;
  const std::string& learner = now.learner.empty() ? kUnassigned : now.learner;
  change(database_, "INSERT OR IGNORE INTO learners VALUES (?, '', ?)", learner, now_ns());
  const auto fingerprint = std::bit_cast<std::int64_t>(now.reference.fingerprint);
  change(database_,
         "INSERT INTO reference_motions (name, fingerprint, description, duration) "
         "VALUES (?, ?, ?, ?) ON CONFLICT DO UPDATE SET description = excluded.description, "
         "duration = excluded.duration WHERE excluded.duration > 0",
         now.reference.name, fingerprint, now.reference.description, now.reference.duration);
  const auto reference =
      find(database_, "SELECT id FROM reference_motions WHERE name = ? AND fingerprint = ?",
           now.reference.name, fingerprint);
  std::optional<std::int64_t> plan;
  if (!now.plan.empty()) {
    change(database_, "INSERT OR IGNORE INTO plans (name) VALUES (?)", now.plan);
    plan = find(database_, "SELECT id FROM plans WHERE name = ?", now.plan);
  }
  if (!id) {
    // One that never said that it ended has ended when the next one begins.
    change(database_,
           "UPDATE sessions SET end_ns = coalesce((SELECT max(r.end_ns) FROM repetitions r JOIN "
           "blocks b ON r.block = b.id WHERE b.session = sessions.id), start_ns) "
           "WHERE subject = ? AND end_ns IS NULL AND start_ns < ?",
           now.subject, now.start_ns);
    change(database_,
           "INSERT INTO sessions (learner, subject, start_ns, reference, plan, source, body_map) "
           "VALUES (?, ?, ?, ?, ?, ?, ?)",
           learner, now.subject, now.start_ns, *reference, plan, now.source, now.body_map);
    id = database_.getLastInsertRowid();
  }
  change(database_,
         "UPDATE sessions SET learner = ?1, end_ns = ?2, reference = ?3, plan = ?4, "
         "source = CASE ?5 WHEN '' THEN source ELSE ?5 END WHERE id = ?6",
         learner, now.end_ns, *reference, plan, now.source, *id);
  for (const Block& block : now.blocks) {
    change(database_,
           "INSERT INTO blocks (session, number, name, start_ns, tempo, schedule, planned, "
           "tolerance_scale, max_cues) VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?) ON CONFLICT DO UPDATE "
           "SET name = excluded.name, tempo = excluded.tempo, schedule = excluded.schedule, "
           "planned = excluded.planned, tolerance_scale = excluded.tolerance_scale, "
           "max_cues = excluded.max_cues",
           *id, block.index, block.name, block.start_ns, block.tempo, block.schedule, block.planned,
           block.tolerance_scale, block.max_cues);
  }
  for (const SiteExposure& site : now.exposure) {
    change(database_,
           "INSERT INTO exposure VALUES (?, ?, ?, ?, ?, ?, ?) ON CONFLICT DO UPDATE SET "
           "dose = excluded.dose, duty = excluded.duty, heat = excluded.heat",
           *id, site.channel, site.segment, site.dose_before, site.dose, site.duty, site.heat);
  }
  transaction.commit();
  return true;
}

std::optional<std::int64_t> History::block_for(const std::string& subject,
                                               const Repetition& repetition) {
  const std::int64_t stamp = repetition.stamp_ns;
  const auto session = find(database_,
                            "SELECT id FROM sessions WHERE subject = ?1 AND start_ns <= ?2 AND "
                            "(end_ns IS NULL OR ?2 <= end_ns) ORDER BY start_ns DESC LIMIT 1",
                            subject, stamp);
  if (!session) return std::nullopt;
  const auto begun =
      find(database_, "SELECT max(number) FROM blocks WHERE session = ? AND start_ns <= ?",
           *session, stamp);
  // Each block counts its repetitions from 1: a number that is there already is another block's.
  for (const std::int64_t number : {begun.value_or(0), begun.value_or(-1) + 1}) {
    const auto block =
        find(database_, "SELECT id FROM blocks WHERE session = ? AND number = ?", *session, number);
    if (!block) {
      change(database_,
             "INSERT INTO blocks (session, number, name, start_ns, schedule, planned, "
             "tolerance_scale, max_cues) VALUES (?, ?, '', ?, '', 0, 1, 0)",
             *session, number, repetition.start_ns);
      return database_.getLastInsertRowid();
    }
    if (!find(database_, "SELECT id FROM repetitions WHERE block = ? AND number = ?", *block,
              repetition.number)) {
      return block;
    }
  }
  return std::nullopt;
}

History::Booked History::book(const std::string& subject, const Repetition& repetition) {
  auto transaction = begin(database_);
  if (find(database_,
           "SELECT r.id FROM repetitions r JOIN blocks b ON r.block = b.id JOIN sessions s ON "
           "b.session = s.id WHERE r.stamp_ns = ? AND r.start_ns = ? AND s.subject = ?",
           repetition.stamp_ns, repetition.start_ns, subject)) {
    return Booked::kKnown;
  }
  const auto block = block_for(subject, repetition);
  if (!block) return Booked::kNoSession;
  change(database_,
         "INSERT INTO repetitions (block, number, stamp_ns, start_ns, end_ns, total, cues, cued) "
         "VALUES (?, ?, ?, ?, ?, ?, ?, ?)",
         *block, repetition.number, repetition.stamp_ns, repetition.start_ns, repetition.end_ns,
         repetition.total, repetition.cues, repetition.cued);
  const std::int64_t id = database_.getLastInsertRowid();
  std::uint32_t position = 0;
  for (const JointFigures& joint : repetition.joints) {
    const auto figure = [&](double value) {
      return joint.measured ? std::optional(value) : std::nullopt;
    };
    change(database_, "INSERT INTO joint_scores VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)", id,
           position++, joint.joint, joint.measured, figure(joint.rms), figure(joint.peak),
           figure(joint.in_band), joint.timing_error, joint.smoothness, figure(joint.range),
           figure(joint.reference_range));
  }
  transaction.commit();
  return Booked::kNew;
}

// ---- reading

std::vector<Session> History::list(const std::string& condition, const std::string& key) {
  Statement rows(
      database_,
      fmt::format("SELECT s.id, s.learner, s.subject, s.start_ns, s.end_ns, m.name, "
                  "m.fingerprint, m.description, m.duration, coalesce(p.name, ''), s.source, "
                  "s.body_map, count(r.id), avg(r.total), coalesce(sum(r.cues), 0) FROM sessions s "
                  "JOIN reference_motions m ON s.reference = m.id LEFT JOIN plans p ON s.plan = "
                  "p.id LEFT JOIN blocks b ON b.session = s.id LEFT JOIN repetitions r ON r.block "
                  "= b.id WHERE {} GROUP BY s.id ORDER BY s.start_ns DESC",
                  condition));
  if (rows.getBindParameterCount() > 0) rows.bind(1, key);
  std::vector<Session> all;
  while (rows.executeStep()) {
    const auto at = [&](int column) { return rows.getColumn(column); };
    Session session;
    session.id = at(0);
    session.learner = at(1).getString();
    session.subject = at(2).getString();
    session.start_ns = at(3);
    session.end_ns = unless_null(at(4), at(4).getInt64());
    session.reference = {at(5).getString(), std::bit_cast<std::uint64_t>(at(6).getInt64()),
                         at(7).getString(), at(8).getDouble()};
    session.plan = at(9).getString();
    session.source = at(10).getString();
    session.body_map = at(11).getString();
    session.repetitions = whole(at(12));
    session.mean_total = unless_null(at(13), at(13).getDouble());
    session.cues = static_cast<std::uint64_t>(at(14).getInt64());
    all.push_back(std::move(session));
  }
  return all;
}

void History::fill(Session& session) {
  std::map<std::int64_t, std::size_t> block_at;
  Statement blocks = prepare(
      database_,
      "SELECT id, number, name, start_ns, tempo, schedule, planned, tolerance_scale, max_cues "
      "FROM blocks WHERE session = ? ORDER BY number",
      session.id);
  while (blocks.executeStep()) {
    const auto at = [&](int column) { return blocks.getColumn(column); };
    block_at[at(0)] = session.blocks.size();
    session.blocks.push_back({whole(at(1)),
                              at(2).getString(),
                              at(3).getInt64(),
                              unless_null(at(4), at(4).getDouble()),
                              at(5).getString(),
                              whole(at(6)),
                              at(7).getDouble(),
                              whole(at(8)),
                              {}});
  }
  Statement rows = prepare(
      database_,
      "SELECT r.id, r.block, r.number, r.stamp_ns, r.start_ns, r.end_ns, r.total, r.cues, r.cued, "
      "j.joint, j.measured, j.rms, j.peak, j.in_band, j.timing_error, j.smoothness, j.range, "
      "j.reference_range FROM blocks b JOIN repetitions r ON r.block = b.id LEFT JOIN joint_scores "
      "j ON j.repetition = r.id WHERE b.session = ? ORDER BY b.number, r.number, j.position",
      session.id);
  std::int64_t last = 0;
  while (rows.executeStep()) {
    const auto at = [&](int column) { return rows.getColumn(column); };
    auto& repetitions = session.blocks[block_at.at(at(1))].repetitions;
    if (at(0).getInt64() != last) {
      last = at(0);
      repetitions.push_back({whole(at(2)),
                             at(3).getInt64(),
                             at(4).getInt64(),
                             at(5).getInt64(),
                             at(6).getDouble(),
                             whole(at(7)),
                             unless_null(at(8), at(8).getInt() != 0),
                             {}});
    }
    if (at(9).isNull()) continue;
    repetitions.back().joints.push_back(
        {at(9).getString(), at(10).getInt() != 0, at(11).getDouble(), at(12).getDouble(),
         at(13).getDouble(), unless_null(at(14), at(14).getDouble()),
         unless_null(at(15), at(15).getDouble()), at(16).getDouble(), at(17).getDouble()});
  }
  Statement sites = prepare(
      database_,
      "SELECT channel, segment, dose_before, dose, duty, heat FROM exposure WHERE session = ? "
      "ORDER BY channel",
      session.id);
  while (sites.executeStep()) {
    const auto at = [&](int column) { return sites.getColumn(column); };
    session.exposure.push_back({whole(at(0)), at(1).getString(), at(2).getDouble(),
                                at(3).getDouble(), at(4).getDouble(), at(5).getDouble()});
  }
}

std::vector<Session> History::sessions(const std::string& learner) {
  return learner.empty() ? list("1", {}) : list("s.learner = ?", learner);
}

std::optional<Session> History::session(std::int64_t id) {
  SQLite::Transaction one_view(database_);
  auto found = list(fmt::format("s.id = {}", id), {});
  if (found.empty()) return std::nullopt;
  fill(found.front());
  return std::move(found.front());
}

std::vector<Session> History::course(const std::string& learner) {
  SQLite::Transaction one_view(database_);
  auto all = list("s.learner = ?", learner);
  std::reverse(all.begin(), all.end());
  for (Session& session : all) fill(session);
  return all;
}

}  // namespace secondskin::history
