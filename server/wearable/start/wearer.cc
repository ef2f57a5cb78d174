#include "server/wearable/start/wearer.h"

#include "motion/toml_fields.h"

namespace secondskin::server {
namespace {

// How people of one stature differ, and what a tape finds again: joint centres are felt through
// flesh.
constexpr double kUnmeasured = 0.04, kMeasured = 0.015;
constexpr double kLeast = 0.7, kMost = 1.4;  // times an average body of this stature

Bone bone_of(Joint segment) noexcept {
  switch (segment) {
    case Joint::kPelvis:
    case Joint::kSpineLower:
    case Joint::kSpineMiddle:
    case Joint::kSpineUpper:
      return Bone::kTrunk;
    case Joint::kNeck:
    case Joint::kHead:
      return Bone::kHead;
    case Joint::kLeftClavicle:
    case Joint::kRightClavicle:
      return Bone::kShoulder;
    case Joint::kLeftShoulder:
    case Joint::kRightShoulder:
      return Bone::kUpperArm;
    case Joint::kLeftElbow:
    case Joint::kRightElbow:
      return Bone::kForearm;
    case Joint::kLeftWrist:
    case Joint::kRightWrist:
      return Bone::kHand;
    case Joint::kLeftHip:
    case Joint::kRightHip:
      return Bone::kThigh;
    case Joint::kLeftKnee:
    case Joint::kRightKnee:
      return Bone::kShank;
    default:
      return Bone::kFoot;
  }
}

double& at(std::array<double, kBones>& scale, Bone bone) {
  return scale[static_cast<std::size_t>(bone)];
}

}  // namespace

Wearer Wearer::load(const std::filesystem::path& file) {
  const toml::table table = parse_toml(file);
  const TomlFields fields(file, table);
  fields.allow(
      {"stature", "shoulder_width", "upper_arm", "forearm", "hip_height", "knee_height", "foot"});
  Wearer wearer;
  wearer.stature = fields.number("stature", 0.5, 2.5);
  const auto read = [&](const char* field, std::optional<double>& to) {
    if (fields.has(field)) to = fields.number(field, 0.05, 1.5);
  };
  read("shoulder_width", wearer.shoulder_width);
  read("upper_arm", wearer.upper_arm);
  read("forearm", wearer.forearm);
  read("hip_height", wearer.hip_height);
  read("knee_height", wearer.knee_height);
  read("foot", wearer.foot);
  try {
    (void)wearer_skeleton(wearer);
  } catch (const std::invalid_argument& error) {
    throw std::runtime_error(fmt::format("{}: {}", file.string(), error.what()));
  }
  return wearer;
}

Skeleton wearer_skeleton(const Wearer& wearer) {
  const Skeleton average = canonical_skeleton(wearer.stature);
  const auto length = [&](Joint joint) { return average[index(joint)].p_PB.norm(); };
  std::array<double, kBones> scale;
  scale.fill(1.0);
  const auto fit = [&](Bone bone, std::string_view name, std::optional<double> measured,
                       double usual) {
    if (!measured) return;
    const double times = *measured / usual;
    if (!(times > kLeast && times < kMost)) {
      throw std::invalid_argument(
          fmt::format("{}: {} m, expected {:.2f} to {:.2f} m at a stature of {} m", name, *measured,
                      kLeast * usual, kMost * usual, wearer.stature));
    }
    at(scale, bone) = times;
  };
  const double half_width =
      average[index(Joint::kLeftClavicle)].p_PB.y() + average[index(Joint::kLeftShoulder)].p_PB.y();
  fit(Bone::kShoulder, "shoulder_width", wearer.shoulder_width, 2.0 * half_width);
  fit(Bone::kUpperArm, "upper_arm", wearer.upper_arm, length(Joint::kLeftElbow));
  fit(Bone::kForearm, "forearm", wearer.forearm, length(Joint::kLeftWrist));
  const Segment& foot = average[index(Joint::kLeftToes)];
  fit(Bone::kFoot, "foot", wearer.foot,
      (foot.p_PB.x() + foot.p_BE.x()) * 0.152 / 0.114);          // the heel is behind the ankle
  const double ankle = -foot.p_PB.z() + 0.010 * wearer.stature;  // above the floor
  const double shank = length(Joint::kLeftAnkle), thigh = length(Joint::kLeftKnee);
  std::optional<double> measured_shank, measured_thigh;
  if (wearer.knee_height) measured_shank = *wearer.knee_height - ankle;
  if (wearer.hip_height) {
    const double legs = *wearer.hip_height - ankle;
    if (!measured_shank) measured_shank = legs * shank / (shank + thigh);
    measured_thigh = legs - *measured_shank;
  }
  fit(Bone::kShank, "knee_height", measured_shank, shank);
  fit(Bone::kThigh, "hip_height", measured_thigh, thigh);
  return scaled(average, scale);
}

std::array<double, kBones> bone_sigmas(const Wearer& wearer) {
  std::array<double, kBones> sigma;
  sigma.fill(kUnmeasured);
  const auto measured = [&](Bone bone, bool is) {
    if (is) at(sigma, bone) = kMeasured;
  };
  measured(Bone::kShoulder, wearer.shoulder_width.has_value());
  measured(Bone::kUpperArm, wearer.upper_arm.has_value());
  measured(Bone::kForearm, wearer.forearm.has_value());
  measured(Bone::kThigh, wearer.hip_height.has_value());
  measured(Bone::kShank, wearer.knee_height || wearer.hip_height);
  measured(Bone::kFoot, wearer.foot.has_value());
  return sigma;
}

Skeleton scaled(const Skeleton& canonical, const std::array<double, kBones>& scale) {
  std::vector<Segment> segments = canonical.segments();
  for (std::size_t i = 0; i < segments.size(); ++i) {
    Segment& segment = segments[i];
    const auto joint = static_cast<Joint>(i);
    const double own = scale[static_cast<std::size_t>(bone_of(joint))];
    segment.p_BE *= own;
    segment.p_BC *= own;
    if (!segment.parent) continue;
    Bone carrier = bone_of(static_cast<Joint>(*segment.parent));
    if (joint == Joint::kLeftHip || joint == Joint::kRightHip) carrier = Bone::kHips;
    segment.p_PB *= scale[static_cast<std::size_t>(carrier)];
    // The collar bone begins beside the midline: shoulder width is its own bone's.
    if (joint == Joint::kLeftClavicle || joint == Joint::kRightClavicle) {
      segment.p_PB.y() *= scale[static_cast<std::size_t>(Bone::kShoulder)] /
                          scale[static_cast<std::size_t>(Bone::kTrunk)];
    }
  }
  return Skeleton(std::move(segments));
}

}  // namespace secondskin::server
