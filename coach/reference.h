#pragma once

#include <array>
#include <filesystem>
#include <span>
#include <string>
#include <vector>

#include "coach/score/posture.h"
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
  /// The dead band by frame of the motion, where several experts showed how free it is [rad]; empty
  /// for a single expert. Never below `tolerance`.
  std::vector<std::array<double, kJointCount>> band{};
  /// The experts' posture along `motion` and how much they differ; empty for a single expert, for
  /// whom the tolerances say how free it is. Whoever replaces `motion` clears it, and `band`.
  PostureModel posture{};
  bool either_side = false;  ///< done as in a mirror it is as good
  bool standing = false;     ///< both feet stay on the floor: balance matters
  std::size_t experts = 1;   ///< performances that the motion is the mean of

  /// A joint's dead band at a time [s], held at both ends [rad].
  double tolerance_at(double time, std::size_t joint) const noexcept;
};

/// Default tolerance of a joint that motion.toml does not name.
inline constexpr double kDefaultTolerance_deg = 10.0;

/// A band is at most this many times the tolerance where motion.toml says nothing else.
inline constexpr double kWidestBand = 3.0;

/// The band is this many standard deviations of the experts.
inline constexpr double kBandSpreads = 2.0;

/// Loads a reference from a folder with motion.bvh and motion.toml, or from a motion file alone
/// (all joints weigh 1, default tolerances, the file's stem as the name). Files expert_*.bvh in the
/// folder are more performances of the same motion: the reference is their mean, and their spread
/// widens the tolerance.
///
/// motion.toml: name, description, origin, licence (strings); standing, mirrored, either_side
/// (bool); [weights], [tolerances_deg] and [widest_tolerances_deg] by canonical joint name, with
/// "default" for the rest; [clip] start, end [s] of motion.bvh.
/// @throws std::runtime_error naming file, line, field and what was expected.
Reference load_reference(const std::filesystem::path& folder_or_file,
                         const std::filesystem::path& joint_maps);

/// One reference out of several folders or files, each with one or more performances of the same
/// motion. All but the performances is the first one's; the name is all names joined by "+".
/// @throws std::invalid_argument for none, else as above.
Reference load_reference(std::span<const std::filesystem::path> folders_or_files,
                         const std::filesystem::path& joint_maps);

/// The same from a canonical motion in memory.
Reference make_reference(std::string name, const Motion& canonical);

/// From several performances in memory: their mean; the band from their spread, between the default
/// tolerance and kWidestBand times it.
Reference make_reference(std::string name, std::span<const Motion> canonical);

/// The same with left and right exchanged in everything: for a learner who does it as in a mirror.
Reference mirrored(const Reference& reference);

}  // namespace secondskin::coach
