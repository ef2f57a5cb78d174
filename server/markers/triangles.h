#pragma once

#include <Eigen/Geometry>
#include <array>
#include <optional>
#include <span>
#include <tl/expected.hpp>
#include <vector>

#include "motion/anatomy.h"
#include "motion/markers.h"

/// The skeleton as Second Skin, chapter 3, has it: joints from triangles of three markers.
///
/// Frames: G (the paper's global frame) is W here; T a triangle, J a joint. In calibration each
/// triangle learns where a joint lies and how it is turned in the triangle's axes,
///   J_offset,T = T_sys,G^-1 (J_pos,G - T_origin,G),   R_2 = T_sys,G^-1 J_sys,G,
/// and live it gives them back; a joint takes the mean over the triangles that are seen. The paper
/// sets J_sys at calibration to the world's axes and names the fault itself: the joints' axes then
/// depend on how the wearer stood. Here J_sys comes from the calibration, which takes it from the
/// wearer's own markers (marker_body.h).
///
/// Kept for comparison and for suits calibrated with the tongs; body_fit.h is the better way.
namespace secondskin::server {

/// A triangle's pose: origin the first vertex, x to the second, y = x * (third - first), z = x * y
/// (Second Skin, 3.2). Empty for vertices within about 6 degrees of a line or a millimetre of each
/// other, whose plane is noise.
std::optional<Eigen::Isometry3d> triangle_pose(const Eigen::Vector3d& first,
                                               const Eigen::Vector3d& second,
                                               const Eigen::Vector3d& third) noexcept;

/// The mean rotation: least sum of squared geodesic distances (Moakher 2002). Of none: identity.
Eigen::Quaterniond mean_rotation(std::span<const Eigen::Quaterniond> rotations) noexcept;

// Three ways to a joint's centre.

/// Between the tongs' two detectors (3.2), or in the middle of a set of detectors around the joint:
/// the mean of the markers over the frames that show all of them. Empty when no frame does.
std::optional<Eigen::Vector3d> centre_of_markers(const MarkerMotion& motion,
                                                 std::span<const std::size_t> markers);

enum class NoCentre {
  kTooFewFrames,       ///< under ten
  kTooLittleMovement,  ///< the segments hardly turned against each other
  kOneAxis,            ///< they turned about one axis only, so the centre may lie anywhere along it
};

/// A joint between two segments.
struct JointCentre {
  Eigen::Vector3d p_PJ;  ///< in the one segment's frame [m]
  Eigen::Vector3d p_BJ;  ///< in the other's [m]
  double residual;       ///< RMS distance between the two in the world [m]
};

/// The centre about which two segments turn: the point that is most nearly at rest in both, by
/// least squares over X_WP p_PJ = X_WB p_BJ, the same for both sides (Ehrig et al. 2006, J.
/// Biomech. 39:2798, "SCoRE"). @param X_WP, X_WB  as many
tl::expected<JointCentre, NoCentre> centre_of_rotation(std::span<const Eigen::Isometry3d> X_WP,
                                                       std::span<const Eigen::Isometry3d> X_WB);

/// What the calibration knows of one joint at the instant of calibration.
struct CalibratedJoint {
  Joint joint{};
  Eigen::Isometry3d X_WJ = Eigen::Isometry3d::Identity();  ///< J_pos and J_sys
  std::vector<std::size_t> markers;                        ///< that move with the joint's segment
};

class TriangleSkeleton {
 public:
  /// A joint's position comes from the triangles of the segment above (its own, for the first
  /// joint), its orientation from those of its own segment; a segment's triangles have its markers
  /// and its joint as vertices. Triangles that are degenerate at calibration are left out.
  /// @param joints  parents before children, by their canonical parents; a joint between that is
  ///                not listed keeps its rest rotation
  /// @param frame   the markers at that instant
  /// @throws std::invalid_argument naming the joint whose segment has no triangle that is visible,
  ///         a marker that is not in the frame, or an order that is not parents first.
  TriangleSkeleton(const std::vector<CalibratedJoint>& joints, const MarkerFrame& frame);

  /// The pose from one frame: parent-relative orientations, root position. Joints without a visible
  /// triangle keep their last rotation with confidence 0. Allocates nothing once `out` has the
  /// canonical size.
  void update(const MarkerFrame& frame, Pose& out) noexcept;

  /// A joint's pose in the world after the last frame; empty where no triangle was seen.
  const std::optional<Eigen::Isometry3d>& joint(Joint joint) const noexcept {
    return X_WJ_[index(joint)];
  }
  std::size_t triangles() const noexcept;

 private:
  // A marker's number, or a joint's from kJointVertex on.
  using Vertex = std::size_t;
  static constexpr std::size_t kJointVertex = std::size_t{1} << 32;
  struct Triangle {
    std::array<Vertex, 3> vertex;
    Eigen::Vector3d p_TJ;     // J_offset,T
    Eigen::Quaterniond q_TJ;  // R_2
  };
  struct Entry {
    Joint joint;
    std::vector<Triangle> position, orientation;
  };

  std::optional<Eigen::Vector3d> vertex(Vertex vertex, const MarkerFrame& frame) const noexcept;
  std::optional<Eigen::Isometry3d> pose(const Triangle& triangle,
                                        const MarkerFrame& frame) const noexcept;
  std::vector<Triangle> triangles_of(const std::vector<Vertex>& vertices, const MarkerFrame& frame,
                                     const Eigen::Isometry3d& X_WJ) const;

  std::vector<Entry> entries_;
  std::array<std::optional<Eigen::Isometry3d>, kJointCount> X_WJ_;
  std::vector<Eigen::Quaterniond> rotations_;  // room for one joint's triangles
};

}  // namespace secondskin::server
