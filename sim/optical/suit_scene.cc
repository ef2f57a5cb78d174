#include "sim/optical/suit_scene.h"

#include <algorithm>
#include <cassert>
#include <cmath>
#include <stdexcept>

namespace secondskin::sim {
namespace {

// Squared distance of two line segments. Ericson, "Real-Time Collision Detection" (2005), 5.1.9.
double squared_distance(const Eigen::Vector3d& p1, const Eigen::Vector3d& q1,
                        const Eigen::Vector3d& p2, const Eigen::Vector3d& q2) noexcept {
  const Eigen::Vector3d d1 = q1 - p1, d2 = q2 - p2, r = p1 - p2;
  const double a = d1.squaredNorm(), e = d2.squaredNorm(), f = d2.dot(r);
  constexpr double kTiny = 1e-12;
  double s = 0.0, t = 0.0;
  if (a <= kTiny && e <= kTiny) return r.squaredNorm();
  if (a <= kTiny) {
    t = std::clamp(f / e, 0.0, 1.0);
  } else {
    const double c = d1.dot(r);
    if (e <= kTiny) {
      s = std::clamp(-c / a, 0.0, 1.0);
    } else {
      const double b = d1.dot(d2);
      const double denominator = a * e - b * b;
      if (denominator > kTiny) s = std::clamp((b * f - c * e) / denominator, 0.0, 1.0);
      t = (b * s + f) / e;
      if (t < 0.0) {
        t = 0.0;
        s = std::clamp(-c / a, 0.0, 1.0);
      } else if (t > 1.0) {
        t = 1.0;
        s = std::clamp((b - c) / a, 0.0, 1.0);
      }
    }
  }
  return (r + s * d1 - t * d2).squaredNorm();
}

bool are_neighbours(Joint a, Joint b) noexcept {
  return canonical_anatomy()[index(a)].parent == b || canonical_anatomy()[index(b)].parent == a;
}

}  // namespace

SuitScene::SuitScene(Motion canonical, const Suit& suit, AtEnd at_end)
    : motion_(std::move(canonical)), at_end_(at_end) {
  if (!is_canonical(motion_.skeleton) || motion_.poses.empty() || !(motion_.rate_hz > 0.0)) {
    throw std::invalid_argument("suit scene: expected a canonical motion with poses");
  }
  for (const SuitDetector& detector : suit.detectors) {
    places_.push_back(
        skin_place(motion_.skeleton, detector.segment, detector.along, detector.angle));
    segments_.push_back(detector.segment);
  }
  for (std::size_t i = 0; i < kJointCount; ++i) {
    capsules_[i] = segment_capsule(motion_.skeleton, static_cast<Joint>(i));
    limbs_[i] = {Eigen::Vector3d::Zero(), Eigen::Vector3d::Zero(), capsules_[i].radius};
  }
  pose_ = Pose(kJointCount);
  X_WB_.resize(kJointCount, Eigen::Isometry3d::Identity());
  p_WS_.resize(places_.size(), Eigen::Vector3d::Zero());
}

void SuitScene::pose_at(double time, Pose& out) const {
  const double duration = motion_.duration();
  if (time > duration && duration > 0.0) {
    if (at_end_ == AtEnd::kLoop) {
      time = std::fmod(time, duration);
    } else if (at_end_ == AtEnd::kThereAndBack) {
      time = std::fmod(time, 2.0 * duration);
      if (time > duration) time = 2.0 * duration - time;
    }
  }
  sample(motion_, time, out);
}

void SuitScene::at(double time, std::span<DetectorState> states) {
  assert(states.size() == places_.size());
  pose_at(time, pose_);
  forward_kinematics(motion_.skeleton, pose_.p_WR, pose_.q_PB, X_WB_);
  for (std::size_t i = 0; i < kJointCount; ++i) {
    limbs_[i].p_WA = X_WB_[i] * capsules_[i].p_BA;
    limbs_[i].p_WE = X_WB_[i] * capsules_[i].p_BE;
  }
  for (std::size_t i = 0; i < places_.size(); ++i) {
    const Eigen::Isometry3d& X_WB = X_WB_[index(segments_[i])];
    p_WS_[i] = X_WB * places_[i].p_BS;
    states[i] = {p_WS_[i], X_WB.linear() * places_[i].n_B};
  }
}

bool SuitScene::hidden(std::size_t detector, const Eigen::Vector3d& p_W) const {
  const Joint own = segments_[detector];
  const Eigen::Vector3d& p_WS = p_WS_[detector];
  const Eigen::Vector3d ray = p_W - p_WS;
  const double length = ray.norm();
  if (length == 0.0) return false;
  for (std::size_t i = 0; i < kJointCount; ++i) {
    if (i == index(own)) continue;  // its own normal tells that
    const Limb& limb = limbs_[i];
    // Far from the ray altogether?
    const Eigen::Vector3d to_middle = 0.5 * (limb.p_WA + limb.p_WE) - p_WS;
    const double reach = 0.5 * (limb.p_WE - limb.p_WA).norm() + limb.radius;
    const double along = std::clamp(to_middle.dot(ray) / length, 0.0, length);
    if ((to_middle - (along / length) * ray).squaredNorm() > reach * reach) continue;
    const double radius2 = limb.radius * limb.radius;
    if (squared_distance(p_WS, p_W, limb.p_WA, limb.p_WE) >= radius2) continue;
    // Where neighbours overlap at their joint, the skin is the outer of the two.
    if (are_neighbours(own, static_cast<Joint>(i)) &&
        squared_distance(p_WS, p_WS, limb.p_WA, limb.p_WE) < radius2) {
      continue;
    }
    return true;
  }
  return false;
}

Motion recentred(Motion motion, double sigma) {
  const auto count = static_cast<std::ptrdiff_t>(motion.poses.size());
  std::vector<Eigen::Vector2d> path;
  path.reserve(motion.poses.size());
  Eigen::Vector2d mean = Eigen::Vector2d::Zero();
  for (const Pose& pose : motion.poses) {
    path.push_back(pose.p_WR.head<2>());
    mean += path.back() / static_cast<double>(count);
  }
  // Beyond its ends the path goes on as it came, turned by half about the end.
  const auto at = [&](std::ptrdiff_t i) -> Eigen::Vector2d {
    const std::ptrdiff_t last = count - 1;
    if (i < 0) return 2.0 * path.front() - path[static_cast<std::size_t>(std::min(-i, last))];
    if (i > last) {
      return 2.0 * path.back() -
             path[static_cast<std::size_t>(std::max(2 * last - i, std::ptrdiff_t{0}))];
    }
    return path[static_cast<std::size_t>(i)];
  };
  const bool mean_only = !std::isfinite(sigma);
  constexpr double kReach = 4.0;  // in sigmas
  const auto reach =
      mean_only ? std::ptrdiff_t{0} : static_cast<std::ptrdiff_t>(kReach * sigma * motion.rate_hz);
  std::vector<double> weight;
  for (std::ptrdiff_t k = 0; k <= reach; ++k) {
    const double z = static_cast<double>(k) / (sigma * motion.rate_hz);
    weight.push_back(std::exp(-0.5 * z * z));
  }
  for (std::ptrdiff_t i = 0; i < count; ++i) {
    Eigen::Vector2d slow = mean;
    if (!mean_only) {
      double total = weight[0];
      slow = weight[0] * at(i);
      for (std::ptrdiff_t k = 1; k <= reach; ++k) {
        slow += weight[static_cast<std::size_t>(k)] * (at(i - k) + at(i + k));
        total += 2.0 * weight[static_cast<std::size_t>(k)];
      }
      slow /= total;
    }
    motion.poses[static_cast<std::size_t>(i)].p_WR.head<2>() -= slow;
  }
  return motion;
}

}  // namespace secondskin::sim
