#include "server/wearable/estimate/body_motion.h"

#include <cassert>

#include "motion/rotation.h"

namespace secondskin::server {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

// How a point moves in the frame of the segment before a joint, written in W.
struct RelativeMotion {
  Vector3d p, v, a;
};

RelativeMotion relative(const JointMotion& joint, const PointMotion& q) noexcept {
  const Vector3d& w = joint.parent_w;
  RelativeMotion r;
  r.p = q.p - joint.p;
  r.v = q.v - joint.v - w.cross(r.p);
  r.a = q.a - joint.a - joint.parent_dw.cross(r.p) - w.cross(w.cross(r.p)) - 2.0 * w.cross(r.v);
  return r;
}

}  // namespace

void evaluate(const Skeleton& skeleton, const BodyLayout& layout, const BodyState& state,
              std::span<const Eigen::Quaterniond> fixed, std::size_t segment, double time,
              PathMotion& path) noexcept {
  const std::vector<std::size_t>& way = layout.path[segment];
  assert(way.size() <= kLongestPath);
  path.time = time;
  path.size = way.size();
  for (std::size_t i = 0; i < way.size(); ++i) {
    JointMotion& joint = path.joints[i];
    joint.segment = way[i];
    joint.group = layout.group_of[way[i]];
    GroupState own;
    if (joint.group == BodyLayout::kNoGroup) {
      own.q = fixed[way[i]];
    } else {
      own = after(state.groups[static_cast<std::size_t>(joint.group)], time);
    }
    const Matrix3d R_PB = own.q.toRotationMatrix();
    if (i == 0) {
      joint.R = R_PB;
      joint.p = state.p + time * state.v + 0.5 * time * time * state.a;
      joint.v = state.v + time * state.a;
      joint.a = state.a;
      joint.parent_w.setZero();
      joint.parent_dw.setZero();
    } else {
      const JointMotion& parent = path.joints[i - 1];
      const Vector3d arm = parent.R * skeleton[way[i]].p_PB;
      joint.R.noalias() = parent.R * R_PB;
      joint.p = parent.p + arm;
      joint.v = parent.v + parent.w.cross(arm);
      joint.a = parent.a + parent.dw.cross(arm) + parent.w.cross(parent.w.cross(arm));
      joint.parent_w = parent.w;
      joint.parent_dw = parent.dw;
    }
    joint.own_w = joint.R * own.w;
    joint.w = joint.parent_w + joint.own_w;
    joint.dw = joint.parent_dw + joint.R * own.dw + joint.parent_w.cross(joint.own_w);
  }
}

PointMotion point(const PathMotion& path, const Vector3d& p_BQ) noexcept {
  const JointMotion& last = path.end();
  const Vector3d arm = last.R * p_BQ;
  return {last.p + arm, last.v + last.w.cross(arm),
          last.a + last.dw.cross(arm) + last.w.cross(last.w.cross(arm))};
}

JointBlock position_block(const JointMotion& joint, const PointMotion& q) noexcept {
  JointBlock block;
  block.rotation.noalias() = -cross_matrix(q.p - joint.p) * joint.R;
  return block;
}

JointBlock velocity_block(const JointMotion& joint, const PointMotion& q) noexcept {
  const RelativeMotion r = relative(joint, q);
  const Matrix3d arm = cross_matrix(r.p);
  JointBlock block;
  block.rotation.noalias() = -(cross_matrix(r.v) + cross_matrix(joint.parent_w) * arm) * joint.R;
  block.rate.noalias() = -arm * joint.R;
  return block;
}

JointBlock acceleration_block(const JointMotion& joint, const PointMotion& q) noexcept {
  const RelativeMotion r = relative(joint, q);
  const Matrix3d arm = cross_matrix(r.p);
  const Matrix3d w = cross_matrix(joint.parent_w);
  const Matrix3d wv = w * cross_matrix(r.v);
  const Matrix3d w_arm = w * arm;
  JointBlock block;
  block.rotation.noalias() =
      -(cross_matrix(r.a) + 2.0 * wv + cross_matrix(joint.parent_dw) * arm + w * w_arm) * joint.R;
  block.rate.noalias() =
      -(2.0 * cross_matrix(r.v) + arm * cross_matrix(joint.own_w) + 2.0 * w_arm) * joint.R;
  block.acceleration.noalias() = -arm * joint.R;
  return block;
}

void turn_along(const JointMotion& joint, const Vector3d& f, JointBlock& block) noexcept {
  block.rotation.noalias() += cross_matrix(f) * joint.R;
}

JointBlock rate_block(const JointMotion& joint) noexcept {
  JointBlock block;
  block.rotation.noalias() = cross_matrix(joint.parent_w) * joint.R;
  block.rate = joint.R;
  return block;
}

}  // namespace secondskin::server
