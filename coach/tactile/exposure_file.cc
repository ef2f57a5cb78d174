#include "coach/tactile/exposure_file.h"

#include <cmath>
#include <numbers>
#include <vector>

#include "motion/toml_fields.h"
#include "motion/whole_file.h"

namespace secondskin::coach {
namespace {

constexpr double kDegree = std::numbers::pi / 180.0;
constexpr double kSameAlong = 0.25;
constexpr double kSameAngle = 60.0 * kDegree;
constexpr double kLongestDay = 86'400.0;  // of full drive [s]

struct Skin {
  Joint segment{};
  double along = 0.0;
  double angle = 0.0;
  SiteExposure exposure;

  bool is_under(const Tactor& tactor) const {
    return tactor.segment == segment && std::abs(tactor.along - along) <= kSameAlong &&
           std::abs(std::remainder(tactor.angle - angle, 2.0 * std::numbers::pi)) < kSameAngle;
  }
};

struct Day {
  std::int64_t stamp_ns = 0;
  std::vector<Skin> skin;
};

Day read(const std::filesystem::path& file, const std::string& today) {
  Day day;
  if (!std::filesystem::exists(file)) return day;
  const toml::table table = parse_toml(file);
  const TomlFields in(file, table);
  in.allow({"day", "stamp_ns", "site"});
  if (in.text("day", "a date in quotes") != today) return day;
  day.stamp_ns = static_cast<std::int64_t>(in.whole("stamp_ns", 0, INT64_MAX));
  in.each("site", [&](const TomlFields& fields) {
    fields.allow({"segment", "along", "angle_deg", "dose", "duty", "heat"});
    Skin skin;
    constexpr std::string_view kSegment = "a canonical segment";
    const auto segment = find_joint(fields.text("segment", kSegment));
    if (!segment) fields.fail("segment", kSegment);
    skin.segment = *segment;
    skin.along = fields.number("along", 0.0, 1.0);
    skin.angle = fields.number("angle_deg", -360.0, 360.0) * kDegree;
    skin.exposure.dose = fields.number("dose", 0.0, kLongestDay);
    skin.exposure.duty = fields.number("duty", 0.0, 1.0);
    skin.exposure.heat = fields.number("heat", 0.0, kHeatAtFull);
    day.skin.push_back(skin);
  });
  return day;
}

}  // namespace

ExposureState load_exposure(const std::filesystem::path& file, const BodyMap& map,
                            const std::string& today) {
  const Day day = read(file, today);
  ExposureState state;
  state.stamp_ns = day.stamp_ns;
  for (const Tactor& tactor : map.tactors) {
    SiteExposure& site = state.sites[tactor.channel];
    for (const Skin& skin : day.skin) {
      if (!skin.is_under(tactor)) continue;
      site.dose = std::max(site.dose, skin.exposure.dose);
      site.duty = std::max(site.duty, skin.exposure.duty);
      site.heat = std::max(site.heat, skin.exposure.heat);
    }
  }
  return state;
}

void save_exposure(const std::filesystem::path& file, const BodyMap& map,
                   const ExposureState& state, const std::string& today) {
  Day day = read(file, today);
  std::erase_if(day.skin, [&](const Skin& skin) {
    return std::any_of(map.tactors.begin(), map.tactors.end(),
                       [&](const Tactor& tactor) { return skin.is_under(tactor); });
  });
  for (const Tactor& tactor : map.tactors) {
    day.skin.push_back({tactor.segment, tactor.along, tactor.angle, state.sites[tactor.channel]});
  }
  std::string text = fmt::format(
      "# What a learner's skin has borne today (docs/tactile.md, \"Exposure\"); secondskin writes "
      "it.\nday = \"{}\"\nstamp_ns = {}\n",
      today, std::max(day.stamp_ns, state.stamp_ns));
  for (const Skin& skin : day.skin) {
    text += fmt::format(
        "\n[[site]]\nsegment = \"{}\"\nalong = {}\nangle_deg = {}\ndose = {}\nduty = {}\nheat = "
        "{}\n",
        joint_name(skin.segment), skin.along, skin.angle / kDegree, skin.exposure.dose,
        skin.exposure.duty, skin.exposure.heat);
  }
  write_whole_file(file, text);
}

}  // namespace secondskin::coach
