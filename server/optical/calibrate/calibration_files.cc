// The files that describe what one calibrates with: grid, wand, rough layout.
#include <fmt/format.h>

#include <array>
#include <cmath>
#include <numbers>
#include <stdexcept>
#include <string_view>
#include <utility>

#include "motion/toml_fields.h"
#include "server/optical/calibrate/grid_calibration.h"
#include "server/optical/calibrate/rough_layout.h"
#include "server/optical/calibrate/wand_calibration.h"

namespace secondskin::server {
namespace {

constexpr double kInch = 0.0254;
constexpr double kMost = 100.0;  // no place of a room is further from its origin [m]

// One file and where in it things are, so that every complaint names its line.
class Description {
 public:
  explicit Description(const std::filesystem::path& file)
      : file_(file.string()), table_(parse_toml(file)) {}

  const toml::table& table() const noexcept { return table_; }

  [[noreturn]] void refuse(const toml::node* where, std::string_view field,
                           std::string_view expected) const {
    throw std::runtime_error(fmt::format("{}:{}: {}: expected {}", file_,
                                         where == nullptr ? 1U : where->source().begin.line, field,
                                         expected));
  }

  void known(std::initializer_list<std::string_view> names) const {
    for (const auto& [key, value] : table_) {
      bool found = false;
      std::string all;
      for (const std::string_view name : names) {
        found = found || name == key.str();
        all += (all.empty() ? "" : ", ") + std::string(name);
      }
      if (!found) refuse(&value, key.str(), fmt::format("one of {}", all));
    }
  }

  // The file's unit in metres.
  double unit() const {
    static constexpr std::array<std::pair<std::string_view, double>, 5> kUnits{
        {{"m", 1.0}, {"cm", 0.01}, {"mm", 0.001}, {"in", kInch}, {"0.1in", 0.1 * kInch}}};
    const toml::node* node = table_.get("unit");
    if (node != nullptr && node->is_string()) {
      for (const auto& [name, metres] : kUnits) {
        if (node->as_string()->get() == name) return metres;
      }
    }
    refuse(node, "unit", R"("m", "cm", "mm", "in" or "0.1in")");
  }

  double number(const toml::node* node, std::string_view field, double most) const {
    const auto value = node != nullptr && node->is_number() ? node->value<double>() : std::nullopt;
    if (!value || !std::isfinite(*value) || std::fabs(*value) > most) {
      refuse(node, field, fmt::format("a number from {} to {}", -most, most));
    }
    return *value;
  }

  Eigen::Vector3d point(const toml::node* node, std::string_view field, double unit) const {
    const toml::array* array = node != nullptr ? node->as_array() : nullptr;
    if (array == nullptr || array->size() != 3) refuse(node, field, "three numbers [x, y, z]");
    Eigen::Vector3d p;
    for (std::size_t k = 0; k < 3; ++k) {
      p[static_cast<Eigen::Index>(k)] = unit * number(array->get(k), field, kMost / unit);
    }
    return p;
  }

  const toml::array& list(std::string_view field, std::size_t least) const {
    const toml::node* node = table_.get(field);
    const toml::array* array = node != nullptr ? node->as_array() : nullptr;
    if (array == nullptr || array->size() < least) {
      refuse(node, field, fmt::format("a list of at least {}", least));
    }
    return *array;
  }

  std::vector<Eigen::Vector3d> points(std::string_view field, std::size_t least,
                                      double unit) const {
    std::vector<Eigen::Vector3d> out;
    const toml::array& array = list(field, least);
    for (std::size_t k = 0; k < array.size(); ++k) {
      const std::string name = fmt::format("{}[{}]", field, k);
      const Eigen::Vector3d p = point(array.get(k), name, unit);
      for (std::size_t j = 0; j < k; ++j) {
        if ((p - out[j]).norm() < 1e-3) {
          refuse(array.get(k), name, fmt::format("another place than {}[{}]", field, j));
        }
      }
      out.push_back(p);
    }
    return out;
  }

 private:
  std::string file_;
  toml::table table_;
};

}  // namespace

CalibrationGrid CalibrationGrid::load(const std::filesystem::path& file) {
  const Description description(file);
  description.known({"unit", "up", "detectors", "heights"});
  const double unit = description.unit();
  const toml::node* up = description.table().get("up");
  const std::string axis = up != nullptr && up->is_string() ? up->as_string()->get() : "";
  if (axis != "y" && axis != "z") description.refuse(up, "up", R"("y" or "z")");
  CalibrationGrid grid;
  grid.p_W = description.points("detectors", 4, unit);
  if (axis == "y") {
    for (Eigen::Vector3d& p : grid.p_W) p = Eigen::Vector3d(p.z(), p.x(), p.y());
  }
  const toml::array& heights = description.list("heights", 1);
  for (std::size_t k = 0; k < heights.size(); ++k) {
    grid.heights.push_back(
        unit * description.number(heights.get(k), fmt::format("heights[{}]", k), kMost / unit));
  }
  return grid;
}

Wand Wand::load(const std::filesystem::path& file) {
  const Description description(file);
  description.known({"unit", "lying"});
  return {description.points("lying", 2, description.unit())};
}

RoughLayout RoughLayout::load(const std::filesystem::path& file) {
  const Description description(file);
  description.known({"unit", "projector"});
  const double unit = description.unit();
  const toml::array& projectors = description.list("projector", 1);
  RoughLayout layout;
  for (std::size_t i = 0; i < projectors.size(); ++i) {
    const toml::table* table = projectors.get(i)->as_table();
    const std::string name = fmt::format("projector {}", i);
    if (table == nullptr) {
      description.refuse(projectors.get(i), name, "position, looks_at and rising_deg");
    }
    const auto field = [&](std::string_view key) { return fmt::format("{}: {}", name, key); };
    const auto node = [&](std::string_view key) {
      const toml::node* found = table->get(key);
      if (found == nullptr) description.refuse(table, field(key), "a value");
      return found;
    };
    for (const auto& [key, value] : *table) {
      if (key != "position" && key != "looks_at" && key != "rising_deg") {
        description.refuse(&value, field(key.str()), "position, looks_at or rising_deg");
      }
    }
    RoughPlace place;
    place.p_W = description.point(node("position"), field("position"), unit);
    place.looks_at_W = description.point(node("looks_at"), field("looks_at"), unit);
    place.rising = description.number(node("rising_deg"), field("rising_deg"), 360.0) *
                   std::numbers::pi / 180.0;
    if ((place.looks_at_W - place.p_W).head<2>().norm() < 0.1) {
      description.refuse(table->get("looks_at"), field("looks_at"),
                         "a place that is not straight above or below the projector");
    }
    layout.places.push_back(place);
  }
  return layout;
}

}  // namespace secondskin::server
