#include "coach/tactile/safe_range.h"

#include <cmath>
#include <numbers>

#include "motion/rotation.h"
#include "motion/toml_fields.h"

namespace secondskin::coach {
namespace {

constexpr double kDegree = std::numbers::pi / 180.0;
constexpr double kTurn = 2.0 * std::numbers::pi;
constexpr double kSurelyLeaving = 2.0 * kDegree;  // predicted; a velocity is noisy
constexpr double kSurelyInside = 1.0 * kDegree;
constexpr double kLeastTarget = 1.0 * kDegree;  // only its direction matters
constexpr double kDifference = 1e-4;            // for the derivative of an angle [rad]

double wrapped_up(double angle) noexcept { return angle - kTurn * std::floor(angle / kTurn); }

// How far an angle is beyond the nearer end [rad], negative inside. `above`: which end that is.
double beyond(const JointLimit& limit, double angle, bool& above) noexcept {
  if (angle >= limit.minimum && angle <= limit.maximum) {
    above = limit.maximum - angle < angle - limit.minimum;
    return above ? angle - limit.maximum : limit.minimum - angle;
  }
  const double over = wrapped_up(angle - limit.maximum), under = wrapped_up(limit.minimum - angle);
  above = over < under;
  return above ? over : under;
}

double angle_of(const JointLimit& limit, const Eigen::Quaterniond& q_PB) noexcept {
  return joint_angles(limit.joint, q_PB)[static_cast<std::size_t>(limit.movement)];
}

// The rotation of the joint, in its own frame, that turns a movement's angle fastest. Unit length.
Eigen::Vector3d gradient(const JointLimit& limit, const Eigen::Quaterniond& q_PB) noexcept {
  Eigen::Vector3d slope;
  for (int k = 0; k < 3; ++k) {
    const Eigen::Vector3d step = kDifference * Eigen::Vector3d::Unit(k);
    slope[k] = std::remainder(angle_of(limit, q_PB * quaternion_from(step)) -
                                  angle_of(limit, q_PB * quaternion_from(-step)),
                              kTurn);
  }
  const double size = slope.norm();
  // Where the convention is singular: the movement's axis at rest.
  if (!(size > 0.1 * kDifference) || !std::isfinite(size)) {
    return canonical_anatomy()[index(limit.joint)].axis[static_cast<std::size_t>(limit.movement)];
  }
  return slope / size;
}

}  // namespace

SafeRange SafeRange::load(const std::filesystem::path& file) {
  const toml::table table = parse_toml(file);
  const TomlFields in(file, table);
  in.allow({"limits_deg"});
  const toml::table* joints = table["limits_deg"].as_table();
  constexpr std::string_view kTables = "tables [limits_deg.JOINT]";
  if (joints == nullptr || joints->empty()) in.fail("limits_deg", kTables);
  const TomlFields joints_in(file, *joints);
  SafeRange range;
  for (const auto& [key, node] : *joints) {
    const auto joint = find_joint(key.str());
    if (!joint) joints_in.fail(key.str(), "a canonical joint, such as \"left_knee\"");
    if (node.as_table() == nullptr) joints_in.fail(key.str(), kTables);
    const TomlFields movements(file, *node.as_table());
    movements.allow({kMovementNames[0], kMovementNames[1], kMovementNames[2]});
    for (std::size_t m = 0; m < kMovementNames.size(); ++m) {
      if (!movements.has(kMovementNames[m])) continue;
      const auto [least, most] = movements.range(kMovementNames[m], -180.0, 180.0);
      range.limits.push_back({*joint, static_cast<Movement>(m), least * kDegree, most * kDegree});
    }
  }
  if (range.limits.empty()) in.fail("limits_deg", "at least one limited movement");
  return range;
}

const SafeRangeAlarm& SafeRangeMonitor::update(const Pose& pose,
                                               const JointVectors& velocity) noexcept {
  alarm_.any = false;
  alarm_.excess.fill(0.0);
  for (Eigen::Vector3d& target : alarm_.target) target.setZero();
  for (std::size_t i = 0; i < range_.limits.size(); ++i) {
    const JointLimit& limit = range_.limits[i];
    const std::size_t j = index(limit.joint);
    const Eigen::Quaterniond& q_PB = pose.q_PB[j];
    bool above = false, above_soon = false;
    const double now = beyond(limit, angle_of(limit, q_PB), above);
    const Eigen::Vector3d ahead = kAlarmLookahead * velocity[j];
    const double soon = beyond(limit, angle_of(limit, q_PB * quaternion_from(ahead)), above_soon);
    if (!(pose.confidence[j] > 0.0f) || !std::isfinite(now) || !std::isfinite(soon)) {
      active_[i] = false;
      continue;
    }
    active_[i] =
        active_[i] ? now > -kSurelyInside || soon > 0.0 : now > 0.0 || soon > kSurelyLeaving;
    if (!active_[i]) continue;
    const bool outside = now > -kSurelyInside;
    const double excess = std::max({now, soon, kLeastTarget});
    // Of several movements of one joint the worst speaks.
    if (excess <= alarm_.excess[j]) continue;
    alarm_.any = true;
    alarm_.excess[j] = excess;
    alarm_.target[j] = ((outside ? above : above_soon) ? -excess : excess) * gradient(limit, q_PB);
  }
  return alarm_;
}

}  // namespace secondskin::coach
