#include "coach/score/joint_movement.h"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <limits>

#include "motion/rotation.h"

namespace secondskin::coach {
namespace {

constexpr double kThreshold = 0.05;   // of the spectrum's peak: SPARC's V-bar
constexpr double kLongestGap = 0.25;  // what happened in a longer one is not known [s]

bool known(const Pose& pose, std::size_t j) noexcept {
  return j < pose.q_PB.size() && j < pose.confidence.size() && pose.confidence[j] > 0.0F &&
         pose.q_PB[j].coeffs().allFinite();
}

// A joint's orientation; of the pelvis without its heading.
Eigen::Quaterniond orientation(const Pose& pose, std::size_t j) noexcept {
  const Eigen::Quaterniond& q = pose.q_PB[j];
  if (j != index(Joint::kPelvis)) return q;
  const double heading = twist_angle(q, Eigen::Vector3d::UnitZ());
  return Eigen::AngleAxisd(-heading, Eigen::Vector3d::UnitZ()) * q;
}

}  // namespace

ReferenceCurves reference_curves(const Motion& motion) {
  ReferenceCurves curves;
  curves.curve.resize(motion.poses.size());
  for (std::size_t j = 0; j < kJointCount; ++j) {
    // The mean quaternion: the eigenvector of the greatest eigenvalue of the sum of q q' (Markley
    // et al. 2007, J. Guid. Control Dyn. 30:1193).
    Eigen::Matrix4d sum = Eigen::Matrix4d::Zero();
    for (const Pose& pose : motion.poses) {
      if (!known(pose, j)) continue;
      const Eigen::Vector4d q = orientation(pose, j).coeffs();
      sum += q * q.transpose();
    }
    const Eigen::SelfAdjointEigenSolver<Eigen::Matrix4d> mean(sum);
    curves.q_PM[j] = sum.isZero() ? Eigen::Quaterniond::Identity()
                                  : Eigen::Quaterniond(Eigen::Vector4d(mean.eigenvectors().col(3)));
    curves.q_PM[j].normalize();

    Eigen::Vector3d centre = Eigen::Vector3d::Zero(), last = Eigen::Vector3d::Zero();
    for (std::size_t i = 0; i < motion.poses.size(); ++i) {
      if (known(motion.poses[i], j)) {
        last = rotation_vector(curves.q_PM[j].conjugate() * orientation(motion.poses[i], j));
      }
      curves.curve[i][j] = last;
      centre += last / static_cast<double>(motion.poses.size());
    }
    Eigen::Matrix3d covariance = Eigen::Matrix3d::Zero();
    for (const auto& frame : curves.curve) {
      covariance += (frame[j] - centre) * (frame[j] - centre).transpose();
    }
    const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> main(covariance);
    curves.axis[j] = main.eigenvectors().col(2);
    double least = std::numeric_limits<double>::infinity(), greatest = -least;
    for (const auto& frame : curves.curve) {
      least = std::min(least, curves.axis[j].dot(frame[j]));
      greatest = std::max(greatest, curves.axis[j].dot(frame[j]));
    }
    curves.range[j] = greatest - least;
  }
  return curves;
}

JointMovement::JointMovement(const Reference& reference)
    : curves_(reference_curves(reference.motion)),
      real_(kJointCount * kBins),
      imaginary_(kJointCount * kBins),
      last_(kJointCount) {}

void JointMovement::update(double time, double reference_time, const Pose& pose) noexcept {
  const double last_frame = static_cast<double>(curves_.curve.size() - 1);
  const double frame = std::clamp(reference_time * kReferenceRate, 0.0, last_frame);
  const double dt = time - last_time_;
  bool turned = false;
  for (std::size_t j = 0; j < kJointCount; ++j) {
    turned_[j] = 0.0;
    if (!known(pose, j)) {
      have_last_[j] = false;
      continue;
    }
    const Eigen::Quaterniond q = orientation(pose, j);
    if (begun_ && have_last_[j] && dt > 0.0 && dt <= kLongestGap) {
      turned_[j] = geodesic_distance(last_.q_PB[j], q);
      turned = true;
    }
    last_.q_PB[j] = q;
    have_last_[j] = true;

    const Eigen::Vector3d x = rotation_vector(curves_.q_PM[j].conjugate() * q);
    Joint& joint = joints_[j];
    const Eigen::Vector4d along(curves_.axis[j].dot(x), x.x(), x.y(), x.z());
    if (joint.count > 0.0) {
      joint.least = joint.least.cwiseMin(along);
      joint.greatest = joint.greatest.cwiseMax(along);
    } else {
      joint.least = joint.greatest = along;
    }
    joint.count += 1.0;
    joint.sum += x;
    joint.square += x.squaredNorm();
    if (curves_.range[j] >= kLeastRange) add_to_lags(j, frame, x);
  }
  if (turned) add_to_spectrum(0.5 * (time + last_time_));
  last_time_ = time;
  begun_ = true;
}

void JointMovement::add_to_lags(std::size_t joint, double frame,
                                const Eigen::Vector3d& x) noexcept {
  const auto last = static_cast<std::ptrdiff_t>(curves_.curve.size()) - 1;
  const auto before = static_cast<std::ptrdiff_t>(frame);
  const double u = frame - static_cast<double>(before);
  for (int l = -kLags; l <= kLags; ++l) {
    const std::ptrdiff_t at = before + l * kLagStep;
    const auto a = static_cast<std::size_t>(std::clamp<std::ptrdiff_t>(at, 0, last));
    const auto b = static_cast<std::size_t>(std::clamp<std::ptrdiff_t>(at + 1, 0, last));
    const Eigen::Vector3d r = (1.0 - u) * curves_.curve[a][joint] + u * curves_.curve[b][joint];
    Lag& lag = lags_[joint][static_cast<std::size_t>(l + kLags)];
    lag.sum += r;
    lag.square += r.squaredNorm();
    lag.product += x.dot(r);
  }
}

void JointMovement::add_to_spectrum(double time) noexcept {
  // cos and sin of all multiples of one angle by turning on.
  const double step = 2.0 * std::numbers::pi * kBinWidth * time;
  const double c = std::cos(step), s = std::sin(step);
  double x = 1.0, y = 0.0;
  for (std::size_t k = 0; k < kBins; ++k) {
    cosine_[k] = static_cast<float>(x);
    sine_[k] = static_cast<float>(y);
    const double next = x * c - y * s;
    y = x * s + y * c;
    x = next;
  }
  for (std::size_t j = 0; j < kJointCount; ++j) {
    const auto angle = static_cast<float>(turned_[j]);
    if (!(angle > 0.0F)) continue;
    float* real = real_.data() + j * kBins;
    float* imaginary = imaginary_.data() + j * kBins;
    for (std::size_t k = 0; k < kBins; ++k) {
      real[k] += angle * cosine_[k];
      imaginary[k] += angle * sine_[k];
    }
  }
}

double JointMovement::range(std::size_t joint) const noexcept {
  const Eigen::Vector4d ranges = joints_[joint].greatest - joints_[joint].least;
  return curves_.range[joint] >= kLeastRange ? ranges[0] : ranges.tail<3>().maxCoeff();
}

std::optional<double> JointMovement::timing_error(std::size_t joint) const noexcept {
  const Joint& own = joints_[joint];
  if (!(own.count > 0.0) || curves_.range[joint] < kLeastRange || range(joint) < kLeastRange) {
    return std::nullopt;
  }
  // Mean square distance of the curves once both have lost their means. Equation 5.
  std::array<double, kLagCount> distance{};
  for (std::size_t l = 0; l < kLagCount; ++l) {
    const Lag& lag = lags_[joint][l];
    distance[l] = (own.square - 2.0 * lag.product + lag.square) / own.count -
                  ((own.sum - lag.sum) / own.count).squaredNorm();
  }
  // The nearest of equals, so that none is found where there is nothing to tell.
  constexpr auto kMiddle = static_cast<std::size_t>(kLags);
  std::size_t best = kMiddle;
  for (std::size_t off = 1; off <= kMiddle; ++off) {
    for (const std::size_t l : {kMiddle - off, kMiddle + off}) {
      if (distance[l] < distance[best]) best = l;
    }
  }
  double at = static_cast<double>(best) - static_cast<double>(kMiddle);
  if (best > 0 && best + 1 < kLagCount) {
    const double bend = distance[best - 1] - 2.0 * distance[best] + distance[best + 1];
    if (bend > 0.0) at += 0.5 * (distance[best - 1] - distance[best + 1]) / bend;
  }
  return -at * kLagStep / kReferenceRate;
}

std::optional<double> JointMovement::smoothness(std::size_t joint) const noexcept {
  if (!(joints_[joint].count > 0.0) || range(joint) < kLeastRange) return std::nullopt;
  const float* real = real_.data() + joint * kBins;
  const float* imaginary = imaginary_.data() + joint * kBins;
  const auto at = [&](std::size_t k) {
    return static_cast<double>(std::hypot(real[k], imaginary[k]));
  };
  const double whole = at(0);  // a speed is never negative, so this is the greatest
  if (!(whole > 0.0)) return std::nullopt;
  std::size_t cut = kBins - 1;
  while (cut > 1 && at(cut) < kThreshold * whole) --cut;
  double length = 0.0;
  for (std::size_t k = 1; k <= cut; ++k) {
    length += std::hypot(1.0 / static_cast<double>(cut), (at(k) - at(k - 1)) / whole);
  }
  return -length;
}

void JointMovement::clear() noexcept {
  joints_ = {};
  lags_ = {};
  std::fill(real_.begin(), real_.end(), 0.0F);
  std::fill(imaginary_.begin(), imaginary_.end(), 0.0F);
  have_last_ = {};
  begun_ = false;
}

}  // namespace secondskin::coach
