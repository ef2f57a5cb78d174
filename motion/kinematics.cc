#include "motion/kinematics.h"

#include <cassert>

namespace secondskin {
namespace {

Eigen::Index column(std::size_t segment) noexcept {
  return static_cast<Eigen::Index>(3 + 3 * segment);
}

// Calls f with `segment` and every ancestor up to the root.
template <typename F>
void for_each_ancestor(const Skeleton& skeleton, std::size_t segment, F&& f) noexcept {
  for (;;) {
    f(segment);
    const auto& parent = skeleton[segment].parent;
    if (!parent) return;
    segment = *parent;
  }
}

}  // namespace

void forward_kinematics(const Skeleton& skeleton, const Eigen::Vector3d& p_WR,
                        std::span<const Eigen::Quaterniond> q_PB,
                        std::span<Eigen::Isometry3d> X_WB) noexcept {
  assert(q_PB.size() == skeleton.size() && X_WB.size() == skeleton.size());
  for (std::size_t i = 0; i < skeleton.size(); ++i) {
    const Segment& s = skeleton[i];
    const Eigen::Matrix3d R_PB = q_PB[i].toRotationMatrix();
    Eigen::Isometry3d& X = X_WB[i];
    if (s.parent) {
      const Eigen::Isometry3d& X_WP = X_WB[*s.parent];
      X.linear().noalias() = X_WP.linear() * R_PB;
      X.translation() = X_WP.translation();
      X.translation().noalias() += X_WP.linear() * s.p_PB;
    } else {
      X.linear() = R_PB;
      X.translation() = p_WR;
    }
    X.makeAffine();
  }
}

void position_jacobian(const Skeleton& skeleton, std::span<const Eigen::Isometry3d> X_WB,
                       std::size_t segment, const Eigen::Vector3d& p_BQ,
                       Eigen::Ref<Eigen::Matrix3Xd> J) noexcept {
  assert(J.cols() == column(skeleton.size()));
  J.setZero();
  J.leftCols<3>().setIdentity();
  const Eigen::Vector3d p_WQ = X_WB[segment] * p_BQ;
  for_each_ancestor(skeleton, segment, [&](std::size_t i) {
    const Eigen::Vector3d arm = p_WQ - X_WB[i].translation();
    for (Eigen::Index k = 0; k < 3; ++k) {
      const Eigen::Vector3d axis = X_WB[i].linear().col(k);
      J.col(column(i) + k) = axis.cross(arm);
    }
  });
}

void orientation_jacobian(const Skeleton& skeleton, std::span<const Eigen::Isometry3d> X_WB,
                          std::size_t segment, Eigen::Ref<Eigen::Matrix3Xd> J) noexcept {
  assert(J.cols() == column(skeleton.size()));
  J.setZero();
  for_each_ancestor(skeleton, segment,
                    [&](std::size_t i) { J.middleCols<3>(column(i)) = X_WB[i].linear(); });
}

Eigen::Vector3d centre_of_mass(const Skeleton& skeleton,
                               std::span<const Eigen::Isometry3d> X_WB) noexcept {
  Eigen::Vector3d moment = Eigen::Vector3d::Zero();
  double mass = 0.0;
  for (std::size_t i = 0; i < skeleton.size(); ++i) {
    const Segment& s = skeleton[i];
    if (s.mass_fraction == 0.0) continue;
    moment += s.mass_fraction * (X_WB[i] * s.p_BC);
    mass += s.mass_fraction;
  }
  if (mass == 0.0) return X_WB[0].translation();
  return moment / mass;
}

}  // namespace secondskin
