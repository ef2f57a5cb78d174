#include "clients/history/report.h"

#include <fmt/chrono.h>
#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <ctime>
#include <map>
#include <tuple>
#include <vector>

#include "clients/history/history_json.h"
#include "clients/history/plot.h"
#include "clients/history/progress.h"

namespace secondskin::history {
namespace {

constexpr std::size_t kMostConditions = 3;
constexpr std::size_t kMostRetention = 14;  // rows: the newest
constexpr double kHour = 3600.0;

constexpr const char* kStyle = R"(
@page { size: A4; margin: 18mm 16mm 18mm 16mm;
  @bottom-right { content: counter(page) " / " counter(pages); font: 8pt sans-serif; color: #555; }
  @bottom-left { content: string(whose); font: 8pt sans-serif; color: #555; } }
* { box-sizing: border-box; }
body { font: 10pt/1.4 sans-serif; color: #222; max-width: 178mm; margin: 0 auto; }
h1 { font-size: 18pt; margin: 0 0 2mm; string-set: whose attr(data-whose); }
h2 { font-size: 13pt; margin: 7mm 0 2mm; border-bottom: 0.4mm solid #0072b2; padding-bottom: 1mm;
  break-after: avoid; }
h3 { font-size: 10.5pt; margin: 4mm 0 1mm; break-after: avoid; }
p { margin: 1mm 0 2mm; }
.small { font-size: 8.5pt; color: #444; }
table { border-collapse: collapse; width: 100%; font-size: 8.5pt; margin: 1mm 0 2mm; }
th { text-align: left; border-bottom: 0.3mm solid #222; padding: 0.8mm 1.5mm; vertical-align: bottom; }
td { border-bottom: 0.1mm solid #ccc; padding: 0.7mm 1.5mm; vertical-align: top; }
.n { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap; }
thead { display: table-header-group; }
tr, figure { break-inside: avoid; }
figure { margin: 1mm 0 2mm; }
dl { margin: 0; }
dt { font-weight: bold; float: left; clear: left; width: 30mm; }
dd { margin: 0 0 1mm 32mm; }
)";

std::string when(std::int64_t ns, bool with_time) {
  const auto time = fmt::gmtime(static_cast<std::time_t>(ns / 1'000'000'000));
  return with_time ? fmt::format("{:%d %b %Y, %H:%M}", time) : fmt::format("{:%d %b %Y}", time);
}

std::string signed_points(double change) {
  return fmt::format("{}{:.1f}", change < 0.0 ? "−" : "+", std::abs(change));
}

/// "left_knee" as a heading.
std::string titled(const std::string& name) {
  std::string title = spoken(name);
  if (!title.empty() && title[0] >= 'a' && title[0] <= 'z') title[0] -= 'a' - 'A';
  return escaped(title);
}

std::string pause_of(double seconds) {
  if (seconds < 120.0) return fmt::format("{:.0f} s", seconds);
  if (seconds < 2.0 * kHour) return fmt::format("{:.0f} min", seconds / 60.0);
  if (seconds < 48.0 * kHour) return fmt::format("{:.0f} h", seconds / kHour);
  return fmt::format("{:.0f} days", seconds / (24.0 * kHour));
}

/// A table; cells are HTML. A heading that begins with '#' is of a column of numbers.
class Table {
 public:
  explicit Table(std::vector<std::string> headings) {
    html_ = "<table><thead><tr>";
    for (const std::string& heading : headings) {
      numbers_.push_back(heading.starts_with('#'));
      html_ += fmt::format("<th{}>{}</th>", numbers_.back() ? " class=\"n\"" : "",
                           escaped(heading.substr(numbers_.back() ? 1 : 0)));
    }
    html_ += "</tr></thead><tbody>";
  }
  void row(const std::vector<std::string>& cells) {
    html_ += "<tr>";
    for (std::size_t i = 0; i < cells.size(); ++i) {
      html_ += fmt::format("<td{}>{}</td>", numbers_[i] ? " class=\"n\"" : "", cells[i]);
    }
    html_ += "</tr>\n";
  }
  std::string html() const { return html_ + "</tbody></table>\n"; }

 private:
  std::string html_;
  std::vector<bool> numbers_;
};

std::string schedule_words(const std::string& schedule) {
  static const std::map<std::string, std::string> words{{"always", "always cued"},
                                                        {"off", "no cues"},
                                                        {"fading", "fading cues"},
                                                        {"fading_by_joint", "cues fading by joint"},
                                                        {"bandwidth", "cues outside a wider band"},
                                                        {"yoked", "another session’s cues"}};
  const auto found = words.find(schedule);
  return found == words.end() ? escaped(schedule) : found->second;
}

std::string block_words(const ProgressPoint& point) {
  return fmt::format("{}, {}", when(point.start_ns, false),
                     point.name.empty() ? schedule_words(point.schedule) : escaped(point.name));
}

// ---- sections

std::string head(const Learner& learner, std::span<const Session> course, std::int64_t made_ns) {
  std::size_t repetitions = 0;
  double seconds = 0.0;
  for (const Session& session : course) {
    repetitions += session.repetitions;
    if (session.end_ns) seconds += static_cast<double>(*session.end_ns - session.start_ns) * 1e-9;
  }
  std::string html = fmt::format(
      "<h1 data-whose=\"Second Skin, training report, {0}\">Training report</h1>\n<dl>"
      "<dt>Learner</dt><dd>{0}</dd>",
      escaped(learner.id));
  if (!learner.note.empty()) html += fmt::format("<dt>Note</dt><dd>{}</dd>", escaped(learner.note));
  if (!course.empty()) {
    html += fmt::format("<dt>Period</dt><dd>{} to {}</dd>", when(course.front().start_ns, false),
                        when(course.back().start_ns, false));
  }
  html += fmt::format(
      "<dt>Practice</dt><dd>{} sessions, {} repetitions, {:.1f} hours</dd>"
      "<dt>Report made</dt><dd>{} UTC</dd></dl>\n",
      course.size(), repetitions, seconds / kHour, when(made_ns, true));
  if (repetitions == 0) html += "<p>No repetition has been finished yet.</p>\n";
  return html;
}

/// Points that may be compared, the largest groups first.
std::vector<std::vector<ProgressPoint>> conditions(const Progress& progress) {
  std::map<std::tuple<std::uint64_t, double, double>, std::vector<ProgressPoint>> groups;
  for (const ProgressPoint& point : progress.points) {
    groups[{point.fingerprint, point.tempo, point.tolerance_scale}].push_back(point);
  }
  std::vector<std::vector<ProgressPoint>> all;
  for (auto& [condition, points] : groups) all.push_back(std::move(points));
  std::stable_sort(all.begin(), all.end(),
                   [](const auto& a, const auto& b) { return a.size() > b.size(); });
  return all;
}

/// Those with cues and those without.
std::pair<std::vector<ProgressPoint>, std::vector<ProgressPoint>> parted(
    const std::vector<ProgressPoint>& points) {
  std::pair<std::vector<ProgressPoint>, std::vector<ProgressPoint>> parts;
  for (const ProgressPoint& point : points) {
    (point.schedule == kNoCues ? parts.second : parts.first).push_back(point);
  }
  return parts;
}

/// Each reference's first and last block without cues, or with cues where there is none.
std::string glance(std::span<const Session> course, const std::vector<std::string>& references) {
  Table table({"Motion", "#Sessions", "#Repetitions", "Compared", "#First", "#Last", "#Change"});
  for (const std::string& reference : references) {
    std::size_t sessions = 0, repetitions = 0;
    for (const Session& session : course) {
      if (session.reference.name != reference) continue;
      ++sessions;
      repetitions += session.repetitions;
    }
    const auto groups = conditions(progress(course, reference));
    if (groups.empty()) continue;
    const auto [cued, alone] = parted(groups.front());
    const auto& points = alone.size() > 1 ? alone : cued.empty() ? alone : cued;
    const double first = points.front().mean_total, last = points.back().mean_total;
    table.row({titled(reference), fmt::format("{}", sessions), fmt::format("{}", repetitions),
               &points == &alone ? "without cues" : "with cues", fmt::format("{:.1f}", first),
               fmt::format("{:.1f}", last), points.size() > 1 ? signed_points(last - first) : "–"});
  }
  return "<h2>At a glance</h2>\n" + table.html() +
         "<p class=\"small\">Mean score of the first and of the last block, 0 to 100, of what was "
         "practised most.</p>\n";
}

std::string retention_table(const Progress& progress) {
  if (progress.retention.empty()) {
    return "<p>There is no block without cues after practice under the same conditions, so nothing "
           "is known yet of what stays.</p>\n";
  }
  Table table({"Compared", "Earlier block", "Block without cues", "#Pause", "#Earlier",
               "#Without cues", "#Change"});
  const std::size_t left_out =
      progress.retention.size() - std::min(progress.retention.size(), kMostRetention);
  for (const Retention& entry : std::span(progress.retention).subspan(left_out)) {
    table.row({entry.kind == Retention::Kind::kAfterCues ? "in the session" : "across days",
               block_words(entry.practice), block_words(entry.retention), pause_of(entry.pause),
               fmt::format("{:.1f}", entry.practice.mean_total),
               fmt::format("{:.1f}", entry.retention.mean_total), signed_points(entry.change())});
  }
  return table.html() +
         (left_out == 0 ? std::string()
                        : fmt::format("<p class=\"small\">The newest; {} earlier ones are left "
                                      "out.</p>\n",
                                      left_out));
}

std::string schedule_table(const Progress& progress) {
  Table table(
      {"Schedule", "#Sessions", "#First block", "#Last block", "#Change when cues are gone"});
  for (const ScheduleSummary& schedule : progress.schedules) {
    table.row({schedule_words(schedule.schedule), fmt::format("{}", schedule.sessions),
               fmt::format("{:.1f}", schedule.first), fmt::format("{:.1f}", schedule.last),
               schedule.retention ? signed_points(*schedule.retention) : "–"});
  }
  return table.html();
}

std::string condition_plots(const std::vector<ProgressPoint>& points) {
  const ProgressPoint& any = points.front();
  std::string html = fmt::format(
      "<h3>At {:.0f} % of the expert’s tempo, tolerances × {:g} <span class=\"small\">(reference "
      "version {})</span></h3>\n<figure>{}</figure>\n",
      100.0 * any.tempo, any.tolerance_scale, hex(any.fingerprint).substr(0, 8),
      score_plot(points));
  const auto [cued, alone] = parted(points);
  const auto& compared = alone.size() > 1 ? alone : cued;
  if (compared.size() > 1) {
    html +=
        fmt::format("<h3>Error of the joints, first and last block {}</h3>\n<figure>{}</figure>\n",
                    alone.size() > 1 ? "without cues" : "with cues",
                    joint_plot(compared.front(), compared.back()));
  }
  return html;
}

std::string reference_section(std::span<const Session> course, const std::string& reference) {
  std::string html = fmt::format("<h2>{}</h2>\n", titled(reference));
  for (const Session& session : course) {
    if (session.reference.name != reference || session.reference.description.empty()) continue;
    html += fmt::format("<p>{} The expert takes {:.1f} s.</p>\n",
                        escaped(session.reference.description), session.reference.duration);
    break;
  }
  const Progress all = progress(course, reference);
  const auto groups = conditions(all);
  std::size_t drawn = 0;
  for (const auto& points : groups) {
    if (points.size() < 2 || drawn == kMostConditions) break;
    html += condition_plots(points);
    ++drawn;
  }
  if (groups.size() > drawn) {
    html += fmt::format(
        "<p class=\"small\">Practised too little to be drawn: {} further combination(s) of tempo, "
        "tolerances and version.</p>\n",
        groups.size() - drawn);
  }
  html += "<h3>What stays when the cues are gone</h3>\n" + retention_table(all);
  html += "<h3>Schedules</h3>\n" + schedule_table(all);
  return html;
}

std::string session_table(std::span<const Session> course) {
  std::string html = "<h2>Sessions</h2>\n";
  Table table(
      {"Start (UTC)", "#Minutes", "Reference", "Plan", "#Repetitions", "#Mean score", "#Cues"});
  for (const Session& session : course) {
    table.row({when(session.start_ns, true),
               session.end_ns
                   ? fmt::format("{:.0f}", static_cast<double>(*session.end_ns - session.start_ns) *
                                               1e-9 / 60.0)
                   : "–",
               escaped(spoken(session.reference.name)),
               session.plan.empty() ? "practice" : escaped(session.plan),
               fmt::format("{}", session.repetitions),
               session.mean_total ? fmt::format("{:.1f}", *session.mean_total) : "–",
               fmt::format("{}", session.cues)});
  }
  return html + table.html();
}

std::string exposure_table(std::span<const Session> course) {
  const auto newest = std::find_if(course.rbegin(), course.rend(),
                                   [](const Session& s) { return !s.exposure.empty(); });
  if (newest == course.rend()) return {};
  std::string html =
      fmt::format("<h2>Vibration on the skin, session of {}</h2>\n", when(newest->start_ns, true));
  Table table({"Worn on", "#Tactor", "#In the session [s at full drive]",
               "#That day [s at full drive]", "#On, last minute", "#Warmer by"});
  for (const SiteExposure& site : newest->exposure) {
    table.row({escaped(spoken(site.segment)), fmt::format("{}", site.channel),
               fmt::format("{:.1f}", site.dose - site.dose_before),
               fmt::format("{:.1f}", site.dose), fmt::format("{:.0f} %", 100.0 * site.duty),
               fmt::format("{:.1f} K", site.heat)});
  }
  return html + table.html();
}

constexpr const char* kMeaning = R"(<h2>What the numbers mean</h2>
<dl>
<dt>Score</dt><dd>0 to 100, higher is better, for one repetition: how far posture and joints were from the expert’s motion, at the place in the motion where the learner was. Being slower or faster costs nothing. A block’s score is the mean of its repetitions; bars show their standard deviation.</dd>
<dt>Joint error</dt><dd>Root mean square of the angle between the learner’s and the expert’s joint over a repetition, in degrees; of a block, over its repetitions.</dd>
<dt>Tolerance</dt><dd>An error inside a joint’s tolerance costs nothing and is not cued. Each reference brings its own tolerances; “tolerances × 1.5” means that they were made that much wider.</dd>
<dt>Tempo</dt><dd>At 50 % the learner is shown and compared with the same motion at half speed.</dd>
<dt>Without cues</dt><dd>The tactors were silent: what the learner can do alone. <em>Change</em> is that block’s score less the earlier one’s, in points: near zero or above, what was learnt stays; clearly below, the learner leaned on the cues. <em>In the session</em> compares with the last cued block before it, <em>across days</em> the first block of a day with the newest of an earlier day.</dd>
<dt>Schedules</dt><dd>When repetitions were cued. One learner’s figures do not tell which schedule is better: order, fatigue and practice are mixed with it.</dd>
<dt>Vibration</dt><dd>Seconds that the same vibration would have lasted at full strength, squared level; the warming is a model’s, not measured.</dd>
</dl>
<p class="small">Only blocks with the same reference, version, tempo and tolerances are compared. The figures rest on the capture system’s measurement and on one expert motion; they support, and do not replace, an examination.</p>
)";

}  // namespace

std::string report_html(const Learner& learner, std::span<const Session> course,
                        std::int64_t made_ns) {
  std::string html = fmt::format(
      "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\">"
      "<meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; style-src "
      "'unsafe-inline'\"><title>Training report {}</title><style>{}</style></head><body>\n",
      escaped(learner.id), kStyle);
  html += head(learner, course, made_ns);
  const auto references = practised_references(course);
  if (!references.empty()) html += glance(course, references);
  for (const std::string& reference : references) {
    html += reference_section(course, reference);
  }
  if (!course.empty()) html += session_table(course);
  html += exposure_table(course);
  html += kMeaning;
  return html + "</body></html>\n";
}

}  // namespace secondskin::history
