#include "coach/tactile/body_map.h"

#include <fmt/format.h>
#include <toml++/toml.h>

#include <algorithm>
#include <cmath>
#include <numbers>
#include <stdexcept>

namespace secondskin::coach {
namespace {

// Reads fields of one table and says where it went wrong.
class FieldReader {
 public:
  FieldReader(const std::filesystem::path& file, const toml::table& table)
      : file_(file), table_(table) {}

  [[noreturn]] void fail(std::string_view field, std::string_view expected) const {
    const toml::node* node = table_.get(field);
    const auto line = (node ? node->source() : table_.source()).begin.line;
    throw std::runtime_error(fmt::format("{}:{}: {}: {}expected {}", file_.string(), line, field,
                                         node ? "" : "missing, ", expected));
  }

  void allow(std::initializer_list<std::string_view> known) const {
    for (const auto& [key, node] : table_) {
      if (std::find(known.begin(), known.end(), key.str()) != known.end()) continue;
      throw std::runtime_error(fmt::format("{}:{}: {}: unknown, expected one of {}", file_.string(),
                                           key.source().begin.line, key.str(),
                                           fmt::join(known, ", ")));
    }
  }

  std::string text(std::string_view field, std::string_view expected) const {
    const auto value = table_[field].value_exact<std::string>();
    if (!value || value->empty()) fail(field, expected);
    return *value;
  }

  double number(std::string_view field, double low, double high) const {
    const toml::node* node = table_.get(field);
    const auto value = node && node->is_number() ? node->value<double>() : std::nullopt;
    if (!value || !(*value >= low && *value <= high)) {
      fail(field, fmt::format("a number from {} to {}", low, high));
    }
    return *value;
  }

  std::size_t whole(std::string_view field, std::int64_t low, std::int64_t high) const {
    const auto value = table_[field].value_exact<std::int64_t>();
    if (!value || *value < low || *value > high) {
      fail(field, fmt::format("a whole number from {} to {}", low, high));
    }
    return static_cast<std::size_t>(*value);
  }

 private:
  const std::filesystem::path& file_;
  const toml::table& table_;
};

// Angles are counted about the vertical of the rest pose, so the segment must lie along it.
bool upright_at_rest(Joint joint) {
  switch (joint) {
    case Joint::kLeftClavicle:
    case Joint::kRightClavicle:
    case Joint::kLeftAnkle:
    case Joint::kRightAnkle:
    case Joint::kLeftToes:
    case Joint::kRightToes:
      return false;
    default:
      return true;
  }
}

Tactor read_tactor(const FieldReader& in) {
  in.allow({"channel", "segment", "along", "angle_deg", "actuator", "threshold", "ceiling"});
  Tactor tactor;
  tactor.channel = in.whole("channel", 0, wire::kTactorCount - 1);

  constexpr std::string_view kSegments =
      "a canonical segment that is upright at rest, such as \"left_elbow\" (the forearm)";
  const auto joint = find_joint(in.text("segment", kSegments));
  if (!joint || !upright_at_rest(*joint)) in.fail("segment", kSegments);
  tactor.segment = *joint;

  tactor.along = in.number("along", 0.0, 1.0);
  tactor.angle = in.number("angle_deg", -360.0, 360.0) * std::numbers::pi / 180.0;

  constexpr std::string_view kActuators = "\"voice_coil\" or \"dc_motor\"";
  const std::string actuator = in.text("actuator", kActuators);
  if (actuator == "voice_coil") {
    tactor.actuator = wire::Actuator::kVoiceCoil;
  } else if (actuator == "dc_motor") {
    tactor.actuator = wire::Actuator::kDcMotor;
  } else {
    in.fail("actuator", kActuators);
  }
  tactor.threshold = in.number("threshold", 0.0, 1.0);
  tactor.ceiling = in.number("ceiling", 0.0, 1.0);
  if (tactor.ceiling < tactor.threshold) in.fail("ceiling", "at least the threshold");
  return tactor;
}

}  // namespace

BodyMap BodyMap::load(const std::filesystem::path& file) {
  toml::table table;
  try {
    table = toml::parse_file(file.string());
  } catch (const toml::parse_error& error) {
    const auto line = error.source().begin.line;
    throw std::runtime_error(fmt::format("{}:{}: {}", file.string(), line, error.description()));
  }
  const FieldReader in(file, table);
  in.allow({"name", "cue", "tactor"});
  BodyMap map;
  map.name = in.text("name", "a name");
  constexpr std::string_view kCues = "\"repulsive\" or \"attractive\"";
  const std::string cue = in.text("cue", kCues);
  if (cue != "repulsive" && cue != "attractive") in.fail("cue", kCues);
  map.repulsive = cue == "repulsive";

  const toml::array* tactors = table["tactor"].as_array();
  if (tactors == nullptr || tactors->empty()) in.fail("tactor", "one to sixteen [[tactor]] tables");
  for (const toml::node& node : *tactors) {
    const toml::table* entry = node.as_table();
    if (entry == nullptr) in.fail("tactor", "one to sixteen [[tactor]] tables");
    const FieldReader fields(file, *entry);
    const Tactor tactor = read_tactor(fields);
    for (const Tactor& other : map.tactors) {
      if (other.channel == tactor.channel) {
        fields.fail("channel", fmt::format("one that no other tactor has, not {}", tactor.channel));
      }
    }
    map.tactors.push_back(tactor);
  }
  return map;
}

}  // namespace secondskin::coach
