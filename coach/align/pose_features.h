#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "coach/reference.h"

/// What the aligner compares: for each joint its orientation and its angular velocity, as floats
/// laid out by frame so that a range of reference frames is compared in one sweep. The pelvis gives
/// the direction of gravity only, so neither heading nor place enters. docs/alignment.md,
/// section 1.
namespace secondskin::coach {

/// Angular velocities are differences over this time, in learner and reference alike [s].
inline constexpr double kVelocityLag = 0.1;

/// One joint of one pose: a unit quaternion (w, x, y, z), or for the pelvis (0, gravity).
using JointFeature = std::array<float, 4>;

/// How a joint is compared.
enum class Kind : std::uint8_t {
  kTilt,   ///< the pelvis: the direction of gravity
  kTrunk,  ///< spine and head: the whole rotation
  kLimb,   ///< mostly the direction of the limb, a little the whole rotation: how far a limb is
           ///< turned about itself differs from person to person and is measured worst
};
Kind kind_of(Joint joint) noexcept;

/// The limb's own axis in the parent's frame.
std::array<float, 3> limb_direction(const JointFeature& q) noexcept;

/// The learner at one instant, ready to be compared.
struct LearnerFeatures {
  std::array<JointFeature, kJointCount> measured{};
  std::array<JointFeature, kJointCount> orientation{};       ///< without the learner's own posture
  std::array<std::array<float, 3>, kJointCount> velocity{};  ///< own frame [rad/s]
  std::array<float, kJointCount> weight{};  ///< sums to 1; 0 for a joint that is not compared
  float joints = 0.0F;        ///< effective number of joints compared: 1 / sum of weight^2
  float speed_square = 0.0F;  ///< weighted mean of |velocity|^2 [rad^2/s^2]
  bool has_velocity = false;  ///< false just after a start or a gap
};

/// Writes one joint's feature. @param q_PB  orientation in the parent (of the pelvis in the world)
JointFeature joint_feature(Joint joint, const Eigen::Quaterniond& q_PB) noexcept;

/// Velocity between two features `seconds` apart [rad/s]: of the trunk the chord of the rotation
/// between them (within 1 % of the angle up to 28 degrees), of a limb and of gravity that of the
/// direction.
std::array<float, 3> feature_velocity(Joint joint, const JointFeature& from, const JointFeature& to,
                                      float seconds) noexcept;

/// Costs of reference frames [begin, begin + size) for one learner pose.
struct FrameCosts {
  std::span<float> pose;   ///< weighted mean of the squared joint distance, saturated [rad^2]
  std::span<float> cross;  ///< weighted mean of velocity_learner . velocity_reference
  std::span<float> speed;  ///< weighted mean of |velocity_reference|^2
};

/// The reference's features. Immutable.
class ReferenceFeatures {
 public:
  /// @param stride  keeps every stride-th frame of the reference
  ReferenceFeatures(const Reference& reference, std::size_t stride);

  std::size_t size() const noexcept { return size_; }

  /// Joint weights by index, 0 for joints without weight or missing in the reference; sums to 1.
  const std::array<float, kJointCount>& weight() const noexcept { return weight_; }

  /// Compares the learner with frames begin, begin + 1, … as many as the spans hold.
  void compare(const LearnerFeatures& learner, std::size_t begin,
               const FrameCosts& costs) const noexcept;

  /// A joint's features by frame; empty for one without weight.
  std::vector<JointFeature> orientations(std::size_t joint) const;

  /// All joints' features at a frame; zero for joints without weight.
  std::array<JointFeature, kJointCount> orientations_at(std::size_t frame) const noexcept;

  /// Weighted mean squared distance of two poses [rad^2]. @param weight  sums to 1
  float distance_square(const std::array<JointFeature, kJointCount>& a,
                        const std::array<float, kJointCount>& weight,
                        const std::array<JointFeature, kJointCount>& b) const noexcept;

  /// Weighted mean squared distance of two reference frames [rad^2].
  float distance_square(std::size_t a, std::size_t b) const noexcept;

 private:
  struct Track {
    std::size_t joint;
    Kind kind;
    std::array<std::vector<float>, 4> orientation;
    std::array<std::vector<float>, 3> direction;  // of a limb
    std::array<std::vector<float>, 3> velocity;
    std::vector<float> speed_square;
  };
  std::size_t size_ = 0;
  std::array<float, kJointCount> weight_{};
  std::vector<Track> tracks_;
};

}  // namespace secondskin::coach
