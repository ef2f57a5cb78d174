#include "clients/cli/tactile_options.h"

#include <fmt/chrono.h>
#include <spdlog/spdlog.h>

#include <ctime>

#include "clients/cli/common.h"
#include "coach/tactile/exposure_file.h"
#include "coach/tactile/learner_profile.h"

namespace secondskin::cli {
namespace {

std::string today() { return fmt::format("{:%Y-%m-%d}", fmt::localtime(std::time(nullptr))); }

// Both ways out of every limit must have a place that can say "back".
void name_silent_limits(const coach::BodyMap& map, const coach::SafeRange& range) {
  const coach::TactileMapper mapper(map);
  for (const coach::JointLimit& limit : range.limits) {
    const auto m = static_cast<std::size_t>(limit.movement);
    const Eigen::Vector3d& axis = canonical_anatomy()[index(limit.joint)].axis[m];
    for (const double side : {-1.0, 1.0}) {
      if (mapper.tells(limit.joint, side * axis) > 0.0) continue;
      spdlog::warn("safe range: body map '{}' has no tactor that can say: {} {} to {:.0f} degrees",
                   map.name, joint_name(limit.joint), kMovementNames[m],
                   deg(side < 0.0 ? limit.maximum : limit.minimum));
    }
  }
}

}  // namespace

std::filesystem::path TactileOptions::exposure_file() const {
  std::filesystem::path file = profile;
  file.replace_extension(".exposure.toml");
  return file;
}

coach::TactileSetup TactileOptions::prepare(coach::BodyMap& map) const {
  coach::TactileSetup setup;
  setup.duration_scaled = duration_scaled;
  if (!profile.empty()) {
    map = coach::LearnerProfile::load(profile).shape(std::move(map));
    setup.exposure = coach::load_exposure(exposure_file(), map, today());
  }
  if (!safe_range.empty()) {
    setup.safe_range = coach::SafeRange::load(safe_range);
    name_silent_limits(map, setup.safe_range);
  }
  return setup;
}

void TactileOptions::keep(const coach::BodyMap& map, const coach::ExposureState& exposure) const {
  if (profile.empty()) return;
  if (!std::filesystem::exists(profile)) {
    spdlog::warn("{}: deleted during the session; what the skin bore today is not kept",
                 profile.string());
    return;
  }
  coach::save_exposure(exposure_file(), map, exposure, today());
}

void add_tactile_options(CLI::App& command, TactileOptions& options) {
  command
      .add_option(
          "--learner-profile", options.profile,
          "the learner's skin, from 'calibrate tactors'; keeps the day's exposure beside it")
      ->transform(CLI::Validator(
          [](std::string& given) -> std::string {
            if (std::filesystem::is_regular_file(given)) return {};
            const auto own = Library().own_profiles() / (given + ".toml");
            const bool plain = given.find('/') == given.npos;
            if (!plain || !std::filesystem::is_regular_file(own)) {
              return fmt::format(
                  "{}: expected a file, or a learner with one of 'calibrate tactors "
                  "--learner'",
                  given);
            }
            given = own.string();
            return {};
          },
          "FILE or LEARNER"));
  command
      .add_option("--safe-range", options.safe_range,
                  "joint limits (.toml); leaving them is cued at once, whatever the reference")
      ->check(CLI::ExistingFile);
  command.add_flag("--duration-scaled", options.duration_scaled,
                   "cues last longer, not stronger, as the error grows");
}

}  // namespace secondskin::cli
