#include "server/optical/track/segment_filter.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>

#include "motion/rotation.h"

namespace secondskin::server {
namespace {

// Drift is added in steps of so long: it is slow against that [s].
constexpr double kDriftStep = 0.25;

}  // namespace

SegmentFilter::SegmentFilter(std::size_t detectors, const SegmentMotion& motion,
                             const SegmentPrior& prior)
    : motion_(motion),
      prior_(prior),
      placed_(detectors, 0),
      r_(Eigen::Matrix3Xd::Zero(3, static_cast<Eigen::Index>(detectors))) {
  const Eigen::Index n = place_at(detectors);
  P_.setZero(n, n);
  PHt_.setZero(n);
  K_.setZero(n);
  apart_.setZero(n);
  drift_.setZero(n - kPose, n - kPose);
}

void SegmentFilter::reset() noexcept {
  active_ = false;
  std::fill(placed_.begin(), placed_.end(), std::uint8_t{0});
}

void SegmentFilter::begin(const Eigen::Vector3d& p_WB, const Eigen::Vector3d& v_WB) noexcept {
  reset();
  active_ = true;
  p_ = p_WB;
  v_ = v_WB;
  a_.setZero();
  w_.setZero();
  dw_.setZero();
  q_.setIdentity();
  P_.setZero();  // the pose is what defines B: it is known
  const auto set = [&](Eigen::Index at, double sigma) {
    P_.diagonal().segment<3>(at).setConstant(sigma * sigma);
  };
  set(3, prior_.velocity_sigma);
  set(6, prior_.acceleration_sigma);
  set(12, prior_.turn_sigma);
  set(15, prior_.turn_acceleration_sigma);
  drift_.setZero();
  undrifted_ = 0.0;
}

SegmentFilter::Point SegmentFilter::point(std::size_t detector, double lead) const noexcept {
  Point point;
  point.lead = lead;
  point.turn = quaternion_from(lead * w_ + 0.5 * lead * lead * dw_).toRotationMatrix();
  point.R_WB = point.turn * q_.toRotationMatrix();
  point.p_BD_W = point.R_WB * r_.col(static_cast<Eigen::Index>(detector));
  point.p_WD = p_ + lead * v_ + 0.5 * lead * lead * a_ + point.p_BD_W;
  return point;
}

Eigen::Vector3d SegmentFilter::on_limb(const Eigen::Vector3d& p_WD, double lead) const noexcept {
  const Eigen::Quaterniond q = quaternion_from(lead * w_ + 0.5 * lead * lead * dw_) * q_;
  return q.conjugate() * (p_WD - p_ - lead * v_ - 0.5 * lead * lead * a_);
}

// How a movement along g depends on the pose.
SegmentFilter::PoseRow SegmentFilter::pose_row(const Point& point,
                                               const Eigen::Vector3d& g) noexcept {
  const Eigen::Vector3d m = point.p_BD_W.cross(g);  // g . (theta x p) = (p x g) . theta
  const double lead = point.lead, half = 0.5 * lead * lead;
  PoseRow h;
  h << g, lead * g, half * g, point.turn.transpose() * m, lead * m, half * m;
  return h;
}

double SegmentFilter::innovation_variance(std::size_t detector, const Point& point,
                                          const Eigen::RowVector3d& gradient,
                                          double variance) noexcept {
  const PoseRow h = pose_row(point, gradient.transpose());
  const Eigen::Vector3d hr = point.R_WB.transpose() * gradient.transpose();
  const Eigen::Index at = place_at(detector);
  PHt_.noalias() = P_.leftCols<kPose>() * h;
  PHt_.noalias() += P_.middleCols<3>(at) * hr;
  return h.dot(PHt_.head<kPose>()) + hr.dot(PHt_.segment<3>(at)) + variance;
}

void SegmentFilter::correct(double nu, double S) noexcept {
  K_ = PHt_ / S;
  P_.noalias() -= K_ * PHt_.transpose();
  const auto x = nu * K_;
  p_ += x.segment<3>(0);
  v_ += x.segment<3>(3);
  a_ += x.segment<3>(6);
  q_ = (quaternion_from(Eigen::Vector3d(x.segment<3>(9))) * q_).normalized();
  w_ += x.segment<3>(12);
  dw_ += x.segment<3>(15);
  for (std::size_t i = 0; i < placed_.size(); ++i) {
    if (placed_[i] != 0) r_.col(static_cast<Eigen::Index>(i)) += x.segment<3>(place_at(i));
  }
}

double SegmentFilter::sigma(std::size_t detector, const Point& point) const noexcept {
  double trace = 0.0;
  const Eigen::Index at = place_at(detector);
  for (int axis = 0; axis < 3; ++axis) {
    const PoseRow h = pose_row(point, Eigen::Vector3d::Unit(axis));
    const Eigen::Vector3d hr = point.R_WB.row(axis).transpose();
    trace += h.dot(P_.topLeftCorner<kPose, kPose>() * h) +
             2.0 * h.dot(P_.block<kPose, 3>(0, at) * hr) + hr.dot(P_.block<3, 3>(at, at) * hr);
  }
  return std::sqrt(std::max(trace, 0.0));
}

void SegmentFilter::place(std::size_t detector, const Eigen::Vector3d& p_WD,
                          const Eigen::Matrix3d& covariance, double lead) noexcept {
  forget(detector);
  const Eigen::Index at = place_at(detector), n = P_.rows();
  const Eigen::Index i = static_cast<Eigen::Index>(detector);
  Point seen = point(detector, lead);  // of the limb's origin, its place is zero yet
  seen.p_BD_W = p_WD - seen.p_WD;
  r_.col(i) = seen.R_WB.transpose() * seen.p_BD_W;
  placed_[detector] = 1;
  // dr = R' (dp_D - J dx), J the point's dependence on the pose.
  Eigen::Matrix<double, 3, kPose> J;
  for (int axis = 0; axis < 3; ++axis) {
    J.row(axis) = pose_row(seen, Eigen::Vector3d::Unit(axis)).transpose();
  }
  const Eigen::Matrix<double, 3, kPose> G = -(seen.R_WB.transpose() * J);
  for (Eigen::Index c = 0; c < n; ++c) {
    if (c >= at && c < at + 3) continue;
    const Eigen::Vector3d cross = G * P_.col(c).head<kPose>();
    P_.block<3, 1>(at, c) = cross;
    P_.block<1, 3>(c, at) = cross.transpose();
  }
  P_.block<3, 3>(at, at) = G * P_.topLeftCorner<kPose, kPose>() * G.transpose() +
                           seen.R_WB.transpose() * covariance * seen.R_WB;
  spread_drift();
}

void SegmentFilter::forget(std::size_t detector) noexcept {
  const Eigen::Index at = place_at(detector);
  P_.middleRows<3>(at).setZero();
  P_.middleCols<3>(at).setZero();
  r_.col(static_cast<Eigen::Index>(detector)).setZero();
  placed_[detector] = 0;
  spread_drift();
}

void SegmentFilter::spread_drift() noexcept {
  // Where all places move as a rigid body they do not move on the limb: B moves. So the drift is
  // Pi = 1 - U (U'U)^-1 U', U the six rigid motions.
  Eigen::Matrix<double, 6, 6> N = Eigen::Matrix<double, 6, 6>::Zero();
  const auto U = [&](std::size_t i) {
    Eigen::Matrix<double, 3, 6> u;
    u << Eigen::Matrix3d::Identity(), -cross_matrix(r_.col(static_cast<Eigen::Index>(i)));
    return u;
  };
  for (std::size_t i = 0; i < placed_.size(); ++i) {
    if (placed_[i] != 0) N += U(i).transpose() * U(i);
  }
  N.diagonal().array() += 1e-9;  // fewer than three places, or three on a line
  const Eigen::Matrix<double, 6, 6> inverse =
      N.ldlt().solve(Eigen::Matrix<double, 6, 6>::Identity());
  drift_.setZero();
  for (std::size_t i = 0; i < placed_.size(); ++i) {
    for (std::size_t j = 0; j < placed_.size(); ++j) {
      if (placed_[i] == 0 || placed_[j] == 0) continue;
      Eigen::Matrix3d block = -(U(i) * inverse * U(j).transpose());
      if (i == j) block += Eigen::Matrix3d::Identity();
      drift_.block<3, 3>(3 * static_cast<Eigen::Index>(i), 3 * static_cast<Eigen::Index>(j)) =
          prior_.drift * prior_.drift * block;
    }
  }
}

void SegmentFilter::predict(double dt) noexcept {
  const Eigen::Vector3d turned = dt * w_ + 0.5 * dt * dt * dw_;
  const Eigen::Matrix3d turn = quaternion_from(turned).toRotationMatrix();
  const auto step = [&](Eigen::Index at, const Manoeuvre& m, Eigen::Vector3d& v,
                        Eigen::Vector3d& a) {
    const double T = m.memory, e = std::exp(-dt / T), d = -T * std::expm1(-dt / T);
    const double c = T * (dt - d);
    v += d * a;
    a *= e;
    // F P, then (F P) F'.
    if (at != 0) {
      for (Eigen::Index i = 0; i < P_.cols(); ++i) {
        P_.block<3, 1>(at, i) = (turn * P_.block<3, 1>(at, i)).eval();
      }
    }
    P_.middleRows<3>(at) += dt * P_.middleRows<3>(at + 3) + c * P_.middleRows<3>(at + 6);
    P_.middleRows<3>(at + 3) += d * P_.middleRows<3>(at + 6);
    P_.middleRows<3>(at + 6) *= e;
    if (at != 0) {
      for (Eigen::Index i = 0; i < P_.rows(); ++i) {
        P_.block<1, 3>(i, at) = (P_.block<1, 3>(i, at) * turn.transpose()).eval();
      }
    }
    P_.middleCols<3>(at) += dt * P_.middleCols<3>(at + 3) + c * P_.middleCols<3>(at + 6);
    P_.middleCols<3>(at + 3) += d * P_.middleCols<3>(at + 6);
    P_.middleCols<3>(at + 6) *= e;
    const double q = m.jerk * m.jerk, dt2 = dt * dt, dt3 = dt2 * dt;
    const auto add = [&](Eigen::Index i, Eigen::Index j, double variance) {
      for (int k = 0; k < 3; ++k) {
        P_(at + i + k, at + j + k) += variance;
        if (i != j) P_(at + j + k, at + i + k) += variance;
      }
    };
    add(0, 0, q * dt3 * dt2 / 20.0);
    add(0, 3, q * dt2 * dt2 / 8.0);
    add(0, 6, q * dt3 / 6.0);
    add(3, 3, q * dt3 / 3.0);
    add(3, 6, q * dt2 / 2.0);
    add(6, 6, q * dt);
  };
  p_ += dt * v_ + 0.5 * dt * dt * a_;
  q_ = (quaternion_from(turned) * q_).normalized();
  step(0, motion_.translation, v_, a_);
  step(9, motion_.rotation, w_, dw_);
  undrifted_ += dt;
  if (undrifted_ >= kDriftStep) {
    P_.bottomRightCorner(drift_.rows(), drift_.cols()) += undrifted_ * drift_;
    undrifted_ = 0.0;
    for (Eigen::Index i = 0; i < P_.rows(); ++i) {
      for (Eigen::Index j = 0; j < i; ++j) P_(i, j) = P_(j, i) = 0.5 * (P_(i, j) + P_(j, i));
    }
  }
}

void SegmentFilter::mix(SegmentFilter& a, SegmentFilter& b, double w_a, double w_b) noexcept {
  const Eigen::Vector3d turn = rotation_vector(a.q_ * b.q_.conjugate());
  Eigen::VectorXd& d = a.apart_;  // a - b
  d.segment<3>(0) = a.p_ - b.p_;
  d.segment<3>(3) = a.v_ - b.v_;
  d.segment<3>(6) = a.a_ - b.a_;
  d.segment<3>(9) = turn;
  d.segment<3>(12) = a.w_ - b.w_;
  d.segment<3>(15) = a.dw_ - b.dw_;
  for (Eigen::Index i = 0; i < a.r_.cols(); ++i) {
    d.segment<3>(kPose + 3 * i) = a.r_.col(i) - b.r_.col(i);
  }
  const double s_a = w_a * (1.0 - w_a), s_b = w_b * (1.0 - w_b);
  const Eigen::Index n = d.size();
  for (Eigen::Index c = 0; c < n; ++c) {
    double* const A = &a.P_(0, c);
    double* const B = &b.P_(0, c);
    for (Eigen::Index r = 0; r < n; ++r) {
      const double spread = d[r] * d[c], difference = A[r] - B[r], other = B[r];
      A[r] = other + w_a * difference + s_a * spread;
      B[r] = other + w_b * difference + s_b * spread;
    }
  }
  const auto move = [&](SegmentFilter& f, double share) {  // from b towards a
    f.p_ = b.p_ + share * d.segment<3>(0);
    f.v_ = b.v_ + share * d.segment<3>(3);
    f.a_ = b.a_ + share * d.segment<3>(6);
    f.q_ = (quaternion_from(share * turn) * b.q_).normalized();
    f.w_ = b.w_ + share * d.segment<3>(12);
    f.dw_ = b.dw_ + share * d.segment<3>(15);
    for (Eigen::Index i = 0; i < f.r_.cols(); ++i) {
      f.r_.col(i) = b.r_.col(i) + share * d.segment<3>(kPose + 3 * i);
    }
  };
  move(a, w_a);  // reads b, so b comes last
  move(b, w_b);
}

}  // namespace secondskin::server
