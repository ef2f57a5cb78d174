#include "coach/reference.h"

#include <fmt/format.h>

#include <toml++/toml.h>

#include <cmath>
#include <numbers>
#include <optional>
#include <stdexcept>
#include <string_view>
#include <utility>

namespace secondskin::coach {
namespace {

constexpr double kDegree = std::numbers::pi / 180.0;

// One motion.toml and where in it things are, so that every complaint names its line.
class Description {
 public:
  explicit Description(const std::filesystem::path& file) : file_(file.string()) {
    try {
      table_ = toml::parse_file(file_);
    } catch (const toml::parse_error& e) {
      throw std::runtime_error(
          fmt::format("{}:{}: {}", file_, e.source().begin.line, std::string(e.description())));
    }
  }

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

}  // namespace

Reference make_reference(std::string name, const Motion& canonical) {
  if (!is_canonical(canonical.skeleton)) {
    throw std::invalid_argument(
        fmt::format("reference {}: its motion is not on the canonical skeleton", name));
  }
  Reference reference{.name = std::move(name),
                      .description = {},
                      .origin = {},
                      .licence = {},
                      .motion = canonical.rate_hz == kReferenceRate
                                    ? canonical
                                    : resample(canonical, kReferenceRate)};
  reference.weight.fill(1.0);
  reference.tolerance.fill(kDefaultTolerance_deg * kDegree);
  return reference;
}

Reference load_reference(const std::filesystem::path& folder_or_file,
                         const std::filesystem::path& joint_maps) {
  namespace fs = std::filesystem;
  if (!fs::exists(folder_or_file)) {
    throw std::runtime_error(fmt::format(
        "{}: no such reference: expected a folder with motion.bvh and motion.toml, or a "
        "motion file",
        folder_or_file.string()));
  }
  if (!fs::is_directory(folder_or_file)) {
    return make_reference(folder_or_file.stem().string(),
                          read_canonical(folder_or_file, joint_maps));
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
                    {"name", "description", "origin", "licence", "standing", "weights",
                     "tolerances_deg", "clip"});

  Motion motion = read_canonical(motion_file, joint_maps);
  if (const toml::table* table = description.section("clip")) {
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

  std::string name = description.text("name");
  if (name.empty()) name = fs::weakly_canonical(folder_or_file).filename().string();
  Reference reference = make_reference(std::move(name), motion);
  reference.description = description.text("description");
  reference.origin = description.text("origin");
  reference.licence = description.text("licence");
  reference.standing = description.flag("standing");
  description.by_joint("weights", 0.0, 1.0, 1.0, reference.weight);
  description.by_joint("tolerances_deg", 0.1, 180.0, kDegree, reference.tolerance);
  bool any = false;
  for (const double w : reference.weight) any = any || w > 0.0;
  if (!any) {
    description.refuse(description.section("weights")->source(), "weights",
                       "at least one joint above 0");
  }
  return reference;
}

}  // namespace secondskin::coach
