#include "server/wearable/estimate/smoother.h"

#include <Eigen/Cholesky>

#include "motion/rotation.h"
#include "server/wearable/estimate/body_state.h"
#include "server/wearable/estimate/covariance.h"

namespace secondskin::server {
namespace {

using Eigen::Matrix3d;
using Matrix9d = Eigen::Matrix<double, 9, 9>;
using Vector9d = Eigen::Matrix<double, 9, 1>;

constexpr double kLongestStep = 0.1;  // over a longer gap nothing goes back [s]

// White jerk of spectral density q^2 over a time, on three axes.
Matrix9d driven(double q, double t) {
  const Matrix3d one = white_jerk(t);
  Matrix9d Q = Matrix9d::Zero();
  for (Eigen::Index i = 0; i < 3; ++i) {
    for (Eigen::Index j = 0; j < 3; ++j) {
      Q.block<3, 3>(3 * i, 3 * j).diagonal().setConstant(q * q * one(i, j));
    }
  }
  return Q;
}

Matrix9d transition_of(const Matrix3d& turn, const Matrix3d& jacobian, double t) {
  Matrix9d F = Matrix9d::Identity();
  F.block<3, 3>(0, 0) = turn;
  F.block<3, 3>(0, 3) = t * jacobian;
  F.block<3, 3>(0, 6) = 0.5 * t * t * jacobian;
  F.block<3, 3>(3, 6) = t * Matrix3d::Identity();
  return F;
}

// C of the module's comment, applied.
Vector9d gain_times(const Matrix9d& P, const Matrix9d& F, const Matrix9d& Q, const Vector9d& e) {
  const Matrix9d ahead = F * P * F.transpose() + Q;
  return P * F.transpose() * ahead.ldlt().solve(e);
}

}  // namespace

void Smoother::add(const BodyFilter& filter) {
  if (!samples_.empty() && filter.stamp_ns() <= samples_.back().stamp_ns) return;
  const BodyLayout& layout = filter.layout();
  const BodyState& x = filter.estimate();
  const Covariance& P = filter.covariance();
  joint_of_ = layout.group_of;
  const auto block = [&](const auto& column_of) {
    Block out;
    for (int i = 0; i < 9; ++i) {
      for (int j = 0; j < 9; ++j) {
        out(i, j) = static_cast<float>(P.at(column_of(i / 3) + i % 3, column_of(j / 3) + j % 3));
      }
    }
    return out;
  };
  Sample sample{filter.stamp_ns(), x.groups, {}, {x.p, x.v, x.a}, {}, filter.pose()};
  sample.joint_covariance.reserve(x.groups.size());
  for (int g = 0; g < layout.groups; ++g) {
    sample.joint_covariance.push_back(block([&](int level) { return layout.rotation(g, level); }));
  }
  sample.root_covariance = block([&](int level) { return layout.root(level); });
  samples_.push_back(std::move(sample));
}

std::vector<StampedPose> Smoother::smooth() const {
  std::vector<StampedPose> out(samples_.size());
  if (samples_.empty()) return out;
  std::vector<GroupState> joints = samples_.back().joints;
  Place root = samples_.back().root;
  for (std::size_t k = samples_.size(); k-- > 0;) {
    const Sample& now = samples_[k];
    if (k + 1 < samples_.size()) {
      const double t = 1e-9 * static_cast<double>(samples_[k + 1].stamp_ns - now.stamp_ns);
      const bool gap = t > kLongestStep;
      const Matrix9d turning = driven(settings_.root_turn_jerk, t),
                     bending = driven(settings_.joint_jerk, t);
      for (std::size_t g = 0; g < joints.size(); ++g) {
        const GroupState& x = now.joints[g];
        if (!gap) {
          const GroupState ahead = after(x, t);
          const GroupTransition F = transition(x, t);
          Vector9d e;
          e << rotation_vector(ahead.q.conjugate() * joints[g].q), joints[g].w - ahead.w,
              joints[g].dw - ahead.dw;
          const Vector9d d =
              gain_times(now.joint_covariance[g].cast<double>(),
                         transition_of(F.turn, F.jacobian, t), g == 0 ? turning : bending, e);
          joints[g] = {(x.q * quaternion_from(d.head<3>())).normalized(), x.w + d.segment<3>(3),
                       x.dw + d.tail<3>()};
        } else {
          joints[g] = x;
        }
      }
      if (!gap) {
        Vector9d e;
        e << root.p - (now.root.p + t * now.root.v + 0.5 * t * t * now.root.a),
            root.v - (now.root.v + t * now.root.a), root.a - now.root.a;
        const Vector9d d = gain_times(now.root_covariance.cast<double>(),
                                      transition_of(Matrix3d::Identity(), Matrix3d::Identity(), t),
                                      driven(settings_.root_jerk, t), e);
        root = {now.root.p + d.head<3>(), now.root.v + d.segment<3>(3), now.root.a + d.tail<3>()};
      } else {
        root = now.root;
      }
    }
    StampedPose& pose = out[k];
    pose.frame = k + 1;
    pose.stamp_ns = now.stamp_ns;
    pose.pose = now.pose;
    pose.pose.p_WR = root.p;
    for (std::size_t i = 0; i < kJointCount; ++i) {
      if (joint_of_[i] == BodyLayout::kNoGroup) continue;
      pose.pose.q_PB[i] = joints[static_cast<std::size_t>(joint_of_[i])].q;
    }
  }
  return out;
}

}  // namespace secondskin::server
