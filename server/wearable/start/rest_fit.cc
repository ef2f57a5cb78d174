#include "server/wearable/start/rest_fit.h"

#include <algorithm>
#include <cmath>

#include "motion/kinematics.h"
#include "motion/rotation.h"

namespace secondskin::server {
namespace {

using Eigen::Index;
using Eigen::Vector3d;

constexpr int kIterations = 8;
constexpr double kStep = 1e-6;       // of the numerical derivatives
constexpr double kHeading = 1e-4;    // how much the root may turn about the vertical [rad]
constexpr double kTells = 8.0;       // evidence that is enough: as of two sources heard or not
constexpr double kTooSmall = 0.005;  // a difference of distances that tells nothing [m]

// The unknowns in one vector: joints, mountings, places, logarithms of the bones.
struct Layout {
  Index joints = 0, mountings, places, bones, size;
  explicit Layout(std::size_t boards)
      : mountings(3 * kJointCount),
        places(mountings + 3 * static_cast<Index>(boards)),
        bones(places + 3 * static_cast<Index>(boards)),
        size(bones + static_cast<Index>(kBones)) {}
};

struct Observed {
  std::size_t source, board;
  double distance;
};

std::vector<Vector3d> sources_in_world(const Skeleton& canonical, const Garment& garment,
                                       std::span<const Eigen::Isometry3d> X_WB) {
  std::vector<Vector3d> p_WU;
  for (const UltrasonicSource& source : garment.sources) {
    const Vector3d p = source_place(canonical, source).translation();
    p_WU.push_back(source.segment ? X_WB[index(*source.segment)] * p : p);
  }
  return p_WU;
}

class Problem {
 public:
  Problem(const Skeleton& canonical, const Garment& garment, const Pose& pose,
          std::span<const Eigen::Isometry3d> X_BS, const Rest& rest,
          const RestFitSettings& settings)
      : layout(garment.boards.size()),
        canonical_(canonical),
        garment_(garment),
        pose_(pose),
        X_BS_(X_BS.begin(), X_BS.end()),
        settings_(settings),
        X_WB_(kJointCount),
        q_PB_(pose.q_PB) {
    for (std::size_t b = 0; b < garment.boards.size(); ++b) {
      nominal_.push_back(board_place(canonical, garment.boards[b]).translation());
      if (rest.boards[b].accel_readings > 0 && rest.boards[b].accel.norm() > 1.0) {
        up_.emplace_back(b, rest.boards[b].accel.normalized());
      }
      for (std::size_t s = 0; s < garment.sources.size(); ++s) {
        const double d = rest.distances(static_cast<Index>(s), static_cast<Index>(b));
        if (std::isfinite(d)) distances_.push_back({s, b, d});
      }
    }
  }

  Index rows() const { return static_cast<Index>(3 * up_.size() + distances_.size()); }
  std::size_t distances() const { return distances_.size(); }

  Skeleton skeleton(const Eigen::VectorXd& x) const {
    std::array<double, kBones> scale;
    for (std::size_t k = 0; k < kBones; ++k) {
      scale[k] = std::exp(x[layout.bones + static_cast<Index>(k)]);
    }
    return scaled(canonical_, scale);
  }

  Pose pose(const Eigen::VectorXd& x) const {
    Pose out = pose_;
    for (std::size_t j = 0; j < kJointCount; ++j) {
      out.q_PB[j] = pose_.q_PB[j] * quaternion_from(x.segment<3>(3 * static_cast<Index>(j)));
    }
    return out;
  }

  // A board keeps its share of the bone's length, and the offset that was found.
  std::vector<Eigen::Isometry3d> places(const Skeleton& body, const Eigen::VectorXd& x) const {
    std::vector<Eigen::Isometry3d> out = X_BS_;
    for (std::size_t b = 0; b < out.size(); ++b) {
      const auto at = 3 * static_cast<Index>(b);
      out[b].translation() += board_place(body, garment_.boards[b]).translation() - nominal_[b] +
                              x.segment<3>(layout.places + at);
      out[b].linear() = X_BS_[b].linear() *
                        quaternion_from(x.segment<3>(layout.mountings + at)).toRotationMatrix();
    }
    return out;
  }

  // Misfit of gravity [rad] and of distances [m], unweighted.
  void residuals(const Eigen::VectorXd& x, Eigen::VectorXd& r) {
    const Skeleton body = skeleton(x);
    for (std::size_t j = 0; j < kJointCount; ++j) {
      q_PB_[j] = pose_.q_PB[j] * quaternion_from(x.segment<3>(3 * static_cast<Index>(j)));
    }
    forward_kinematics(body, pose_.p_WR, q_PB_, X_WB_);
    const auto X_BS = places(body, x);
    const auto segment = [&](std::size_t b) { return index(garment_.boards[b].segment); };
    Index row = 0;
    for (const auto& [b, up_S] : up_) {
      const Eigen::Matrix3d R_WS = X_WB_[segment(b)].linear() * X_BS[b].linear();
      r.segment<3>(row) = R_WS.row(2).transpose() - up_S;
      row += 3;
    }
    std::vector<Vector3d> p_WU;
    if (!distances_.empty()) p_WU = sources_in_world(body, garment_, X_WB_);
    for (const auto& one : distances_) {
      const Vector3d p_WS = X_WB_[segment(one.board)] * X_BS[one.board].translation();
      r[row++] = (p_WS - p_WU[one.source]).norm() - one.distance;
    }
  }

  double gravity_rms(const Eigen::VectorXd& r) const {
    const auto n = static_cast<Index>(3 * up_.size());
    return n == 0 ? 0.0 : std::sqrt(3.0 * r.head(n).squaredNorm() / static_cast<double>(n));
  }
  double distance_median(const Eigen::VectorXd& r) const {
    std::vector<double> errors;
    for (Index i = static_cast<Index>(3 * up_.size()); i < r.size(); ++i) {
      errors.push_back(std::abs(r[i]));
    }
    if (errors.empty()) return 0.0;
    const auto middle = errors.begin() + static_cast<std::ptrdiff_t>(errors.size() / 2);
    std::nth_element(errors.begin(), middle, errors.end());
    return *middle;
  }
  // 1 / sigma of each row; that of distances by iteratively reweighted least squares for rho.
  Eigen::VectorXd weights(const Eigen::VectorXd& r) const {
    const auto n = static_cast<Index>(3 * up_.size());
    Eigen::VectorXd w(r.size());
    w.head(n).setConstant(1.0 / settings_.gravity);
    for (Index i = n; i < r.size(); ++i) {
      const double u = r[i] / settings_.distance;
      w[i] = 1.0 / (settings_.distance * std::sqrt(1.0 + u * u));
    }
    return w;
  }

  const Layout layout;

 private:
  const Skeleton& canonical_;
  const Garment& garment_;
  const Pose& pose_;
  std::vector<Eigen::Isometry3d> X_BS_;
  RestFitSettings settings_;
  std::vector<Vector3d> nominal_;
  std::vector<std::pair<std::size_t, Vector3d>> up_;
  std::vector<Observed> distances_;
  std::vector<Eigen::Isometry3d> X_WB_;
  std::vector<Eigen::Quaterniond> q_PB_;
};

}  // namespace

std::vector<Eigen::Isometry3d> nominal_places(const Skeleton& canonical, const Garment& garment) {
  std::vector<Eigen::Isometry3d> X_BS;
  for (const SensorBoard& board : garment.boards) X_BS.push_back(board_place(canonical, board));
  return X_BS;
}

RestFit fit_rest(const Skeleton& canonical, const std::array<double, kBones>& bone_sigma,
                 const Garment& garment, const Pose& pose, std::span<const Eigen::Isometry3d> X_BS,
                 const std::vector<bool>& known, const Rest& rest,
                 const RestFitSettings& settings) {
  std::vector<Eigen::Isometry3d> start(X_BS.begin(), X_BS.end());
  std::vector<Eigen::Isometry3d> X_WB(kJointCount);
  forward_kinematics(canonical, pose.p_WR, pose.q_PB, X_WB);
  for (std::size_t b = 0; b < start.size(); ++b) {
    if (known[b] || rest.boards[b].accel_readings == 0) continue;
    const Eigen::Matrix3d R_WB = X_WB[index(garment.boards[b].segment)].linear();
    const Vector3d seen_W = R_WB * start[b].linear() * rest.boards[b].accel.normalized();
    const auto q_W = Eigen::Quaterniond::FromTwoVectors(seen_W, Vector3d::UnitZ());
    start[b].linear() = R_WB.transpose() * q_W.toRotationMatrix() * R_WB * start[b].linear();
  }

  Problem problem(canonical, garment, pose, start, rest, settings);
  const Layout& at = problem.layout;
  Eigen::VectorXd prior(at.size);  // 1 / sigma
  prior.head(at.mountings).setConstant(1.0 / settings.pose);
  prior[2] = 1.0 / kHeading;
  prior.segment(at.mountings, at.places - at.mountings).setConstant(1.0 / settings.mounting);
  prior.segment(at.places, at.bones - at.places).setConstant(1.0 / settings.place);
  for (std::size_t k = 0; k < kBones; ++k) {
    prior[at.bones + static_cast<Index>(k)] = 1.0 / bone_sigma[k];
  }

  Eigen::VectorXd x = Eigen::VectorXd::Zero(at.size), r(problem.rows()), moved(problem.rows());
  Eigen::MatrixXd J(problem.rows(), at.size), H(at.size, at.size);
  problem.residuals(x, r);
  RestFit fit{canonical, pose, {}, {}, {}};
  fit.gravity_before = problem.gravity_rms(r);
  fit.distance_before = problem.distance_median(r);
  fit.distances = problem.distances();
  for (int i = 0; i < kIterations; ++i) {
    for (Index column = 0; column < at.size; ++column) {
      Eigen::VectorXd y = x;
      y[column] += kStep;
      problem.residuals(y, moved);
      J.col(column) = (moved - r) / kStep;
    }
    const Eigen::VectorXd w = problem.weights(r);
    const Eigen::MatrixXd A = w.asDiagonal() * J;
    H.noalias() = A.transpose() * A;
    H.diagonal() += prior.cwiseAbs2();
    const Eigen::VectorXd gradient =
        A.transpose() * w.cwiseProduct(r) + prior.cwiseAbs2().cwiseProduct(x);
    const Eigen::VectorXd step = H.ldlt().solve(-gradient);
    x += step;
    problem.residuals(x, r);
    if (step.norm() < 1e-7) break;
  }
  const Eigen::MatrixXd P = H.ldlt().solve(Eigen::MatrixXd::Identity(at.size, at.size));
  for (std::size_t k = 0; k < kBones; ++k) {
    const Index i = at.bones + static_cast<Index>(k);
    fit.bone_scale[k] = std::exp(x[i]);
    fit.bone_sigma[k] = std::sqrt(std::max(0.0, P(i, i)));
  }
  fit.skeleton = problem.skeleton(x);
  fit.pose = problem.pose(x);
  fit.X_BS = problem.places(fit.skeleton, x);
  fit.gravity = problem.gravity_rms(r);
  fit.distance = problem.distance_median(r);
  return fit;
}

std::vector<std::pair<std::size_t, std::size_t>> mirrored_boards(const Garment& garment) {
  std::vector<std::pair<std::size_t, std::size_t>> pairs;
  for (std::size_t l = 0; l < garment.boards.size(); ++l) {
    const Joint joint = garment.boards[l].segment;
    if (!joint_name(joint).starts_with("left_")) continue;
    std::optional<std::size_t> other;
    std::size_t here = 0, there = 0;
    for (std::size_t b = 0; b < garment.boards.size(); ++b) {
      here += garment.boards[b].segment == joint ? 1 : 0;
      if (garment.boards[b].segment == mirrored(joint)) {
        other = b;
        ++there;
      }
    }
    if (here == 1 && there == 1) pairs.emplace_back(l, *other);
  }
  return pairs;
}

namespace {

// +1 a source on the left, -1 on the right, 0 in the middle or in the world.
double side_of(const Skeleton& canonical, const UltrasonicSource& source) {
  if (!source.segment) return 0.0;
  const double y = source_place(canonical, source).translation().y();
  return std::abs(y) < 0.02 ? 0.0 : (y > 0.0 ? 1.0 : -1.0);
}

struct Evidence {
  double agreement = 0.0;  // as worn rightly, in squared standard deviations
  double possible = 0.0;   // what it would be if all agreed
};

// One source that only the own side hears is worth two standard deviations.
Evidence by_sound(const Skeleton& canonical, const Garment& garment, const Eigen::MatrixXd& heard,
                  std::size_t left, std::size_t right) {
  Evidence evidence;
  for (std::size_t s = 0; s < garment.sources.size(); ++s) {
    const auto row = static_cast<Index>(s);
    const double more =
        heard(row, static_cast<Index>(left)) - heard(row, static_cast<Index>(right));
    const double side = side_of(canonical, garment.sources[s]);
    evidence.agreement += 4.0 * side * more;
    evidence.possible += 4.0 * std::abs(side * more);
  }
  return evidence;
}

}  // namespace

std::vector<Swap> swapped_at_rest(const Skeleton& canonical, const Garment& garment,
                                  const Pose& pose, std::span<const Eigen::Isometry3d> X_BS,
                                  const Rest& rest) {
  std::vector<Eigen::Isometry3d> X_WB(kJointCount);
  forward_kinematics(canonical, pose.p_WR, pose.q_PB, X_WB);
  const std::vector<Vector3d> p_WU = sources_in_world(canonical, garment, X_WB);
  std::vector<Swap> swaps;
  for (const auto& [left, right] : mirrored_boards(garment)) {
    const std::array<std::size_t, 2> pair{left, right};
    std::array<Eigen::Isometry3d, 2> X_WS;
    for (int i = 0; i < 2; ++i) {
      X_WS[i] = X_WB[index(garment.boards[pair[i]].segment)] * X_BS[pair[i]];
    }
    // Differences between the two boards' distances from one source, less their mean over the
    // sources: a bone's length or a board's place along the limb falls out, only the side is left.
    std::vector<double> expected, seen;
    for (std::size_t s = 0; s < p_WU.size(); ++s) {
      const auto row = static_cast<Index>(s);
      const double d = rest.distances(row, static_cast<Index>(left)) -
                       rest.distances(row, static_cast<Index>(right));
      if (!std::isfinite(d) || std::abs(d) > 0.6) continue;
      seen.push_back(d);
      expected.push_back((X_WS[0].translation() - p_WU[s]).norm() -
                         (X_WS[1].translation() - p_WU[s]).norm());
    }
    auto [agreement, possible] = by_sound(canonical, garment, rest.heard, left, right);
    if (seen.size() >= 3) {
      const auto n = static_cast<Index>(seen.size());
      Eigen::Map<Eigen::VectorXd> e(expected.data(), n), o(seen.data(), n);
      e.array() -= e.mean();
      o.array() -= o.mean();
      if (e.norm() > kTooSmall * std::sqrt(static_cast<double>(n))) {
        // In standard deviations of 15 mm, so that it adds up with gravity's, of 15 degrees.
        agreement += e.dot(o) / (0.015 * 0.015);
        possible += e.squaredNorm() / (0.015 * 0.015);
      }
    }
    if (rest.boards[left].accel_readings > 0 && rest.boards[right].accel_readings > 0) {
      const Vector3d e = X_WS[0].linear().row(2) - X_WS[1].linear().row(2);
      const Vector3d o =
          rest.boards[left].accel.normalized() - rest.boards[right].accel.normalized();
      agreement += e.dot(o) / (0.26 * 0.26);
      possible += e.squaredNorm() / (0.26 * 0.26);
    }
    if (possible < kTells) continue;
    const double evidence = agreement / possible;
    if (evidence < -0.3) swaps.push_back({left, right, evidence});
  }
  return swaps;
}

}  // namespace secondskin::server
