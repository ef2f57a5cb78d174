#pragma once

#include <Eigen/Geometry>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

/// What a body is: rigid segments in a tree, and the pose that its joints take.
///
/// Frames: W the world, z up; R the root segment; B a segment, origin at its proximal joint; P the
/// parent of B. A segment is named after that proximal joint, because the joint is what moves it.
/// All values are immutable once built, so one Skeleton serves many threads.
namespace secondskin {

/// A rigid segment and where it hangs on its parent.
struct Segment {
  std::string name;                   ///< name of the proximal joint, unique, e.g. "left_elbow"
  std::optional<std::size_t> parent;  ///< an earlier segment; empty for the root only
  Eigen::Vector3d p_PB = Eigen::Vector3d::Zero();  ///< proximal joint in the parent's frame [m]
  Eigen::Vector3d p_BE = Eigen::Vector3d::Zero();  ///< distal end in B [m]
  double mass_fraction = 0.0;                      ///< of the body's mass; 0 where unknown
  Eigen::Vector3d p_BC = Eigen::Vector3d::Zero();  ///< centre of mass in B [m]
};

/// A tree of segments, the root first and every parent before its children.
class Skeleton {
 public:
  /// @throws std::invalid_argument naming the segment when the order, the parents or the names
  ///         are not as described above, or an offset is not finite.
  explicit Skeleton(std::vector<Segment> segments);

  const std::vector<Segment>& segments() const noexcept { return segments_; }
  const Segment& operator[](std::size_t i) const noexcept { return segments_[i]; }
  std::size_t size() const noexcept { return segments_.size(); }
  std::optional<std::size_t> find(std::string_view name) const noexcept;

 private:
  std::vector<Segment> segments_;
};

/// Where every joint of a skeleton is at one instant.
struct Pose {
  Eigen::Vector3d p_WR = Eigen::Vector3d::Zero();  ///< root position in the world [m]
  std::vector<Eigen::Quaterniond> q_PB;  ///< unit orientation of each segment in its parent (of the
                                         ///< root in the world); one per segment
  std::vector<float> confidence;         ///< 0 (not measured) to 1; one per segment

  Pose() = default;
  /// The rest pose of `segments` segments: identity rotations, full confidence.
  explicit Pose(std::size_t segments);

  /// Whether every number is finite and every quaternion has unit length within 1e-3.
  [[nodiscard]] bool is_valid() const noexcept;
};

/// A pose and the sample that it was measured from.
struct StampedPose {
  std::uint64_t frame = 0;    ///< counts up by one a sample at the source
  std::int64_t stamp_ns = 0;  ///< when the sample was measured, since the Unix epoch
  Pose pose;
};

}  // namespace secondskin
