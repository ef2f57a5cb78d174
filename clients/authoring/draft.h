#pragma once

#include <array>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "coach/reference.h"
#include "motion/anatomy.h"
#include "motion/motion.h"
#include "motion/retarget.h"

/// A reference before it is saved: the mean of the chosen parts, and what they say about which
/// joints matter and how exactly. docs/references.md has the equations. Pure.
namespace secondskin::authoring {

using ByJoint = std::array<double, kJointCount>;

/// What the parts say of a joint.
struct JointProposal {
  bool measured = true;    ///< else it weighs nothing
  double range = 0.0;      ///< largest distance between two orientations of the mean [rad]
  double spread = 0.0;     ///< of the parts from their mean, RMS over time [rad]; 0 for one part
  double weight = 0.0;     ///< proposed, 0 to 1
  double tolerance = 0.0;  ///< proposed [rad]
};

/// A joint of interest weighs at least so much.
inline constexpr double kOfInterest = 0.6;

struct Draft {
  std::vector<Motion> parts;              ///< as a saved reference's files are read
  Motion mean;                            ///< at coach::kReferenceRate
  std::vector<ByJoint> spread;            ///< by frame of the mean [rad]
  std::vector<std::vector<double>> when;  ///< of each part, by frame of the mean [s]
  std::array<JointProposal, kJointCount> joints;
  bool standing = false;  ///< proposed: both feet stay where they are
};

/// @param parts    canonical, whole performances of one motion; at least one
/// @param weights  of the joints when the parts are averaged; empty: as proposed
/// @param map      of canonical names (canonical_names())
/// @throws std::invalid_argument for none, or one that is not canonical.
Draft make_draft(std::span<const Motion> parts, const std::optional<ByJoint>& weights,
                 const JointMap& map);

/// The joint map with which the coach reads a saved reference.
JointMap canonical_names(const std::filesystem::path& joint_maps);

/// A motion as it comes back from a saved reference's file.
Motion as_saved(const Motion& canonical, const JointMap& map);

}  // namespace secondskin::authoring
