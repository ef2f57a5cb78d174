#include "coach/tactile/body_map.h"

#include <fmt/format.h>
#include <numbers>

#include "motion/toml_fields.h"

namespace secondskin::coach {
namespace {

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

Tactor read_tactor(const TomlFields& in) {
  in.allow({"channel", "segment", "along", "angle_deg", "actuator", "threshold", "ceiling",
            "acceleration"});
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
  tactor.acceleration = in.has("acceleration") ? in.number("acceleration", 0.0, 100.0)
                                               : default_acceleration(tactor.actuator);
  return tactor;
}

}  // namespace

double default_acceleration(wire::Actuator actuator) noexcept {
  // Weights Wh of ISO 5349-1 (docs/tactile.md, "Exposure").
  constexpr double kWeightAt250Hz = 0.0634, kWeightAt200Hz = 0.0799;
  constexpr double kVoiceCoilSkin = 100.0, kDcMotorSkin = 25.0;  // assumed, unweighted r.m.s.
  return actuator == wire::Actuator::kVoiceCoil ? kWeightAt250Hz * kVoiceCoilSkin
                                                : kWeightAt200Hz * kDcMotorSkin;
}

BodyMap BodyMap::load(const std::filesystem::path& file) {
  const toml::table table = parse_toml(file);
  const TomlFields in(file, table);
  in.allow({"name", "cue", "tactor"});
  BodyMap map;
  map.name = in.text("name", "a name");
  constexpr std::string_view kCues = "\"repulsive\" or \"attractive\"";
  const std::string cue = in.text("cue", kCues);
  if (cue != "repulsive" && cue != "attractive") in.fail("cue", kCues);
  map.repulsive = cue == "repulsive";

  in.each("tactor", [&](const TomlFields& fields) {
    const Tactor tactor = read_tactor(fields);
    for (const Tactor& other : map.tactors) {
      if (other.channel == tactor.channel) {
        fields.fail("channel", fmt::format("one that no other tactor has, not {}", tactor.channel));
      }
    }
    map.tactors.push_back(tactor);
  });
  return map;
}

}  // namespace secondskin::coach
