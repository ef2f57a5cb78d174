#pragma once

#include <array>
#include <filesystem>
#include <string>

#include "motion/anatomy.h"
#include "motion/motion.h"
#include "motion/retarget.h"

/// An expert's motion and what matters in it: the thing that a learner is compared with.
namespace secondskin::coach {

/// References are resampled to this when loaded.
inline constexpr double kReferenceRate = 60.0;  ///< [Hz]

/// Immutable once loaded; shared by the stages.
struct Reference {
  std::string name;
  std::string description;
  std::string origin;
  std::string licence;
  Motion motion;                                ///< canonical, at kReferenceRate
  std::array<double, kJointCount> weight{};     ///< how much a joint matters, 0 (not at all) to 1
  std::array<double, kJointCount> tolerance{};  ///< dead band: errors up to this are none [rad]
  bool standing = false;                        ///< both feet stay on the floor: balance matters
};

/// Default tolerance of a joint that motion.toml does not name.
inline constexpr double kDefaultTolerance_deg = 10.0;

/// Loads a reference from a folder with motion.bvh and motion.toml, or from a motion file alone
/// (all joints weigh 1, default tolerances, the file's stem as the name).
///
/// motion.toml: name, description, origin, licence (strings); standing (bool); [weights] and
/// [tolerances_deg] by canonical joint name, with "default" for the rest; [clip] start, end [s].
/// @throws std::runtime_error naming file, line, field and what was expected.
Reference load_reference(const std::filesystem::path& folder_or_file,
                         const std::filesystem::path& joint_maps);

/// The same from a canonical motion in memory.
Reference make_reference(std::string name, const Motion& canonical);

}  // namespace secondskin::coach
