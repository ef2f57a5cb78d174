#include "clients/history/history_service.h"

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <cmath>
#include <deque>
#include <map>
#include <optional>
#include <string>
#include <variant>

#include "bus/health.h"
#include "bus/reader.h"
#include "bus/wait_set.h"
#include "clients/history/history.h"

namespace secondskin::history {
namespace {

namespace msg = bus::msg;
using namespace std::chrono_literals;

constexpr auto kPeriod = 250ms;
constexpr auto kLastWords = 150ms;  // after a stop the coach's last score is still under way
constexpr std::int64_t kRetry = 1'000'000'000;  // [ns]
constexpr std::size_t kMostWaiting = 20'000;    // some days of repetitions
constexpr std::size_t kDecisions = 64;

std::optional<double> unless_nan(double value) {
  return std::isnan(value) ? std::nullopt : std::optional(value);
}

Repetition from_message(const msg::RepetitionScore& message) {
  Repetition repetition{.number = message.repetition(),
                        .stamp_ns = message.header().stamp_ns(),
                        .start_ns = message.start_ns(),
                        .end_ns = message.end_ns(),
                        .total = message.total(),
                        .cues = message.cues(),
                        .cued = {},
                        .joints = {}};
  for (const msg::JointScore& joint : message.joints()) {
    const bool finite = std::isfinite(joint.rms()) && std::isfinite(joint.peak()) &&
                        std::isfinite(joint.in_band()) && std::isfinite(joint.range()) &&
                        std::isfinite(joint.reference_range());
    repetition.joints.push_back({joint.joint().to_string(), joint.measured() && finite, joint.rms(),
                                 joint.peak(), joint.in_band(), unless_nan(joint.timing_error()),
                                 unless_nan(joint.smoothness()), joint.range(),
                                 joint.reference_range()});
  }
  return repetition;
}

// From when on repetitions are the block's own. The state's stamp is by the clock that stamps
// repetitions, but only the state that begins a block is stamped with the block's beginning; the
// first of a coach comes before any pose and has none.
std::int64_t block_start(const msg::SessionState& message) {
  const std::int64_t stamp = message.header().stamp_ns();
  return message.block_repetitions() == 0 && stamp > 1 ? stamp : message.block_start_ns();
}

Session from_message(const msg::SessionState& message, const std::string& subject) {
  Session session;
  session.learner = message.learner().to_string();
  session.subject = subject;
  session.start_ns = message.session_start_ns();
  if (message.phase() == msg::SESSION_ENDED) {
    session.end_ns = std::max(message.header().stamp_ns(), session.start_ns);
  }
  session.reference.name = message.reference().to_string();
  session.reference.fingerprint = message.reference_fingerprint();
  session.plan = message.plan().to_string();
  session.body_map = message.body_map().to_string();
  session.blocks.push_back({.index = message.block(),
                            .name = message.block_name().to_string(),
                            .start_ns = block_start(message),
                            .tempo = message.block_tempo(),
                            .schedule = message.block_schedule().to_string(),
                            .planned = message.block_planned(),
                            .tolerance_scale = message.tolerance_scale(),
                            .max_cues = message.max_cues(),
                            .repetitions = {}});
  for (const msg::TactorSite& site : message.tactors()) {
    session.exposure.push_back({.channel = site.channel(),
                                .segment = site.segment().to_string(),
                                .dose_before = site.dose(),
                                .dose = site.dose(),
                                .duty = site.duty(),
                                .heat = site.heat()});
  }
  return session;
}

}  // namespace

struct HistoryService::State {
  State(bus::Participant& participant, std::filesystem::path database)
      : subject(participant.config().subject),
        file(std::move(database)),
        states(participant, bus::Want::kEvery),
        repetitions(participant, bus::Want::kEvery),
        skeletons(participant),
        references(participant),
        health(participant, "history") {
    news.attach(states);
    news.attach(repetitions);
    news.attach(skeletons);
    news.attach(references);
  }

  // ---- in

  void take_all() {
    msg::SkeletonDefinition body;
    if (skeletons.take_newest(body) > 0) source = body.source().to_string();
    msg::ReferenceMotionList list;
    if (references.take_newest(list) > 0) {
      known.clear();
      for (const msg::ReferenceMotion& reference : list.references()) {
        known[reference.name().to_string()] = {reference.description().to_string(),
                                               reference.duration()};
      }
    }
    // The states first: a repetition is booked to a block that is known.
    msg::SessionState state;
    while (states.take(state)) {
      heard_state = true;
      if (state.session_start_ns() == 0) continue;  // no session yet
      const std::int64_t stamp = state.header().stamp_ns();
      decided.push_back({stamp > 1 ? stamp : state.session_start_ns(),
                         state.yoked() || state.cued_joints() != 0});
      if (decided.size() > kDecisions) decided.pop_front();
      push(from_message(state, subject));
    }
    // After a restart the repetitions may come first; without the state it is not known whether
    // they are still of the session that is booked.
    if (!heard_state) return;
    msg::RepetitionScore score;
    while (repetitions.take(score)) {
      health.sample(static_cast<double>(bus::now_ns() - score.header().stamp_ns()) * 1e-9);
      Repetition repetition = from_message(score);
      repetition.cued = was_cued(repetition);
      if (std::isfinite(repetition.total)) {
        push(std::move(repetition));
      } else {
        ++counts.unbooked;
      }
    }
  }

  // What the schedule had decided for it: the newest word from before its end. Later words are for
  // later ones.
  std::optional<bool> was_cued(const Repetition& repetition) const {
    const auto word = std::find_if(decided.rbegin(), decided.rend(), [&](const Decision& d) {
      return d.since_ns <= repetition.stamp_ns;
    });
    return word == decided.rend() ? std::nullopt : std::optional(word->cued);
  }

  template <class Entry>
  void push(Entry entry) {
    if (waiting.size() >= kMostWaiting) {
      waiting.pop_front();
      health.lost(1);
    }
    waiting.emplace_back(std::move(entry));
  }

  // ---- out

  void write(std::int64_t now) {
    if (waiting.empty() && history) return;
    if (now < try_again_ns) return;
    try {
      if (!history) history.emplace(file);
      while (!waiting.empty()) {
        std::visit([this](auto& entry) { book(entry); }, waiting.front());
        waiting.pop_front();
      }
      if (!trouble.empty()) spdlog::info("history: {} is written again", file.string());
      trouble.clear();
      health.state(msg::SERVICE_RUNNING, unheard());
    } catch (const std::exception& error) {
      history.reset();  // what it held open may be gone
      const std::string said = error.what();
      const std::string words = said.find(file.string()) == std::string::npos
                                    ? fmt::format("{}: {}", file.string(), said)
                                    : said;
      if (words != trouble) spdlog::error("history: {}", words);
      trouble = words;
      try_again_ns = now + kRetry;
      health.state(msg::SERVICE_FAULT,
                   fmt::format("{}; {} entries wait", trouble, waiting.size()).substr(0, 256));
    }
  }

  std::string unheard() const {
    return counts.unbooked == 0
               ? std::string()
               : fmt::format("{} repetitions are of no session that is booked", counts.unbooked);
  }

  void book(Session& session) {
    session.source = source;
    if (const auto facts = known.find(session.reference.name); facts != known.end()) {
      session.reference.description = facts->second.first;
      session.reference.duration = facts->second.second;
    }
    if (session.start_ns == removed_session) return;
    if (history->book(session, session.start_ns != booked_session)) {
      booked_session = session.start_ns;
    } else {
      removed_session = session.start_ns;
      spdlog::info("history: this session's learner was deleted; the rest of it is not kept");
    }
  }

  void book(const Repetition& repetition) {
    switch (history->book(subject, repetition)) {
      case History::Booked::kNew:
        ++counts.repetitions;
        break;
      case History::Booked::kKnown:
        break;
      case History::Booked::kNoSession:
        ++counts.unbooked;
        break;
    }
  }

  struct Decision {
    std::int64_t since_ns = 0;
    bool cued = false;
  };

  std::string subject;
  std::filesystem::path file;
  bus::Reader<msg::SessionState> states;
  bus::Reader<msg::RepetitionScore> repetitions;
  bus::Reader<msg::SkeletonDefinition> skeletons;
  bus::Reader<msg::ReferenceMotionList> references;
  bus::WaitSet news;
  bus::HealthReporter health;
  std::optional<History> history;  // once the file could be opened
  std::string source;
  std::map<std::string, std::pair<std::string, double>> known;  // description, duration
  bool heard_state = false;
  std::deque<Decision> decided;
  std::deque<std::variant<Session, Repetition>> waiting;
  std::string trouble;
  std::int64_t try_again_ns = 0;
  std::int64_t booked_session = 0, removed_session = 0;  // their starts
  HistoryCounts counts;
};

HistoryService::HistoryService(bus::Participant& participant, std::filesystem::path database)
    : state_(std::make_unique<State>(participant, std::move(database))) {}

HistoryService::~HistoryService() = default;

HistoryCounts HistoryService::run(std::stop_token stop) {
  auto& s = *state_;
  const std::stop_callback wake(stop, [&s] { s.news.wake(); });
  const auto step = [&s] {
    s.take_all();
    s.write(bus::now_ns());
    s.health.tick(bus::now_ns());
  };
  while (!stop.stop_requested()) {
    step();
    s.news.wait(kPeriod);
  }
  const auto end = std::chrono::steady_clock::now() + kLastWords;
  for (auto now = std::chrono::steady_clock::now(); now < end;
       now = std::chrono::steady_clock::now()) {
    s.news.wait(end - now);
    s.take_all();
  }
  s.try_again_ns = 0;
  s.write(bus::now_ns());
  s.counts.waiting = s.waiting.size();
  if (s.trouble.empty()) s.health.state(msg::SERVICE_ENDED);
  return s.counts;
}

}  // namespace secondskin::history
