#include "clients/authoring/take.h"

#include <fmt/chrono.h>
#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>
#include <stdexcept>
#include <system_error>

#include "motion/bvh.h"
#include "motion/whole_file.h"

namespace secondskin::authoring {

namespace fs = std::filesystem;
using nlohmann::json;

namespace {

constexpr const char* kMotion = "motion.bvh";
constexpr const char* kInfo = "take.json";

json to_json(const std::vector<Part>& parts) {
  json all = json::array();
  for (const Part& part : parts) {
    all.push_back({{"start", part.span.start}, {"end", part.span.end}, {"chosen", part.chosen}});
  }
  return all;
}

std::vector<Part> parts_of(const json& all) {
  std::vector<Part> parts;
  for (const json& part : all) {
    parts.push_back({{part.at("start").get<double>(), part.at("end").get<double>()},
                     part.at("chosen").get<bool>()});
  }
  return parts;
}

json to_json(const TakeInfo& info, const std::vector<std::string>& unmeasured) {
  const auto span = [](const Span& s) { return json{s.start, s.end}; };
  json repetitions = json::array();
  for (const Span& each : info.cutting.repetitions) repetitions.push_back(span(each));
  return {{"recorded_ns", info.recorded_ns},
          {"source", info.source},
          {"faults", info.faults},
          {"duration", info.duration},
          {"rate_hz", info.rate_hz},
          {"unmeasured", unmeasured},
          {"moving", span(info.cutting.moving)},
          {"repetitions", repetitions},
          {"difference", info.cutting.difference},
          {"parts", to_json(info.parts)}};
}

json read_json(const fs::path& file) {
  const std::string text = read_whole_file(file);
  try {
    return json::parse(text);
  } catch (const json::exception& error) {
    throw std::runtime_error(fmt::format("{}: {}", file.string(), error.what()));
  }
}

// BVH has no confidences: a joint that the source never measured is remembered by name.
std::vector<std::string> unmeasured(const Motion& motion) {
  std::vector<std::string> names;
  for (std::size_t j = 0; j < kJointCount; ++j) {
    const bool ever = std::any_of(motion.poses.begin(), motion.poses.end(),
                                  [j](const Pose& pose) { return pose.confidence[j] > 0.0F; });
    if (!ever) names.emplace_back(joint_name(static_cast<Joint>(j)));
  }
  return names;
}

std::string name_of(std::int64_t recorded_ns) {
  const auto ms = recorded_ns / 1'000'000;
  const auto time = static_cast<std::time_t>(ms / 1000);
  return fmt::format("{:%Y%m%d-%H%M%S}-{:03}", fmt::gmtime(time), ms % 1000);
}

}  // namespace

TakeStore::TakeStore(fs::path folder, fs::path joint_maps)
    : folder_(std::move(folder)), joint_maps_(std::move(joint_maps)) {}

TakeInfo TakeStore::add(const Motion& canonical, const std::string& source,
                        std::int64_t recorded_ns, std::vector<std::string> faults) {
  for (const Pose& pose : canonical.poses) {
    if (!pose.is_valid()) throw std::invalid_argument("take: a pose is not finite");
  }
  TakeInfo info;
  info.cutting = cut(canonical);
  info.recorded_ns = recorded_ns;
  info.source = source;
  info.faults = std::move(faults);
  info.duration = canonical.duration();
  info.rate_hz = canonical.rate_hz;
  for (const Span& span : info.cutting.repetitions) {
    if (span.duration() >= kShortestPart) info.parts.push_back({span, true});
  }
  const std::lock_guard lock(mutex_);
  const std::string name = name_of(recorded_ns);
  info.id = name;
  for (int n = 2; fs::exists(folder_ / info.id); ++n) info.id = fmt::format("{}-{}", name, n);

  const fs::path part = folder_ / ("." + info.id + ".part");
  std::error_code ignored;
  try {
    fs::remove_all(part);
    fs::create_directories(part);
    write_bvh(canonical, part / kMotion);
    write_whole_file(part / kInfo, to_json(info, unmeasured(canonical)).dump(1));
    fs::rename(part, folder_ / info.id);
  } catch (...) {
    fs::remove_all(part, ignored);
    throw;
  }
  return known_[info.id] = info;
}

void TakeStore::look() {
  std::map<std::string, TakeInfo> now;
  std::error_code error;
  for (fs::directory_iterator it(folder_, error), end; !error && it != end; it.increment(error)) {
    const std::string id = it->path().filename().string();
    if (id.starts_with('.') || !fs::exists(it->path() / kInfo)) continue;
    try {
      const auto found = known_.find(id);
      now[id] = found != known_.end() ? found->second : read(it->path());
    } catch (const std::exception& why) {
      spdlog::warn("take left out: {}", why.what());
    }
  }
  known_ = std::move(now);
}

std::vector<TakeInfo> TakeStore::list() {
  const std::lock_guard lock(mutex_);
  look();
  std::vector<TakeInfo> all;
  for (const auto& [id, info] : known_) all.push_back(info);
  std::stable_sort(all.begin(), all.end(), [](const TakeInfo& a, const TakeInfo& b) {
    return a.recorded_ns < b.recorded_ns;
  });
  return all;
}

TakeInfo TakeStore::read(const fs::path& folder) const {
  const json from = read_json(folder / kInfo);
  const auto span = [](const json& pair) {
    return Span{pair.at(0).get<double>(), pair.at(1).get<double>()};
  };
  try {
    TakeInfo info;
    info.id = folder.filename().string();
    info.recorded_ns = from.at("recorded_ns").get<std::int64_t>();
    info.source = from.at("source").get<std::string>();
    info.faults = from.at("faults").get<std::vector<std::string>>();
    info.duration = from.at("duration").get<double>();
    info.rate_hz = from.at("rate_hz").get<double>();
    info.cutting.moving = span(from.at("moving"));
    for (const json& each : from.at("repetitions")) info.cutting.repetitions.push_back(span(each));
    info.cutting.difference = from.at("difference").get<double>();
    info.parts = parts_of(from.at("parts"));
    return info;
  } catch (const json::exception& error) {
    throw std::runtime_error(fmt::format("{}: {}", (folder / kInfo).string(), error.what()));
  }
}

fs::path TakeStore::place(const std::string& id) const { return folder_ / id; }

const TakeInfo& TakeStore::known(const std::string& id) {
  // An id is one of a listed folder, so it never leads elsewhere.
  if (!known_.contains(id)) look();
  const auto found = known_.find(id);
  if (found == known_.end() || !fs::exists(place(id) / kInfo)) {
    throw std::out_of_range(fmt::format("take '{:.64}': expected the id of a take", id));
  }
  return found->second;
}

Take TakeStore::load(const std::string& id) {
  const std::lock_guard lock(mutex_);
  const TakeInfo info = known(id);
  Take take{info, read_canonical(place(id) / kMotion, joint_maps_)};
  const json stored = read_json(place(id) / kInfo);
  for (const json& name : stored.at("unmeasured")) {
    const auto joint = find_joint(name.get<std::string>());
    if (!joint) continue;
    for (Pose& pose : take.motion.poses) pose.confidence[index(*joint)] = 0.0F;
  }
  return take;
}

void TakeStore::remove(const std::string& id) {
  const std::lock_guard lock(mutex_);
  known(id);
  // Renamed first, so that a half removed take is never seen.
  const fs::path gone = folder_ / ("." + id + ".gone");
  fs::rename(place(id), gone);
  known_.erase(id);
  fs::remove_all(gone);
}

TakeInfo TakeStore::set_parts(const std::string& id, std::vector<Part> parts) {
  const std::lock_guard lock(mutex_);
  TakeInfo info = known(id);
  for (std::size_t i = 0; i < parts.size(); ++i) {
    const Span& span = parts[i].span;
    if (!(span.start >= 0.0 && span.end <= info.duration + 1e-3 &&
          span.duration() >= kShortestPart - 1e-6)) {
      throw std::invalid_argument(
          fmt::format("parts[{}]: expected 0 <= start < end <= {:.2f}, at least {} s long", i,
                      info.duration, kShortestPart));
    }
  }
  info.parts = std::move(parts);
  json stored = read_json(place(id) / kInfo);
  stored["parts"] = to_json(info.parts);
  write_whole_file(place(id) / kInfo, stored.dump(1));
  return known_[id] = info;
}

Motion part_of(const Motion& motion, const Span& span, const std::string& what) {
  const double duration = motion.duration();
  if (!(span.start >= 0.0 && span.end <= duration + 0.1 &&
        span.duration() >= kShortestPart - 1e-6)) {
    throw std::invalid_argument(
        fmt::format("{}: {:.2f} to {:.2f} s: expected 0 <= start < end <= {:.2f}, at least {} s "
                    "long",
                    what, span.start, span.end, duration, kShortestPart));
  }
  const auto at = [&](double time) {
    return std::min(static_cast<std::size_t>(std::lround(time * motion.rate_hz)),
                    motion.poses.size() - 1);
  };
  return slice(motion, at(span.start), at(span.end) + 1);
}

}  // namespace secondskin::authoring
