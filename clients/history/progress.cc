#include "clients/history/progress.h"

#include <algorithm>
#include <cmath>

namespace secondskin::history {
namespace {

constexpr std::int64_t kDay = 86'400'000'000'000;
constexpr double kSame = 1e-6;  // of tempo and tolerances

std::optional<ProgressPoint> point_of(const Session& session, const Block& block) {
  if (block.repetitions.empty() || !block.tempo) return std::nullopt;
  ProgressPoint point{.session = session.id,
                      .start_ns = block.repetitions.front().start_ns,
                      .end_ns = block.repetitions.back().end_ns,
                      .block = block.index,
                      .name = block.name,
                      .schedule = block.schedule,
                      .tempo = *block.tempo,
                      .tolerance_scale = block.tolerance_scale,
                      .fingerprint = session.reference.fingerprint,
                      .cued = {},
                      .repetitions = block.repetitions.size(),
                      .mean_total = 0.0,
                      .sd_total = {},
                      .joints = {}};
  const auto n = static_cast<double>(point.repetitions);
  std::map<std::string, std::pair<double, double>> squares;  // sum, count
  double known = 0.0, cued = 0.0;
  for (const Repetition& repetition : block.repetitions) {
    point.mean_total += repetition.total / n;
    known += repetition.cued ? 1.0 : 0.0;
    cued += repetition.cued.value_or(false) ? 1.0 : 0.0;
    for (const JointFigures& joint : repetition.joints) {
      if (!joint.measured) continue;
      auto& [sum, count] = squares[joint.joint];
      sum += joint.rms * joint.rms;
      count += 1.0;
    }
  }
  if (known > 0.0) point.cued = cued / known;
  if (point.repetitions > 1) {
    double squared = 0.0;
    for (const Repetition& repetition : block.repetitions) {
      squared += std::pow(repetition.total - point.mean_total, 2);
    }
    point.sd_total = std::sqrt(squared / (n - 1.0));
  }
  for (const auto& [joint, of] : squares) point.joints[joint] = std::sqrt(of.first / of.second);
  return point;
}

bool alike(const ProgressPoint& a, const ProgressPoint& b) {
  return a.fingerprint == b.fingerprint && std::abs(a.tempo - b.tempo) < kSame &&
         std::abs(a.tolerance_scale - b.tolerance_scale) < kSame;
}

bool uncued(const ProgressPoint& point) { return point.schedule == kNoCues; }

std::int64_t day(const ProgressPoint& point) { return point.start_ns / kDay; }

/// The last of the earlier points that is like this one and of which `holds`.
template <class Condition>
const ProgressPoint* last_before(std::span<const ProgressPoint> earlier, const ProgressPoint& point,
                                 Condition holds) {
  for (std::size_t i = earlier.size(); i-- > 0;) {
    if (alike(earlier[i], point) && holds(earlier[i])) return &earlier[i];
  }
  return nullptr;
}

Retention compare(Retention::Kind kind, const ProgressPoint& practice,
                  const ProgressPoint& retention) {
  return {kind, practice, retention,
          static_cast<double>(retention.start_ns - practice.end_ns) * 1e-9};
}

std::vector<Retention> retention_of(std::span<const ProgressPoint> points) {
  std::vector<Retention> found;
  for (std::size_t i = 0; i < points.size(); ++i) {
    const ProgressPoint& point = points[i];
    if (!uncued(point)) continue;
    const auto earlier = points.first(i);
    const auto* practice = last_before(earlier, point, [&](const ProgressPoint& other) {
      return other.session == point.session && !uncued(other);
    });
    if (practice != nullptr) {
      found.push_back(compare(Retention::Kind::kAfterCues, *practice, point));
    }
    const auto* today = last_before(
        earlier, point, [&](const ProgressPoint& other) { return day(other) == day(point); });
    if (today != nullptr) continue;  // something was done that day: not what the night left
    const auto* newest = last_before(earlier, point, [](const auto&) { return true; });
    if (newest == nullptr) continue;
    found.push_back(compare(Retention::Kind::kAcrossDays, *newest, point));
  }
  return found;
}

std::vector<ScheduleSummary> schedules_of(const Progress& progress) {
  std::vector<ScheduleSummary> all;
  std::vector<const ProgressPoint*> first;
  std::vector<std::int64_t> last_session;
  for (const ProgressPoint& point : progress.points) {
    const auto found = std::find_if(all.begin(), all.end(),
                                    [&](const auto& s) { return s.schedule == point.schedule; });
    const auto i = static_cast<std::size_t>(found - all.begin());
    if (found == all.end()) {
      all.push_back({point.schedule, 0, point.mean_total, 0.0, {}});
      first.push_back(&point);
      last_session.push_back(0);
    }
    if (last_session[i] != point.session) ++all[i].sessions;
    last_session[i] = point.session;
    if (alike(point, *first[i])) all[i].last = point.mean_total;
  }
  for (ScheduleSummary& summary : all) {
    double sum = 0.0, count = 0.0;
    for (const Retention& retention : progress.retention) {
      if (retention.kind != Retention::Kind::kAfterCues ||
          retention.practice.schedule != summary.schedule)
        continue;
      sum += retention.change();
      count += 1.0;
    }
    if (count > 0.0) summary.retention = sum / count;
  }
  return all;
}

}  // namespace

Progress progress(std::span<const Session> course, const std::string& reference) {
  Progress result;
  for (const Session& session : course) {
    if (session.reference.name != reference) continue;
    for (const Block& block : session.blocks) {
      if (auto point = point_of(session, block)) result.points.push_back(std::move(*point));
    }
  }
  result.retention = retention_of(result.points);
  result.schedules = schedules_of(result);
  return result;
}

std::vector<std::string> practised_references(std::span<const Session> course) {
  std::vector<std::string> names;
  for (const Session& session : course) {
    if (session.repetitions > 0) names.push_back(session.reference.name);
  }
  std::sort(names.begin(), names.end());
  names.erase(std::unique(names.begin(), names.end()), names.end());
  return names;
}

}  // namespace secondskin::history
