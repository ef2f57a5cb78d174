#include "server/wearable/start/functional_alignment.h"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <numeric>
#include <optional>
#include <utility>

#include "motion/kinematics.h"
#include "motion/rotation.h"

namespace secondskin::server {
namespace {

using Eigen::Vector3d;

constexpr double kLongest = 60.0;       // [s]
constexpr double kMoved = 0.3;          // [rad/s]
constexpr double kClear = 0.3;          // clarity that is enough
constexpr double kExcursion = 0.03;     // a mean turn that tells the side [rad]
constexpr double kAxisSigma = 0.09;     // how far a person's axis of bending is off the left-right
                                        // axis even when the movement is clear [rad]
constexpr double kBendingSigma = 0.35;  // the same of any movement, knees apart [rad]
constexpr double kBand = 5.0;           // [Hz]
constexpr double kSlow = 1.0;           // [s]
constexpr double kAlike = 0.5;          // of a joint's acceleration by both boards
constexpr double kLively = 0.3;         // [m/s^2]
// Of a link, by how it was off over virtual movements: soft tissue, joints between that bend.
constexpr double kLinkSigma = 0.08, kUnlikeness = 0.6;
constexpr double kLinkMargin = 0.2;  // of correlations

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

// The board of the nearest segment towards the root.
std::optional<std::size_t> parent_board(const Skeleton& canonical, const Garment& garment,
                                        const Movement& movement, Joint segment) {
  for (auto at = canonical[index(segment)].parent; at; at = canonical[*at].parent) {
    for (std::size_t b = 0; b < garment.boards.size(); ++b) {
      if (index(garment.boards[b].segment) == *at && movement.felt(b)) return b;
    }
  }
  return std::nullopt;
}

// Running mean over 2 * half + 1 samples.
std::vector<Vector3d> smoothed(const std::vector<Vector3d>& x, std::size_t half) {
  std::vector<Vector3d> out(x.size());
  Vector3d sum = Vector3d::Zero();
  std::size_t begin = 0, end = 0;
  for (std::size_t i = 0; i < x.size(); ++i) {
    for (; end < std::min(x.size(), i + half + 1); ++end) sum += x[end];
    for (; begin + half < i; ++begin) sum -= x[begin];
    out[i] = sum / static_cast<double>(end - begin);
  }
  return out;
}

// Horizontal acceleration of a point that moves with a board, in the band in which neither noise
// and soft tissue nor the gyroscopes' drift count. a_J = a_S + w' x r + w x (w x r).
// @param X_WS  the board at rest; the axes of the result are W's
std::vector<Eigen::Vector2d> joint_acceleration(const Movement& movement, std::size_t board,
                                                const Eigen::Isometry3d& X_WS,
                                                const Vector3d& p_WJ) {
  const std::size_t n = movement.size();
  const double rate = static_cast<double>(n) / movement.duration();
  const auto half = [&](double seconds) {
    return std::max<std::size_t>(1, static_cast<std::size_t>(std::lround(0.5 * seconds * rate)));
  };
  std::vector<Vector3d> w(n), turning(n, Vector3d::Zero()), a(n);
  for (std::size_t i = 0; i < n; ++i) w[i] = movement.rate(board, i);
  w = smoothed(w, half(0.03));
  for (std::size_t i = 1; i + 1 < n; ++i) {
    turning[i] = (w[i + 1] - w[i - 1]) / (movement.step(i) + movement.step(i + 1));
  }
  const Vector3d r = X_WS.inverse() * p_WJ;
  Eigen::Quaterniond q_WS(X_WS.linear());
  for (std::size_t i = 0; i < n; ++i) {
    q_WS = (q_WS * quaternion_from(movement.rate(board, i) * movement.step(i))).normalized();
    a[i] = q_WS * (movement.force(board, i) + turning[i].cross(r) + w[i].cross(w[i].cross(r)));
  }
  const auto quick = smoothed(a, half(0.5 / kBand)), slow = smoothed(a, half(kSlow));
  std::vector<Eigen::Vector2d> out(n);
  for (std::size_t i = 0; i < n; ++i) out[i] = (quick[i] - slow[i]).head<2>();
  return out;
}

}  // namespace

Movement::Movement(const Garment& garment, const Rest& rest)
    : rates_(garment.boards.size()),
      forces_(garment.boards.size()),
      felt_(garment.boards.size(), 0),
      begin_ns_(rest.end_ns),
      last_ns_(rest.end_ns) {
  for (const BoardRest& board : rest.boards) {
    offset_.push_back(board.gyro);
    accel_.push_back(board.accel);
  }
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
    if (reading != nullptr && reading->accel_valid && reading->accel.allFinite()) {
      forces_[b].push_back(reading->accel);
    } else {
      forces_[b].push_back(forces_[b].empty() ? accel_[b] : forces_[b].back());
    }
  }
}

void Movement::reorder(std::span<const std::size_t> channel) {
  const auto rates = std::exchange(rates_, {});
  const auto forces = std::exchange(forces_, {});
  const auto felt = std::exchange(felt_, {});
  for (const std::size_t from : channel) {
    rates_.push_back(rates[from]);
    forces_.push_back(forces[from]);
    felt_.push_back(felt[from]);
  }
}

std::vector<BoardHeading> bending_headings(const Skeleton& canonical, const Garment& garment,
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

std::vector<HeadingLink> joint_headings(const Skeleton& canonical, const Garment& garment,
                                        const Pose& pose, std::span<const Eigen::Isometry3d> X_BS,
                                        const Movement& movement) {
  std::vector<HeadingLink> links;
  if (movement.size() < 10) return links;
  std::vector<Eigen::Isometry3d> X_WB(kJointCount);
  forward_kinematics(canonical, pose.p_WR, pose.q_PB, X_WB);
  for (std::size_t child = 0; child < garment.boards.size(); ++child) {
    if (!movement.felt(child)) continue;
    const Joint segment = garment.boards[child].segment;
    const auto parent = parent_board(canonical, garment, movement, segment);
    if (!parent) continue;
    const Vector3d p_WJ = X_WB[index(segment)].translation();
    const auto carried = [&](std::size_t b) {
      return joint_acceleration(movement, b, X_WB[index(garment.boards[b].segment)] * X_BS[b],
                                p_WJ);
    };
    const auto a = carried(*parent), b = carried(child);
    double dot = 0.0, cross = 0.0, aa = 0.0, bb = 0.0;
    for (std::size_t i = 0; i < a.size(); ++i) {
      dot += a[i].dot(b[i]);
      cross += b[i].x() * a[i].y() - b[i].y() * a[i].x();
      aa += a[i].squaredNorm();
      bb += b[i].squaredNorm();
    }
    const double likeness = std::hypot(dot, cross) / std::sqrt(aa * bb + 1e-12);
    const double lively = std::sqrt(std::min(aa, bb) / static_cast<double>(a.size()));
    if (likeness < kAlike || lively < kLively) continue;
    const double sigma = kLinkSigma + kUnlikeness * (1.0 - likeness);
    links.push_back({*parent, child, std::atan2(cross, dot), sigma, likeness});
  }
  return links;
}

std::vector<BoardHeading> functional_headings(const Skeleton& canonical, const Garment& garment,
                                              const Pose& pose,
                                              std::span<const Eigen::Isometry3d> X_BS,
                                              const Movement& movement,
                                              std::span<const double> known) {
  const auto boards = static_cast<Eigen::Index>(garment.boards.size());
  auto headings = bending_headings(canonical, garment, pose, X_BS, movement);
  std::vector<Eigen::Isometry3d> turned(X_BS.begin(), X_BS.end());
  Eigen::VectorXd turn = Eigen::VectorXd::Zero(boards);
  Eigen::MatrixXd P;
  std::vector<bool> reached(garment.boards.size());
  // Where the joint is, seen from a board, depends on its heading: so once more with the first
  // answer.
  for (int round = 0; round < 3; ++round) {
    const auto links = joint_headings(canonical, garment, pose, turned, movement);
    if (round == 0) {
      // A first answer down the tree; what is found of the bending decides the whole's heading.
      for (Eigen::Index b = 0; b < boards; ++b) {
        const auto i = static_cast<std::size_t>(b);
        if (!std::isfinite(known[i]) && headings[i].found) turn[b] = headings[i].turn;
      }
      std::vector<std::size_t> group(garment.boards.size());
      std::iota(group.begin(), group.end(), std::size_t{0});
      Eigen::VectorXd within = Eigen::VectorXd::Zero(boards);
      for (const HeadingLink& link : links) {
        const std::size_t from = group[link.child], to = group[link.parent];
        const double shift = within[static_cast<Eigen::Index>(link.parent)] + link.turn -
                             within[static_cast<Eigen::Index>(link.child)];
        for (std::size_t b = 0; b < group.size(); ++b) {
          if (group[b] != from) continue;
          group[b] = to;
          within[static_cast<Eigen::Index>(b)] += shift;
        }
      }
      for (std::size_t g = 0; g < group.size(); ++g) {
        Eigen::Vector2d sum = Eigen::Vector2d::Zero();
        for (std::size_t b = 0; b < group.size(); ++b) {
          if (group[b] != g) continue;
          const auto at = static_cast<Eigen::Index>(b);
          if (std::isfinite(known[b])) {
            sum += Eigen::Vector2d(std::cos(within[at]), -std::sin(within[at])) /
                   (known[b] * known[b]);
          } else if (headings[b].found) {
            const double whole = headings[b].turn - within[at];
            sum +=
                Eigen::Vector2d(std::cos(whole), std::sin(whole)) / (kBendingSigma * kBendingSigma);
          }
        }
        if (sum.norm() == 0.0) continue;
        const double whole = std::atan2(sum.y(), sum.x());
        for (std::size_t b = 0; b < group.size(); ++b) {
          if (group[b] == g) {
            turn[static_cast<Eigen::Index>(b)] = within[static_cast<Eigen::Index>(b)] + whole;
            reached[b] = true;
          }
        }
      }
    }
    // Small corrections of the turns x: priors, bending, links.
    Eigen::MatrixXd H = 1e-6 * Eigen::MatrixXd::Identity(boards, boards);
    Eigen::VectorXd g = Eigen::VectorXd::Zero(boards);
    for (Eigen::Index b = 0; b < boards; ++b) {
      const auto i = static_cast<std::size_t>(b);
      if (std::isfinite(known[i])) {
        const double w = 1.0 / (known[i] * known[i]);
        H(b, b) += w;
        g[b] -= w * std::remainder(turn[b], 2.0 * std::numbers::pi);
      }
      if (headings[i].found) {
        const double off = std::remainder(headings[i].turn - turn[b], 2.0 * std::numbers::pi);
        const double u = off / kBendingSigma;
        const double w = 1.0 / (kBendingSigma * kBendingSigma * (1.0 + u * u));
        H(b, b) += w;
        g[b] += w * off;
      }
    }
    for (const HeadingLink& link : links) {
      const auto a = static_cast<Eigen::Index>(link.parent);
      const auto c = static_cast<Eigen::Index>(link.child);
      // `turned` already has the turns so far, so the link tells what is left of them; in the first
      // round nothing is turned yet.
      const double left = round == 0 ? link.turn - (turn[c] - turn[a]) : link.turn;
      const double off = std::remainder(left, 2.0 * std::numbers::pi), u = off / (3.0 * link.sigma);
      const double w = 1.0 / (link.sigma * link.sigma * (1.0 + u * u));
      H(a, a) += w;
      H(c, c) += w;
      H(a, c) -= w;
      H(c, a) -= w;
      g[c] += w * off;
      g[a] -= w * off;
    }
    P = H.ldlt().solve(Eigen::MatrixXd::Identity(boards, boards));
    turn += P * g;
    for (std::size_t b = 0; b < garment.boards.size(); ++b) {
      turned[b] = X_BS[b];
      turn_about_vertical(canonical, garment.boards[b], pose, turn[static_cast<Eigen::Index>(b)],
                          turned[b]);
    }
  }
  for (std::size_t b = 0; b < headings.size(); ++b) {
    const auto at = static_cast<Eigen::Index>(b);
    headings[b].turn = std::remainder(turn[at], 2.0 * std::numbers::pi);
    headings[b].sigma = std::sqrt(P(at, at));
    headings[b].found = (reached[b] || headings[b].found) && headings[b].sigma < 0.6;
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
