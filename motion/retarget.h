#pragma once

#include <filesystem>
#include <map>
#include <optional>
#include <string>

#include "motion/anatomy.h"
#include "motion/motion.h"

/// From any humanoid hierarchy to the canonical body.
///
/// The file's rest pose tells how its bones lie; each canonical segment is laid along the same bone
/// (shortest arc from its parent, so that a T-pose's palms face down as the arm's pure abduction
/// would have them) and from then on turns with the file's segment: q_WB = q_WS(t) * q_SB, q_SB
/// constant. Trunk, head and clavicles are upright at rest; a foot takes its bone's heading only;
/// the plane in which elbow and knee bend tells the twist of upper arm and thigh; a turn of the
/// hand about the forearm is the forearm's. Lengths are the wearer's own; the unit and the up axis
/// are told from the body. docs/motion.md has the whole rule.
namespace secondskin {

/// Which of a file's joints is which canonical joint. Kept in joint_maps/*.toml.
class JointMap {
 public:
  /// Reads one map: [joints] canonical_name = "TheirName" or a list of alternatives.
  /// @throws std::runtime_error naming file, line and the unknown or doubled joint.
  static JointMap load(const std::filesystem::path& file);

  /// The map in `folder` that names most of the skeleton's joints and at least the limbs.
  /// @throws std::runtime_error listing the skeleton's joints when none fits.
  static JointMap choose(const std::filesystem::path& folder, const Skeleton& skeleton);

  const std::string& name() const noexcept { return name_; }
  /// Their joint for a canonical one, in that skeleton.
  std::optional<std::size_t> find(Joint joint, const Skeleton& skeleton) const noexcept;

 private:
  std::string name_;
  std::map<Joint, std::vector<std::string>> names_;
};

enum class UpAxis { kY, kZ };

struct RetargetOptions {
  std::optional<UpAxis> up;               ///< told from the poses when empty
  std::optional<double> metres_per_unit;  ///< told from the body's size when empty
};

struct Retargeted {
  Motion motion;  ///< canonical skeleton with the wearer's segment lengths, metres, z up; joints
                  ///< that the file does not have stay at rest with confidence 0
  UpAxis up;
  double metres_per_unit;
};

/// @throws std::runtime_error when the body cannot be understood (no legs, zero bones, a stature
/// that
///         is no person's in any usual unit), saying which option would settle it.
Retargeted to_canonical(const Motion& motion, const JointMap& map, const RetargetOptions& = {});

/// Moves a canonical motion onto another canonical skeleton: same joint rotations, root
/// displacement scaled by leg length so that feet stay on the floor.
Motion fit_to(const Motion& canonical, const Skeleton& target);

/// Reads a motion file (by its extension; here .bvh) as canonical motion: read, choose, retarget.
Motion read_canonical(const std::filesystem::path& file, const std::filesystem::path& joint_maps,
                      const RetargetOptions& = {});

}  // namespace secondskin
