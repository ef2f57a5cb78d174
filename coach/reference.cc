#include "coach/reference.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <numbers>
#include <optional>
#include <stdexcept>
#include <string_view>
#include <utility>

#include "coach/align/expert_average.h"
#include "motion/toml_fields.h"

namespace secondskin::coach {
namespace {

constexpr double kDegree = std::numbers::pi / 180.0;

// One motion.toml and where in it things are, so that every complaint names its line.
class Description {
 public:
  explicit Description(const std::filesystem::path& file)
      : file_(file.string()), table_(parse_toml(file)) {}

  const toml::table& table() const noexcept { return table_; }

  [[noreturn]] void refuse(const toml::source_region& where, std::string_view field,
                           std::string_view expected) const {
    throw std::runtime_error(
        fmt::format("{}:{}: {}: expected {}", file_, where.begin.line, field, expected));
  }

  void known(const toml::table& table, std::string_view prefix,
             std::initializer_list<std::string_view> names) const {
    for (const auto& [key, value] : table) {
      bool found = false;
      std::string all;
      for (const std::string_view name : names) {
        found = found || name == key.str();
        all += (all.empty() ? "" : ", ") + std::string(name);
      }
      if (!found) {
        refuse(key.source(), fmt::format("{}{}", prefix, key.str()), fmt::format("one of {}", all));
      }
    }
  }

  std::string text(std::string_view field) const {
    const toml::node* node = table_.get(field);
    if (node == nullptr) return {};
    if (!node->is_string()) refuse(node->source(), field, "a text in quotes");
    return node->as_string()->get();
  }

  bool flag(std::string_view field) const {
    const toml::node* node = table_.get(field);
    if (node == nullptr) return false;
    if (!node->is_boolean()) refuse(node->source(), field, "true or false");
    return node->as_boolean()->get();
  }

  const toml::table* section(std::string_view field) const {
    const toml::node* node = table_.get(field);
    if (node == nullptr) return nullptr;
    if (!node->is_table()) refuse(node->source(), field, "a table");
    return node->as_table();
  }

  double number(const toml::node& node, std::string_view field, double min, double max) const {
    const auto value = node.is_number() ? node.value<double>() : std::nullopt;
    if (!value || !std::isfinite(*value) || *value < min || *value > max) {
      refuse(node.source(), field, fmt::format("a number from {} to {}", min, max));
    }
    return *value;
  }

  // A number for each joint: "default" for all that are not named.
  void by_joint(std::string_view field, double min, double max, double scale,
                std::array<double, kJointCount>& out) const {
    const toml::table* table = section(field);
    if (table == nullptr) return;
    if (const toml::node* node = table->get("default")) {
      out.fill(scale * number(*node, fmt::format("{}.default", field), min, max));
    }
    for (const auto& [key, node] : *table) {
      if (key.str() == "default") continue;
      const auto joint = find_joint(key.str());
      const std::string name = fmt::format("{}.{}", field, key.str());
      if (!joint) {
        refuse(key.source(), name, R"(a canonical joint such as left_knee, or "default")");
      }
      out[index(*joint)] = scale * number(node, name, min, max);
    }
  }

 private:
  std::string file_;
  toml::table table_;
};

Motion clip(const Motion& motion, double start, double end) {
  const auto last = static_cast<double>(motion.poses.size() - 1);
  const double first = std::min(std::round(start * motion.rate_hz), last);
  const double stop = std::clamp(std::round(end * motion.rate_hz), first, last);
  return slice(motion, static_cast<std::size_t>(first), static_cast<std::size_t>(stop) + 1);
}

// A reference before its experts have been averaged.
struct Ingredients {
  Reference frame{.name = {},
                  .description = {},
                  .origin = {},
                  .licence = {},
                  .motion = {canonical_skeleton(), kReferenceRate, {}}};
  std::vector<Motion> performances;
  std::array<double, kJointCount> widest{};  // [rad]
  bool mirrored = false;
};

Reference cook(Ingredients&& from) {
  Reference reference = std::move(from.frame);
  reference.experts = from.performances.size();
  ExpertAverage average = average_experts(from.performances, reference.weight, kReferenceRate);
  reference.motion = std::move(average.motion);
  if (reference.experts > 1) {
    reference.posture =
        posture_model(reference.motion, from.performances, reference.weight, reference.tolerance);
    reference.band = std::move(average.spread);
    for (auto& frame : reference.band) {
      for (std::size_t j = 0; j < kJointCount; ++j) {
        frame[j] = std::clamp(kBandSpreads * frame[j], reference.tolerance[j],
                              std::max(reference.tolerance[j], from.widest[j]));
      }
    }
  }
  return from.mirrored ? mirrored(reference) : reference;
}

Ingredients ingredients_of(std::string name, std::span<const Motion> canonical) {
  Ingredients result;
  for (const Motion& motion : canonical) {
    if (!is_canonical(motion.skeleton)) {
      throw std::invalid_argument(
          fmt::format("reference {}: its motion is not on the canonical skeleton", name));
    }
    result.performances.push_back(motion);
  }
  result.frame.name = std::move(name);
  result.frame.weight.fill(1.0);
  result.frame.tolerance.fill(kDefaultTolerance_deg * kDegree);
  result.widest.fill(kWidestBand * kDefaultTolerance_deg * kDegree);
  return result;
}

Ingredients read_ingredients(const std::filesystem::path& folder_or_file,
                             const std::filesystem::path& joint_maps) {
  namespace fs = std::filesystem;
  if (!fs::exists(folder_or_file)) {
    throw std::runtime_error(fmt::format(
        "{}: no such reference: expected a folder with motion.bvh and motion.toml, or a "
        "motion file",
        folder_or_file.string()));
  }
  if (!fs::is_directory(folder_or_file)) {
    const Motion motion = read_canonical(folder_or_file, joint_maps);
    return ingredients_of(folder_or_file.stem().string(), {&motion, 1});
  }
  const fs::path toml_file = folder_or_file / "motion.toml";
  const fs::path motion_file = folder_or_file / "motion.bvh";
  for (const fs::path& file : {toml_file, motion_file}) {
    if (!fs::exists(file)) {
      throw std::runtime_error(
          fmt::format("{}: not found: a reference is a folder with motion.bvh "
                      "and motion.toml",
                      file.string()));
    }
  }
  const Description description(toml_file);
  description.known(description.table(), "",
                    {"name", "description", "origin", "licence", "standing", "mirrored",
                     "either_side", "weights", "tolerances_deg", "widest_tolerances_deg", "clip"});

  std::vector<Motion> performances{read_canonical(motion_file, joint_maps)};
  if (const toml::table* table = description.section("clip")) {
    Motion& motion = performances.front();
    description.known(*table, "clip.", {"start", "end"});
    const double whole = motion.duration();
    double start = 0.0, end = whole;
    if (const toml::node* node = table->get("start")) {
      start = description.number(*node, "clip.start", 0.0, whole);
    }
    if (const toml::node* node = table->get("end")) {
      end = description.number(*node, "clip.end", 0.0, whole);
    }
    if (!(start < end)) {
      description.refuse(table->source(), "clip", "start before end");
    }
    motion = clip(motion, start, end);
  }
  std::vector<fs::path> others;
  for (const auto& entry : fs::directory_iterator(folder_or_file)) {
    const std::string name = entry.path().filename().string();
    if (name.starts_with("expert_") && name.ends_with(".bvh")) others.push_back(entry.path());
  }
  std::sort(others.begin(), others.end());
  for (const fs::path& file : others) performances.push_back(read_canonical(file, joint_maps));

  std::string name = description.text("name");
  if (name.empty()) name = fs::weakly_canonical(folder_or_file).filename().string();
  Ingredients result = ingredients_of(std::move(name), performances);
  Reference& frame = result.frame;
  frame.description = description.text("description");
  frame.origin = description.text("origin");
  frame.licence = description.text("licence");
  frame.standing = description.flag("standing");
  frame.either_side = description.flag("either_side");
  result.mirrored = description.flag("mirrored");
  description.by_joint("weights", 0.0, 1.0, 1.0, frame.weight);
  description.by_joint("tolerances_deg", 0.1, 180.0, kDegree, frame.tolerance);
  for (std::size_t j = 0; j < kJointCount; ++j) {
    result.widest[j] = kWidestBand * frame.tolerance[j];
  }
  description.by_joint("widest_tolerances_deg", 0.1, 180.0, kDegree, result.widest);
  bool any = false;
  for (const double w : frame.weight) any = any || w > 0.0;
  if (!any) {
    description.refuse(description.section("weights")->source(), "weights",
                       "at least one joint above 0");
  }
  return result;
}

}  // namespace

double Reference::tolerance_at(double time, std::size_t joint) const noexcept {
  if (band.empty()) return tolerance[joint];
  const double at = std::clamp(time * motion.rate_hz, 0.0, static_cast<double>(band.size() - 1));
  const auto before = static_cast<std::size_t>(at);
  const std::size_t after = std::min(before + 1, band.size() - 1);
  const double u = at - static_cast<double>(before);
  return (1.0 - u) * band[before][joint] + u * band[after][joint];
}

Reference make_reference(std::string name, const Motion& canonical) {
  return make_reference(std::move(name), std::span<const Motion>(&canonical, 1));
}

Reference make_reference(std::string name, std::span<const Motion> canonical) {
  return cook(ingredients_of(std::move(name), canonical));
}

Reference load_reference(const std::filesystem::path& folder_or_file,
                         const std::filesystem::path& joint_maps) {
  return cook(read_ingredients(folder_or_file, joint_maps));
}

Reference load_reference(std::span<const std::filesystem::path> folders_or_files,
                         const std::filesystem::path& joint_maps) {
  if (folders_or_files.empty()) throw std::invalid_argument("reference: expected at least one");
  Ingredients all = read_ingredients(folders_or_files.front(), joint_maps);
  for (const auto& path : folders_or_files.subspan(1)) {
    Ingredients more = read_ingredients(path, joint_maps);
    all.frame.name += "+" + more.frame.name;
    std::move(more.performances.begin(), more.performances.end(),
              std::back_inserter(all.performances));
  }
  return cook(std::move(all));
}

Reference mirrored(const Reference& reference) {
  const auto exchange = [](const std::array<double, kJointCount>& from) {
    std::array<double, kJointCount> to{};
    for (std::size_t j = 0; j < kJointCount; ++j) {
      to[j] = from[index(secondskin::mirrored(static_cast<Joint>(j)))];
    }
    return to;
  };
  const auto reflect = [](const Eigen::Vector3d& p) {
    return Eigen::Vector3d(p.x(), -p.y(), p.z());
  };
  Reference result = reference;
  std::vector<Segment> segments = reference.motion.skeleton.segments();
  for (std::size_t j = 0; j < kJointCount; ++j) {
    const Segment& from =
        reference.motion.skeleton[index(secondskin::mirrored(static_cast<Joint>(j)))];
    segments[j].p_PB = reflect(from.p_PB);
    segments[j].p_BE = reflect(from.p_BE);
    segments[j].p_BC = reflect(from.p_BC);
    segments[j].mass_fraction = from.mass_fraction;
  }
  result.motion.skeleton = Skeleton(std::move(segments));
  for (Pose& pose : result.motion.poses) pose = secondskin::mirrored(pose);
  result.weight = exchange(reference.weight);
  result.tolerance = exchange(reference.tolerance);
  for (auto& frame : result.band) frame = exchange(frame);
  result.posture = mirrored(reference.posture);
  return result;
}

}  // namespace secondskin::coach
