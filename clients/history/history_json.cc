#include "clients/history/history_json.h"

#include <fmt/format.h>

#include <nlohmann/json.hpp>
#include <numbers>

#include "clients/dashboard/json_answer.h"

namespace secondskin::history {
namespace {

using nlohmann::json;

double deg(double radians) { return radians * 180.0 / std::numbers::pi; }

template <class T>
json or_null(const std::optional<T>& value) {
  return value ? json(*value) : json();
}

json time_or_null(const std::optional<std::int64_t>& ns) {
  return ns ? json(iso_time(*ns)) : json();
}

json to_json(const JointFigures& joint) {
  const auto figure = [&](double value) { return joint.measured ? json(value) : json(); };
  return {{"name", joint.joint},
          {"measured", joint.measured},
          {"rms_deg", figure(deg(joint.rms))},
          {"peak_deg", figure(deg(joint.peak))},
          {"in_band", figure(joint.in_band)},
          {"timing_error", or_null(joint.timing_error)},
          {"smoothness", or_null(joint.smoothness)},
          {"range_deg", figure(deg(joint.range))},
          {"reference_range_deg", figure(deg(joint.reference_range))}};
}

json to_json(const Repetition& repetition) {
  json joints = json::array();
  for (const JointFigures& joint : repetition.joints) joints.push_back(to_json(joint));
  return {{"number", repetition.number},
          {"start", iso_time(repetition.start_ns)},
          {"end", iso_time(repetition.end_ns)},
          {"total", repetition.total},
          {"cues", repetition.cues},
          {"cued", or_null(repetition.cued)},
          {"joints", std::move(joints)}};
}

json to_json(const Block& block) {
  json repetitions = json::array();
  for (const Repetition& repetition : block.repetitions) repetitions.push_back(to_json(repetition));
  return {{"index", block.index},          {"name", block.name},
          {"tempo", or_null(block.tempo)}, {"schedule", block.schedule},
          {"planned", block.planned},      {"tolerance_scale", block.tolerance_scale},
          {"max_cues", block.max_cues},    {"repetitions", std::move(repetitions)}};
}

json summary(const ProgressPoint& point) {
  return {{"session", point.session},
          {"start", iso_time(point.start_ns)},
          {"block", point.block},
          {"name", point.name},
          {"schedule", point.schedule},
          {"mean_total", point.mean_total},
          {"repetitions", point.repetitions}};
}

// RFC 4180.
std::string quoted(const std::string& text) {
  if (text.find_first_of(",\"\r\n") == std::string::npos) return text;
  std::string result = "\"";
  for (const char c : text) result += c == '"' ? "\"\"" : std::string(1, c);
  return result + '"';
}

template <class T>
std::string cell(const std::optional<T>& value) {
  return value ? fmt::format("{}", *value) : std::string();
}

}  // namespace

std::string iso_time(std::int64_t ns) { return dashboard::iso_time(ns); }

std::string hex(std::uint64_t fingerprint) { return fmt::format("{:016x}", fingerprint); }

json to_json(const Learner& learner) {
  return {{"id", learner.id},
          {"note", learner.note},
          {"created", iso_time(learner.created_ns)},
          {"sessions", learner.sessions},
          {"last_session", time_or_null(learner.last_session_ns)}};
}

json to_json(const Session& session, bool whole) {
  json result{{"id", session.id},
              {"learner", session.learner},
              {"subject", session.subject},
              {"start", iso_time(session.start_ns)},
              {"end", time_or_null(session.end_ns)},
              {"reference", session.reference.name},
              {"plan", session.plan},
              {"repetitions", session.repetitions},
              {"mean_total", or_null(session.mean_total)},
              {"cues", session.cues}};
  if (!whole) return result;
  result["reference_fingerprint"] = hex(session.reference.fingerprint);
  result["reference_description"] = session.reference.description;
  result["source"] = session.source;
  result["body_map"] = session.body_map;
  json blocks = json::array();
  for (const Block& block : session.blocks) blocks.push_back(to_json(block));
  result["blocks"] = std::move(blocks);
  json sites = json::array();
  for (const SiteExposure& site : session.exposure) {
    sites.push_back({{"channel", site.channel},
                     {"segment", site.segment},
                     {"dose_before", site.dose_before},
                     {"dose", site.dose},
                     {"duty", site.duty},
                     {"heat", site.heat}});
  }
  result["exposure"] = std::move(sites);
  return result;
}

json to_json(const Progress& progress, const std::string& reference) {
  json points = json::array(), retention = json::array(), schedules = json::array();
  for (const ProgressPoint& point : progress.points) {
    json entry = summary(point);
    entry["tempo"] = point.tempo;
    entry["tolerance_scale"] = point.tolerance_scale;
    entry["reference_fingerprint"] = hex(point.fingerprint);
    entry["cued"] = or_null(point.cued);
    entry["sd_total"] = or_null(point.sd_total);
    json joints = json::object();
    for (const auto& [joint, rms] : point.joints) joints[joint] = deg(rms);
    entry["joints"] = std::move(joints);
    points.push_back(std::move(entry));
  }
  for (const Retention& entry : progress.retention) {
    retention.push_back(
        {{"kind", entry.kind == Retention::Kind::kAfterCues ? "after_cues" : "across_days"},
         {"practice", summary(entry.practice)},
         {"retention", summary(entry.retention)},
         {"pause", entry.pause},
         {"change", entry.change()}});
  }
  for (const ScheduleSummary& schedule : progress.schedules) {
    schedules.push_back({{"schedule", schedule.schedule},
                         {"sessions", schedule.sessions},
                         {"first", schedule.first},
                         {"last", schedule.last},
                         {"retention", or_null(schedule.retention)}});
  }
  return {{"reference", reference},
          {"points", std::move(points)},
          {"retention", std::move(retention)},
          {"schedules", std::move(schedules)}};
}

json export_json(const Learner& learner, std::span<const Session> course) {
  json sessions = json::array();
  for (const Session& session : course) sessions.push_back(to_json(session, true));
  return {{"format", "secondskin history"},
          {"version", 1},
          {"learner", to_json(learner)},
          {"sessions", std::move(sessions)}};
}

std::string export_csv(std::span<const Session> course) {
  std::string out =
      "learner,session,session_start,reference,reference_fingerprint,plan,block,block_name,"
      "schedule,tempo,tolerance_scale,max_cues,repetition,start,end,total,cues,cued,joint,rms_deg,"
      "peak_deg,in_band,timing_error_s,smoothness,range_deg,reference_range_deg\r\n";
  for (const Session& session : course) {
    for (const Block& block : session.blocks) {
      for (const Repetition& repetition : block.repetitions) {
        const std::string row = fmt::format(
            "{},{},{},{},{},{},{},{},{},{},{},{},{},{},{},{},{},{},", quoted(session.learner),
            session.id, iso_time(session.start_ns), quoted(session.reference.name),
            hex(session.reference.fingerprint), quoted(session.plan), block.index,
            quoted(block.name), quoted(block.schedule), cell(block.tempo), block.tolerance_scale,
            block.max_cues, repetition.number, iso_time(repetition.start_ns),
            iso_time(repetition.end_ns), repetition.total, repetition.cues,
            repetition.cued ? (*repetition.cued ? "1" : "0") : "");
        if (repetition.joints.empty()) out += row + ",,,,,,,\r\n";
        for (const JointFigures& joint : repetition.joints) {
          out += row + quoted(joint.joint);
          if (joint.measured) {
            out += fmt::format(",{},{},{},{},{},{},{}\r\n", deg(joint.rms), deg(joint.peak),
                               joint.in_band, cell(joint.timing_error), cell(joint.smoothness),
                               deg(joint.range), deg(joint.reference_range));
          } else {
            out += ",,,,,,,\r\n";
          }
        }
      }
    }
  }
  return out;
}

}  // namespace secondskin::history
