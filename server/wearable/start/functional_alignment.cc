#include "server/wearable/start/functional_alignment.h"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <utility>

#include "motion/kinematics.h"
#include "motion/rotation.h"

namespace secondskin::server {
namespace {

using Eigen::Vector3d;

constexpr double kLongest = 60.0;     // [s]
constexpr double kMoved = 0.3;        // [rad/s]
constexpr double kClear = 0.3;        // clarity that is enough
constexpr double kExcursion = 0.03;   // a mean turn that tells the side [rad]
constexpr double kAxisSigma = 0.09;   // how far a person's axis of bending is off the left-right
                                      // axis even when the movement is clear [rad]
constexpr double kLinkMargin = 0.15;  // of correlations

// Which way the larger turns about the body's left axis go: +1 top forward (bowing, knee bent, foot
// pointing), -1 the lower end forward (hip flexed, arm raised, elbow bent); 0: not a hinge.
double lopsided(Joint segment) noexcept {
  switch (segment) {
    case Joint::kPelvis:
    case Joint::kSpineLower:
    case Joint::kSpineMiddle:
    case Joint::kSpineUpper:
    case Joint::kNeck:
    case Joint::kHead:
    case Joint::kLeftKnee:
    case Joint::kRightKnee:
    case Joint::kLeftAnkle:
    case Joint::kRightAnkle:
    case Joint::kLeftToes:
    case Joint::kRightToes:
      return 1.0;
    case Joint::kLeftHip:
    case Joint::kRightHip:
    case Joint::kLeftShoulder:
    case Joint::kRightShoulder:
    case Joint::kLeftElbow:
    case Joint::kRightElbow:
    case Joint::kLeftWrist:
    case Joint::kRightWrist:
      return -1.0;
    default:
      return 0.0;
  }
}

Eigen::Matrix3d segment_at_rest(const Skeleton& canonical, const Pose& pose, Joint segment) {
  std::vector<Eigen::Isometry3d> X_WB(kJointCount);
  forward_kinematics(canonical, pose.p_WR, pose.q_PB, X_WB);
  return X_WB[index(segment)].linear();
}

// Correlation of how fast two boards turn.
double together(const Movement& movement, std::size_t a, std::size_t b) {
  const auto n = static_cast<double>(movement.size());
  double sa = 0, sb = 0, saa = 0, sbb = 0, sab = 0;
  for (std::size_t i = 0; i < movement.size(); ++i) {
    const double x = movement.rate(a, i).norm(), y = movement.rate(b, i).norm();
    sa += x;
    sb += y;
    saa += x * x;
    sbb += y * y;
    sab += x * y;
  }
  const double va = saa - sa * sa / n, vb = sbb - sb * sb / n;
  return va > 0.0 && vb > 0.0 ? (sab - sa * sb / n) / std::sqrt(va * vb) : 0.0;
}

}  // namespace

Movement::Movement(const Garment& garment, const Rest& rest)
    : rates_(garment.boards.size()),
      felt_(garment.boards.size(), 0),
      begin_ns_(rest.end_ns),
      last_ns_(rest.end_ns) {
  for (const BoardRest& board : rest.boards) offset_.push_back(board.gyro);
}

void Movement::add(const Measurement& measurement) {
  if (measurement.kind != MeasurementKind::kInertial || measurement.stamp_ns <= last_ns_ ||
      duration() >= kLongest) {
    return;
  }
  steps_.push_back(1e-9 * static_cast<double>(measurement.stamp_ns - last_ns_));
  last_ns_ = measurement.stamp_ns;
  for (std::size_t b = 0; b < rates_.size(); ++b) {
    const BoardReading* reading = b < measurement.boards.size() ? &measurement.boards[b] : nullptr;
    if (reading != nullptr && reading->gyro_valid && reading->gyro.allFinite()) {
      rates_[b].push_back(reading->gyro - offset_[b]);
      ++felt_[b];
    } else {
      rates_[b].push_back(rates_[b].empty() ? Vector3d::Zero() : rates_[b].back());
    }
  }
}

void Movement::reorder(std::span<const std::size_t> channel) {
  const auto rates = std::exchange(rates_, {});
  const auto felt = std::exchange(felt_, {});
  for (const std::size_t from : channel) {
    rates_.push_back(rates[from]);
    felt_.push_back(felt[from]);
  }
}

std::vector<BoardHeading> functional_headings(const Skeleton& canonical, const Garment& garment,
                                              const Pose& pose,
                                              std::span<const Eigen::Isometry3d> X_BS,
                                              const Movement& movement) {
  std::vector<BoardHeading> headings(garment.boards.size());
  if (movement.size() == 0) return headings;
  for (std::size_t b = 0; b < headings.size(); ++b) {
    BoardHeading& out = headings[b];
    const Joint segment = garment.boards[b].segment;
    if (!movement.felt(b) || lopsided(segment) == 0.0) continue;
    // Rates in V: the segment's frame at rest but for the unknown turn.
    const Eigen::Matrix3d R_VS = segment_at_rest(canonical, pose, segment) * X_BS[b].linear();
    Eigen::Matrix2d C = Eigen::Matrix2d::Zero();
    Eigen::Quaterniond q = Eigen::Quaterniond::Identity();  // of the board since the rest, in V
    Vector3d turned = Vector3d::Zero();
    double time = 0.0;
    for (std::size_t i = 0; i < movement.size(); ++i) {
      const double dt = movement.step(i);
      const Vector3d w = R_VS * movement.rate(b, i);
      C += dt * w.head<2>() * w.head<2>().transpose();
      q = (q * quaternion_from(w * dt)).normalized();
      turned += dt * rotation_vector(q);
      time += dt;
    }
    const Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d> spread(C / time);
    const Eigen::Vector2d axis = spread.eigenvectors().col(1);
    const double least = std::max(0.0, spread.eigenvalues()[0]), most = spread.eigenvalues()[1];
    out.moved = std::sqrt(least + most);
    out.clarity = most > 0.0 ? 1.0 - std::sqrt(least / most) : 0.0;
    double angle = std::atan2(axis.y(), axis.x());
    out.excursion = axis.dot(turned.head<2>()) / time * lopsided(segment);
    if (out.excursion < 0.0) {
      angle += std::numbers::pi;
      out.excursion = -out.excursion;
    }
    // The axis should point to the left, y.
    out.turn = std::remainder(0.5 * std::numbers::pi - angle, 2.0 * std::numbers::pi);
    out.found = out.moved > kMoved && out.clarity > kClear && out.excursion > kExcursion;
    out.sigma = out.found ? std::hypot(kAxisSigma, 0.35 * (1.0 - out.clarity)) : std::numbers::pi;
  }
  return headings;
}

void turn_about_vertical(const Skeleton& canonical, const SensorBoard& board, const Pose& pose,
                         double turn, Eigen::Isometry3d& X_BS) {
  const Eigen::Matrix3d R_WB = segment_at_rest(canonical, pose, board.segment);
  X_BS.linear() = R_WB.transpose() * Eigen::AngleAxisd(turn, Vector3d::UnitZ()).toRotationMatrix() *
                  R_WB * X_BS.linear();
}

std::vector<Swap> swapped_by_movement(const Garment& garment, const Movement& movement) {
  constexpr std::array kLimbs{
      std::array{Joint::kLeftHip, Joint::kLeftKnee, Joint::kLeftAnkle},
      std::array{Joint::kLeftShoulder, Joint::kLeftElbow, Joint::kLeftWrist}};
  const auto pairs = mirrored_boards(garment);
  std::vector<Swap> swaps;
  for (const auto& limb : kLimbs) {
    std::vector<std::pair<std::size_t, std::size_t>> chain;
    for (const Joint segment : limb) {
      for (const auto& pair : pairs) {
        const bool felt = movement.felt(pair.first) && movement.felt(pair.second);
        if (felt && garment.boards[pair.first].segment == segment) chain.push_back(pair);
      }
    }
    std::vector<double> links;  // > 0: each with its own side
    for (std::size_t i = 0; i + 1 < chain.size(); ++i) {
      const auto &a = chain[i], &b = chain[i + 1];
      links.push_back(
          0.5 * (together(movement, a.first, b.first) + together(movement, a.second, b.second) -
                 together(movement, a.first, b.second) - together(movement, a.second, b.first)));
    }
    const auto crossed = [&](std::size_t i) { return links[i] < -kLinkMargin; };
    const auto straight = [&](std::size_t i) { return links[i] > kLinkMargin; };
    const auto name = [&](std::size_t i, double evidence) {
      swaps.push_back({chain[i].first, chain[i].second, evidence});
    };
    if (chain.size() == 2 && crossed(0)) {
      name(0, links[0]);
      name(1, links[0]);
    } else if (chain.size() == 3) {
      if (crossed(0) && crossed(1)) name(1, std::max(links[0], links[1]));
      if (crossed(0) && straight(1)) name(0, links[0]);
      if (straight(0) && crossed(1)) name(2, links[1]);
    }
  }
  return swaps;
}

}  // namespace secondskin::server
