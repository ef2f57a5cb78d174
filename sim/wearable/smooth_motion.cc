#include "sim/wearable/smooth_motion.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "motion/kinematics.h"
#include "motion/rotation.h"

namespace secondskin::sim {
namespace {

constexpr double kRate = 120.0;  // of the control points [Hz]
constexpr double kRamp = 0.5;    // in which the motion reaches its speed [s]

double lowest_foot(const Skeleton& skeleton, const Pose& pose) {
  std::array<Eigen::Isometry3d, kJointCount> X_WB;
  forward_kinematics(skeleton, pose.p_WR, pose.q_PB, X_WB);
  double lowest = INFINITY;
  for (const Joint joint :
       {Joint::kLeftAnkle, Joint::kLeftToes, Joint::kRightAnkle, Joint::kRightToes}) {
    const std::size_t i = index(joint);
    lowest = std::min({lowest, X_WB[i].translation().z(), (X_WB[i] * skeleton[i].p_BE).z()});
  }
  return lowest;
}

// 0 to 1 with two continuous derivatives.
double smooth_step(double u) {
  u = std::clamp(u, 0.0, 1.0);
  return u * u * u * (10.0 - 15.0 * u + 6.0 * u * u);
}

// Turns about the vertical and moves so that the first pose stands at x = y = 0 facing +x.
void put_at_origin(Motion& motion) {
  const Pose first = motion.poses.front();
  const double heading = twist_angle(first.q_PB[0], Eigen::Vector3d::UnitZ());
  const Eigen::Quaterniond turn(Eigen::AngleAxisd(-heading, Eigen::Vector3d::UnitZ()));
  const Eigen::Vector3d origin(first.p_WR.x(), first.p_WR.y(), 0.0);
  for (Pose& pose : motion.poses) {
    pose.p_WR = turn * (pose.p_WR - origin);
    pose.q_PB[0] = turn * pose.q_PB[0];
  }
}

// Imaginary part of conj(a) * b for quaternions stored x, y, z, w.
Eigen::Vector3d im(const Eigen::Vector4d& a, const Eigen::Vector4d& b) noexcept {
  return a.w() * b.head<3>() - b.w() * a.head<3>() -
         Eigen::Vector3d(a.head<3>()).cross(Eigen::Vector3d(b.head<3>()));
}

}  // namespace

SplineWeights::SplineWeights(double u) noexcept {
  const double v = 1.0 - u;
  value = {v * v * v / 6.0, (4.0 - 6.0 * u * u + 3.0 * u * u * u) / 6.0,
           (4.0 - 6.0 * v * v + 3.0 * v * v * v) / 6.0, u * u * u / 6.0};
  first = {-0.5 * v * v, -2.0 * u + 1.5 * u * u, 2.0 * v - 1.5 * v * v, 0.5 * u * u};
  second = {v, -2.0 + 3.0 * u, -2.0 + 3.0 * v, u};
}

SmoothMotion::SmoothMotion(const Motion& canonical, double rest, double blend, double cutoff_hz)
    : skeleton_(canonical.skeleton) {
  if (!is_canonical(skeleton_) || canonical.poses.empty() || !(canonical.rate_hz > 0.0)) {
    throw std::invalid_argument("smooth motion: expected a canonical motion with poses");
  }
  if (!(rest >= 0.0) || !(blend >= 0.0) || !(cutoff_hz > 0.0)) {
    throw std::invalid_argument(
        "smooth motion: expected times and a cut-off that are not negative");
  }
  Motion motion = canonical;
  put_at_origin(motion);
  floor_ = lowest_foot(skeleton_, motion.poses.front());
  Pose standing(kJointCount);
  standing.p_WR.z() = floor_ - lowest_foot(skeleton_, standing);

  // Time on the motion's own clock: even acceleration over kRamp at both ends.
  const double length = motion.duration();
  const double ramp = std::min(kRamp, length);
  const double moving = length + ramp;
  const auto warped = [&](double t) {
    if (ramp == 0.0 || t <= 0.0) return 0.0;
    if (t >= moving) return length;
    if (t < ramp) return 0.5 * t * t / ramp;
    if (t > moving - ramp) return length - 0.5 * (moving - t) * (moving - t) / ramp;
    return t - 0.5 * ramp;
  };
  duration_ = rest + blend + moving;

  const auto steps = static_cast<std::ptrdiff_t>(std::ceil(duration_ * kRate)) + 4;
  std::vector<Control> raw(static_cast<std::size_t>(steps));
  Pose pose(kJointCount);
  for (std::ptrdiff_t k = 0; k < steps; ++k) {
    const double time = static_cast<double>(k - 1) / kRate;
    const double begun = time - rest - blend;
    if (begun < 0.0) {
      const double u = blend > 0.0 ? smooth_step((time - rest) / blend) : 0.0;
      interpolate(standing, motion.poses.front(), u, pose);
    } else {
      sample(motion, warped(begun), pose);
    }
    Control& control = raw[static_cast<std::size_t>(k)];
    control.p_WR = pose.p_WR;
    for (std::size_t j = 0; j < kJointCount; ++j) {
      control.q[j] = pose.q_PB[j].coeffs();
      if (k > 0 && control.q[j].dot(raw[static_cast<std::size_t>(k - 1)].q[j]) < 0.0) {
        control.q[j] = -control.q[j];
      }
    }
  }

  const double sigma = std::sqrt(std::numbers::ln2) / (2.0 * std::numbers::pi * cutoff_hz) * kRate;
  const auto reach = static_cast<std::ptrdiff_t>(std::ceil(4.0 * sigma));
  std::vector<double> weight;
  double total = 0.0;
  for (std::ptrdiff_t k = -reach; k <= reach; ++k) {
    const double z = static_cast<double>(k) / sigma;
    total += weight.emplace_back(std::exp(-0.5 * z * z));
  }
  controls_.resize(raw.size());
  for (std::ptrdiff_t k = 0; k < steps; ++k) {
    Control& out = controls_[static_cast<std::size_t>(k)];
    out.p_WR.setZero();
    out.q.fill(Eigen::Vector4d::Zero());
    for (std::ptrdiff_t i = -reach; i <= reach; ++i) {
      const Control& in =
          raw[static_cast<std::size_t>(std::clamp(k + i, std::ptrdiff_t{0}, steps - 1))];
      const double share = weight[static_cast<std::size_t>(i + reach)] / total;
      out.p_WR += share * in.p_WR;
      for (std::size_t j = 0; j < kJointCount; ++j) out.q[j] += share * in.q[j];
    }
    for (Eigen::Vector4d& q : out.q) q.normalize();
  }
}

SmoothMotion::Span SmoothMotion::span(double time) const noexcept {
  const double x = std::clamp(time, 0.0, duration_) * kRate;
  const double whole = std::floor(x);
  return {static_cast<std::size_t>(whole), SplineWeights(x - whole)};
}

void SmoothMotion::pose_at(double time, Pose& out) const {
  const Span s = span(time);
  out.q_PB.resize(kJointCount);
  out.confidence.assign(kJointCount, 1.0f);
  out.p_WR.setZero();
  for (std::size_t k = 0; k < 4; ++k) {
    out.p_WR += s.weights.value[k] * controls_[s.first + k].p_WR;
  }
  for (std::size_t j = 0; j < kJointCount; ++j) {
    Eigen::Vector4d r = Eigen::Vector4d::Zero();
    for (std::size_t k = 0; k < 4; ++k) r += s.weights.value[k] * controls_[s.first + k].q[j];
    out.q_PB[j].coeffs() = r.normalized();
  }
}

void SmoothMotion::at(double time, BodyMotion& out) const noexcept {
  const Span s = span(time);
  const bool held = time < 0.0 || time > duration_;
  const double rate = held ? 0.0 : kRate;
  for (std::size_t j = 0; j < kJointCount; ++j) {
    Eigen::Vector4d r = Eigen::Vector4d::Zero(), r1 = r, r2 = r;
    for (std::size_t k = 0; k < 4; ++k) {
      const Eigen::Vector4d& q = controls_[s.first + k].q[j];
      r += s.weights.value[k] * q;
      r1 += (rate * s.weights.first[k]) * q;
      r2 += (rate * rate * s.weights.second[k]) * q;
    }
    const double norm2 = r.squaredNorm();
    const Eigen::Vector3d w_PB_B = (2.0 / norm2) * im(r, r1);
    const Eigen::Vector3d alpha_B = (2.0 / norm2) * im(r, r2) - (2.0 * r.dot(r1) / norm2) * w_PB_B;
    Eigen::Quaterniond q_PB;
    q_PB.coeffs() = r / std::sqrt(norm2);
    const Eigen::Matrix3d R_PB = q_PB.toRotationMatrix();
    SegmentMotion& own = out[j];
    const auto& parent = skeleton_[j].parent;
    if (!parent) {
      own.v.setZero();
      own.a.setZero();
      Eigen::Vector3d p = Eigen::Vector3d::Zero();
      for (std::size_t k = 0; k < 4; ++k) {
        const Eigen::Vector3d& p_WR = controls_[s.first + k].p_WR;
        p += s.weights.value[k] * p_WR;
        own.v += (rate * s.weights.first[k]) * p_WR;
        own.a += (rate * rate * s.weights.second[k]) * p_WR;
      }
      own.X_WB = Eigen::Translation3d(p) * Eigen::Isometry3d(R_PB);
      own.w = R_PB * w_PB_B;
      own.alpha = R_PB * alpha_B;
      continue;
    }
    const SegmentMotion& P = out[*parent];
    const Eigen::Vector3d arm = P.X_WB.linear() * skeleton_[j].p_PB;
    own.X_WB.linear() = P.X_WB.linear() * R_PB;
    own.X_WB.translation() = P.X_WB.translation() + arm;
    own.X_WB.makeAffine();
    own.v = P.v + P.w.cross(arm);
    own.a = P.a + P.alpha.cross(arm) + P.w.cross(P.w.cross(arm));
    const Eigen::Vector3d w_PB_W = own.X_WB.linear() * w_PB_B;
    own.w = P.w + w_PB_W;
    own.alpha = P.alpha + own.X_WB.linear() * alpha_B + P.w.cross(w_PB_W);
  }
}

}  // namespace secondskin::sim
