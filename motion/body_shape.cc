#include "motion/body_shape.h"

#include <algorithm>
#include <cassert>
#include <cmath>

namespace secondskin {
namespace {

// Radii as shares of stature, from the mean of the sexes' means in ANSUR II (Gordon et al. 2014,
// "2012 Anthropometric Survey of U.S. Army Personnel", NATICK/TR-15/007; 1986 women, 4082 men).
// A limb's girth is the circle of the same length, r = girth / 2 pi; at the middle of a limb the
// mean of the girths at its ends. The trunk is wider than deep: r = (breadth + depth) / 4.
constexpr double from_girth(double share_of_stature) {
  return share_of_stature / (2.0 * std::numbers::pi);
}
constexpr double kHips = 0.25 * (0.2067 + 0.1415);
constexpr double kWaist = 0.25 * (0.1850 + 0.1332);
constexpr double kChest = 0.25 * (0.1651 + 0.1481);
constexpr double kNeck = from_girth(0.2149);
constexpr double kHead = from_girth(0.3355);
constexpr double kUpperArm = from_girth(0.1961);                  // biceps
constexpr double kForearm = from_girth(0.5 * (0.1696 + 0.0977));  // forearm, wrist
constexpr double kHand = from_girth(0.1178);
constexpr double kThigh = from_girth(0.5 * (0.3667 + 0.2393));  // thigh, lower thigh
constexpr double kShank = from_girth(0.5 * (0.2262 + 0.1315));  // calf, ankle
constexpr double kFoot = from_girth(0.1419);                    // ball of the foot
// The same survey's crotch lies so much below the hip centres of canonical_skeleton.
constexpr double kCrotchBelowHips = 0.530 - 0.481;

double radius_share(Joint segment) noexcept {
  switch (segment) {
    case Joint::kPelvis:
      return kHips;
    case Joint::kSpineLower:
      return kWaist;
    case Joint::kSpineMiddle:
      return 0.5 * (kWaist + kChest);
    case Joint::kSpineUpper:
      return kChest;
    case Joint::kNeck:
      return kNeck;
    case Joint::kHead:
      return kHead;
    // No table has the shoulder's girth without the arm: as thick as the arm that hangs on it.
    case Joint::kLeftClavicle:
    case Joint::kRightClavicle:
    case Joint::kLeftShoulder:
    case Joint::kRightShoulder:
      return kUpperArm;
    case Joint::kLeftElbow:
    case Joint::kRightElbow:
      return kForearm;
    case Joint::kLeftWrist:
    case Joint::kRightWrist:
      return kHand;
    case Joint::kLeftHip:
    case Joint::kRightHip:
      return kThigh;
    case Joint::kLeftKnee:
    case Joint::kRightKnee:
      return kShank;
    case Joint::kLeftAnkle:
    case Joint::kRightAnkle:
      return kFoot;
    case Joint::kLeftToes:
    case Joint::kRightToes:
      return 0.5 * kFoot;  // flat
  }
  return kUpperArm;
}

// Whether the segment ends in the open, so that the capsule's cap must stay inside its length.
bool ends_free(Joint segment) noexcept {
  switch (segment) {
    case Joint::kSpineUpper:
    case Joint::kHead:
    case Joint::kLeftWrist:
    case Joint::kRightWrist:
    case Joint::kLeftToes:
    case Joint::kRightToes:
      return true;
    default:
      return false;
  }
}

}  // namespace

// The stature that an average body with these legs and this trunk has: hip to ankle is 0.491 and
// hip to shoulder 0.288 of it (Drillis & Contini 1966, as canonical_skeleton).
double average_stature(const Skeleton& s) noexcept {
  const auto length = [&](Joint joint) { return s[index(joint)].p_PB.norm(); };
  const double legs = 0.5 * (length(Joint::kLeftKnee) + length(Joint::kLeftAnkle) +
                             length(Joint::kRightKnee) + length(Joint::kRightAnkle));
  // At rest all frames are parallel, so offsets add up.
  Eigen::Vector3d shoulders = Eigen::Vector3d::Zero();
  for (const Joint joint : {Joint::kSpineLower, Joint::kSpineMiddle, Joint::kSpineUpper}) {
    shoulders += s[index(joint)].p_PB;
  }
  Eigen::Vector3d hips = Eigen::Vector3d::Zero();
  for (const Joint left : {Joint::kLeftHip, Joint::kLeftClavicle, Joint::kLeftShoulder}) {
    const Eigen::Vector3d middle = 0.5 * (s[index(left)].p_PB + s[index(mirrored(left))].p_PB);
    (left == Joint::kLeftHip ? hips : shoulders) += middle;
  }
  return (legs + (shoulders - hips).norm()) / (0.491 + 0.288);
}

Capsule segment_capsule(const Skeleton& canonical, Joint segment) noexcept {
  assert(canonical.size() == kJointCount);
  const double stature = average_stature(canonical);
  Capsule capsule{Eigen::Vector3d::Zero(), canonical[index(segment)].p_BE,
                  radius_share(segment) * stature};
  const double length = capsule.p_BE.norm();
  constexpr double kShortest = 0.2;  // of the length: some axis is left
  if (segment == Joint::kPelvis) {
    const double lift = capsule.radius - kCrotchBelowHips * stature;
    if (length > 0.0) capsule.p_BA = std::min(lift / length, 1.0 - kShortest) * capsule.p_BE;
  } else if (ends_free(segment) && length > 0.0) {
    capsule.p_BE *= std::max(kShortest, 1.0 - capsule.radius / length);
  }
  return capsule;
}

double ball_height(const Skeleton& canonical, Joint toes) noexcept {
  // canonical_skeleton: the toes' joint is 0.010 of the stature above the floor, 0.029 below the
  // ankle.
  return std::abs(canonical[index(toes)].p_PB.z()) * 0.010 / 0.029;
}

SkinPlace skin_place(const Skeleton& canonical, Joint segment, double along,
                     double angle) noexcept {
  const Capsule capsule = segment_capsule(canonical, segment);
  const Eigen::Vector3d axis = capsule.p_BE - capsule.p_BA;
  // Front and left of a vertical segment, carried to this one by the shortest arc.
  Eigen::Quaterniond q_BV = Eigen::Quaterniond::Identity();
  if (const double length = axis.norm(); length > 0.0) {
    const double up = axis.z() > 1e-6 * length ? 1.0 : -1.0;
    q_BV = Eigen::Quaterniond::FromTwoVectors(up * Eigen::Vector3d::UnitZ(), axis);
  }
  SkinPlace place;
  place.n_B = q_BV * Eigen::Vector3d(std::cos(angle), std::sin(angle), 0.0);
  place.p_BS = capsule.p_BA + along * axis + capsule.radius * place.n_B;
  return place;
}

}  // namespace secondskin
