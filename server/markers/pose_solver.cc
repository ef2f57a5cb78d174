#include "server/markers/pose_solver.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include "motion/kinematics.h"
#include "motion/rotation.h"

namespace secondskin::server {
namespace {

using Vector3 = Eigen::Vector3d;
using Matrix3 = Eigen::Matrix3d;

constexpr double kDegree = std::numbers::pi / 180.0;

// The shortest turn from one direction to another.
Eigen::Quaterniond shortest_arc(const Vector3& from, const Vector3& to) noexcept {
  const Vector3 a = from.normalized(), b = to.normalized();
  const Vector3 cross = a.cross(b);
  const double w = 1.0 + a.dot(b);
  if (w < 1e-9) {  // opposite: about any axis across
    const Vector3 axis = a.cross(std::abs(a.x()) < 0.7 ? Vector3::UnitX() : Vector3::UnitY());
    return Eigen::Quaterniond(Eigen::AngleAxisd(std::numbers::pi, axis.normalized()));
  }
  return Eigen::Quaterniond(w, cross.x(), cross.y(), cross.z()).normalized();
}

// How far a movement goes that a joint does not have (carrying angle, play of the knee, the turn of
// the foot in the subtalar joint), 1 sigma. The constant part of it is in the frames.
double play(Joint joint, Movement movement) noexcept {
  switch (joint) {
    case Joint::kLeftAnkle:
    case Joint::kRightAnkle:
      return 8.0 * kDegree;
    case Joint::kLeftElbow:
    case Joint::kRightElbow:
    case Joint::kLeftKnee:
    case Joint::kRightKnee:
      return 4.0 * kDegree;
    default:
      return movement == Movement::kRotation ? 3.0 * kDegree : 2.0 * kDegree;
  }
}

constexpr double kLimitSigma = 5.0 * kDegree;  // ranges are means over people
constexpr double kEaseSigma = 2.0;             // [rad] keeps what no marker tells near rest
// Joints between two measured segments that only the place of the second one tells: the further
// ones of the trunk and neck, and a clavicle without markers. They give way where a body with one
// joint there could not follow, and stay near rest otherwise.
constexpr double kBetweenSigma = 10.0 * kDegree;

bool is_midline(Joint joint) noexcept { return mirrored(joint) == joint; }
bool is_clavicle(Joint joint) noexcept {
  return joint == Joint::kLeftClavicle || joint == Joint::kRightClavicle;
}

}  // namespace

Matrix3 movement_rates(Joint joint, const Eigen::Quaterniond& q_PB) noexcept {
  const JointAnatomy& anatomy = canonical_anatomy()[index(joint)];
  const auto& e = anatomy.axis;
  const JointAngles angles = joint_angles(joint, q_PB);
  Matrix3 M;  // w = M * angles', columns by Movement
  if (anatomy.convention == AngleConvention::kSwingTwist) {
    // q = exp(s) exp(t e3): w = R_t^T Jr(s) s' + e3 t'.
    const Vector3 swing = angles[0] * e[0] + angles[1] * e[1];
    const Matrix3 J = quaternion_from(-angles[2] * e[2]).toRotationMatrix() * right_jacobian(swing);
    M.col(0) = J * e[0];
    M.col(1) = J * e[1];
    M.col(2) = e[2];
  } else {
    // R = R(e1, a) R(e2, b) R(e3, c): w = R3^T R2^T e1 a' + R3^T e2 b' + e3 c'.
    const bool yxz = anatomy.convention == AngleConvention::kCardanYXZ;
    const int first = yxz ? 0 : 2, last = yxz ? 2 : 0;
    const auto at = [](int i) { return static_cast<std::size_t>(i); };
    const Matrix3 R3t = quaternion_from(-angles[at(last)] * e[at(last)]).toRotationMatrix();
    const Matrix3 R2t = quaternion_from(-angles[1] * e[1]).toRotationMatrix();
    M.col(first) = R3t * (R2t * e[at(first)]);
    M.col(1) = R3t * e[1];
    M.col(last) = e[at(last)];
    if (std::abs(M.determinant()) < 0.2) {
      Matrix3 rates = Matrix3::Zero();
      rates.row(1) = M.col(1).transpose();
      return rates;
    }
  }
  if (std::abs(M.determinant()) < 0.2) return Matrix3::Zero();
  return M.inverse();
}

bool rigid_fit(std::span<const Vector3> a, std::span<const Vector3> b,
               Eigen::Isometry3d& X_ba) noexcept {
  if (a.size() < 3) return false;
  const double n = static_cast<double>(a.size());
  Vector3 mean_a = Vector3::Zero(), mean_b = Vector3::Zero();
  for (std::size_t i = 0; i < a.size(); ++i) {
    mean_a += a[i] / n;
    mean_b += b[i] / n;
  }
  Matrix3 S = Matrix3::Zero();
  for (std::size_t i = 0; i < a.size(); ++i) {
    S += (b[i] - mean_b) * (a[i] - mean_a).transpose();
  }
  const Eigen::JacobiSVD<Matrix3, Eigen::NoQRPreconditioner> svd(
      S, Eigen::ComputeFullU | Eigen::ComputeFullV);
  const Vector3 s = svd.singularValues();
  constexpr double kLine = 1e-3;  // second against first spread: a line
  if (!(s[1] > kLine * s[0]) || !(s[0] > 1e-9)) return false;
  Vector3 d(1.0, 1.0, (svd.matrixU() * svd.matrixV().transpose()).determinant() < 0.0 ? -1.0 : 1.0);
  X_ba.linear() = svd.matrixU() * d.asDiagonal() * svd.matrixV().transpose();
  X_ba.translation() = mean_b - X_ba.linear() * mean_a;
  X_ba.makeAffine();
  return true;
}

PoseSolver::PoseSolver(const Skeleton& skeleton, std::vector<Site> sites)
    : skeleton_(skeleton), sites_(std::move(sites)) {
  std::array<bool, kJointCount> own{}, below{};
  for (const Site& site : sites_) own[index(site.segment)] = true;
  below = own;
  for (std::size_t i = kJointCount; i-- > 1;) {
    if (below[i]) below[*skeleton_[i].parent] = true;
  }
  const bool anchored = own[0] || below[index(Joint::kLeftHip)] || below[index(Joint::kRightHip)];
  columns_.fill(-1);
  columns_[0] = 3;
  dofs_ = 6;
  ease_.fill(kEaseSigma);
  // Whether a joint above, since the last segment with markers, bends for this one too.
  std::array<bool, kJointCount> bent{};
  bent[0] = !anchored;
  for (std::size_t i = 1; i < kJointCount; ++i) {
    const auto joint = static_cast<Joint>(i);
    const std::size_t parent = *skeleton_[i].parent;
    bool is_free = below[i];
    if (is_midline(joint)) {
      if (bent[parent]) ease_[i] = kBetweenSigma;
      is_free = is_free && (parent != 0 || anchored);
      bent[i] = !own[i] && (bent[parent] || is_free);
    } else if (is_clavicle(joint) && !own[i]) {
      ease_[i] = kBetweenSigma;
    }
    if (!is_free) continue;
    columns_[i] = dofs_;
    dofs_ += 3;
  }
  for (std::size_t i = 0; i < kJointCount; ++i) {
    if (i > 0) paths_[i] = paths_[*skeleton_[i].parent];
    if (columns_[i] >= 0) paths_[i].joint[paths_[i].count++] = static_cast<std::uint8_t>(i);
  }
}

void PoseSolver::reshape(const Skeleton& skeleton, std::vector<Site> sites) {
  skeleton_ = skeleton;
  sites_ = std::move(sites);
}

void PoseSolver::place(PlacedPose& pose) const noexcept {
  forward_kinematics(skeleton_, pose.p_WR, pose.q_PB, pose.X_WB);
}

void PoseSolver::add_anatomy(const PlacedPose& pose, double& cost, Matrix* H,
                             Vector* g) const noexcept {
  for (std::size_t i = 1; i < kJointCount; ++i) {
    const int c = columns_[i];
    if (c < 0) continue;
    const auto joint = static_cast<Joint>(i);
    const JointAnatomy& anatomy = canonical_anatomy()[i];
    const JointAngles angles = joint_angles(joint, pose.q_PB[i]);
    Matrix3 rates;
    bool have_rates = false;
    for (std::size_t m = 0; m < 3; ++m) {
      const AngleRange& range = anatomy.range[m];
      double out = 0.0, sigma = kLimitSigma;
      if (range.min == range.max) {
        out = angles[m];
        sigma = play(joint, static_cast<Movement>(m));
      } else if (angles[m] > range.max) {
        out = angles[m] - range.max;
      } else if (angles[m] < range.min) {
        out = angles[m] - range.min;
      }
      if (out == 0.0) continue;
      if (!have_rates) rates = movement_rates(joint, pose.q_PB[i]);
      have_rates = true;
      const Vector3 row = rates.row(static_cast<Eigen::Index>(m)).transpose();
      if (row.squaredNorm() == 0.0) continue;  // the angle means nothing here
      const double w = 1.0 / (sigma * sigma);
      cost += w * out * out;
      if (H == nullptr) continue;
      H->block<3, 3>(c, c) += w * row * row.transpose();
      g->segment<3>(c) -= w * out * row;
    }
    const double ease = 1.0 / (ease_[i] * ease_[i]);
    const Vector3 v = rotation_vector(pose.q_PB[i]);
    cost += ease * v.squaredNorm();
    if (H == nullptr) continue;
    H->block<3, 3>(c, c).diagonal().array() += ease;
    g->segment<3>(c) -= ease * v;
  }
}

double PoseSolver::evaluate(const PlacedPose& pose, const Observation& seen, Matrix* H,
                            Vector* g) const noexcept {
  if (H != nullptr) {
    H->setZero(dofs_, dofs_);
    g->setZero(dofs_);
  }
  double cost = 0.0;
  const double c2 = seen.kernel * seen.kernel;
  std::array<Matrix3, kJointCount> J;
  for (std::size_t s = 0; s < sites_.size(); ++s) {
    if (!(seen.sigma[s] > 0.0)) continue;
    const Site& site = sites_[s];
    const std::size_t segment = index(site.segment);
    const Vector3 p_WM = pose.X_WB[segment] * site.p_BM;
    const Vector3 r = seen.p_WM[s] - p_WM;
    const double information = 1.0 / (seen.sigma[s] * seen.sigma[s]);
    const double d2 = information * r.squaredNorm();
    const double share = c2 / (c2 + d2);
    cost += d2 * share;  // Geman & McClure: rho = c^2 d^2 / (c^2 + d^2)
    if (H == nullptr) continue;
    const double w = information * share * share;
    const Vector3 wr = w * r;
    H->topLeftCorner<3, 3>().diagonal().array() += w;
    g->head<3>() += wr;
    const Path& path = paths_[segment];
    for (std::size_t k = 0; k < path.count; ++k) {
      const std::size_t j = path.joint[k];
      const int cj = columns_[j];
      const Vector3 arm = p_WM - pose.X_WB[j].translation();
      J[k].noalias() = -cross_matrix(arm) * pose.X_WB[j].linear();
      const Matrix3 wJ = w * J[k];
      H->block<3, 3>(cj, 0) += wJ.transpose();
      for (std::size_t l = 0; l <= k; ++l) {
        H->block<3, 3>(cj, columns_[path.joint[l]]).noalias() += wJ.transpose() * J[l];
      }
      g->segment<3>(cj).noalias() += J[k].transpose() * wr;
    }
  }
  add_anatomy(pose, cost, H, g);
  if (seen.predicted != nullptr) {
    const Vector& information = *seen.information;
    const auto add = [&](int c, const Vector3& error) {
      const Vector3 pull = information.segment<3>(c).cwiseProduct(error);
      cost += error.dot(pull);
      if (H == nullptr) return;
      H->block<3, 3>(c, c).diagonal() += information.segment<3>(c);
      g->segment<3>(c) -= pull;
    };
    add(0, pose.p_WR - seen.predicted->p_WR);
    for (std::size_t i = 0; i < kJointCount; ++i) {
      if (columns_[i] < 0) continue;
      add(columns_[i], rotation_vector(seen.predicted->q_PB[i].conjugate() * pose.q_PB[i]));
    }
  }
  return cost;
}

void PoseSolver::step(const PlacedPose& from, const Vector& dx, PlacedPose& to) const noexcept {
  to.p_WR = from.p_WR + dx.head<3>();
  for (std::size_t i = 0; i < kJointCount; ++i) {
    to.q_PB[i] = columns_[i] < 0
                     ? from.q_PB[i]
                     : (from.q_PB[i] * quaternion_from(dx.segment<3>(columns_[i]))).normalized();
  }
  place(to);
}

PoseSolver::Result PoseSolver::solve(const Observation& seen, int most_iterations, PlacedPose& pose,
                                     Matrix& H) const noexcept {
  constexpr double kSmallStep = 1e-5;   // [rad or m]
  constexpr double kLongestStep = 0.6;  // [rad or m]
  Vector g, dx;
  Matrix A;
  PlacedPose next;
  place(pose);
  double cost = evaluate(pose, seen, &H, &g);
  double lambda = 1e-8;
  Result result{cost, 0, false};
  while (result.iterations < most_iterations) {
    ++result.iterations;
    A = H;
    A.diagonal() *= 1.0 + lambda;
    const Eigen::LLT<Eigen::Ref<Matrix>> llt(A);
    if (llt.info() != Eigen::Success) {
      lambda = std::max(1e-4, 10.0 * lambda);
      if (lambda > 1e8) break;
      continue;
    }
    dx = g;
    llt.solveInPlace(dx);
    const double longest = dx.cwiseAbs().maxCoeff();
    if (!std::isfinite(longest)) break;
    if (longest > kLongestStep) dx *= kLongestStep / longest;
    step(pose, dx, next);
    const double trial = evaluate(next, seen, nullptr, nullptr);
    if (trial <= cost * (1.0 + 1e-12)) {
      pose = next;
      const bool small = longest < kSmallStep || cost - trial < 1e-7 * cost;
      cost = evaluate(pose, seen, &H, &g);
      lambda *= 0.1;
      if (small) {
        result.converged = true;
        break;
      }
    } else {
      if (longest < kSmallStep) {
        result.converged = true;
        break;
      }
      lambda = std::max(1e-4, 10.0 * lambda);
      if (lambda > 1e8) break;
    }
  }
  result.cost = cost;
  return result;
}

bool PoseSolver::initialise(const Observation& seen, Root root, PlacedPose& pose) const noexcept {
  constexpr std::size_t kMost = 32;
  std::array<Vector3, kMost> a, b;
  std::size_t n = 0;
  const auto is_seen = [&](std::size_t s) { return seen.sigma[s] > 0.0; };
  const auto gather = [&](auto&& belongs, auto&& p) {
    for (std::size_t s = 0; s < sites_.size() && n < kMost; ++s) {
      if (!is_seen(s) || !belongs(sites_[s].segment)) continue;
      a[n] = p(sites_[s]);
      b[n++] = seen.p_WM[s];
    }
  };
  // Pelvis and trunk together as if the wearer stood upright.
  PlacedPose rest;
  place(rest);
  gather(
      [&](Joint j) {
        if (j == Joint::kPelvis) return root != Root::kTrunk;
        return root != Root::kPelvis && (j <= Joint::kSpineUpper || is_clavicle(j));
      },
      [&](const Site& s) { return rest.X_WB[index(s.segment)] * s.p_BM; });
  Eigen::Isometry3d X_WR;
  if (!rigid_fit({a.data(), n}, {b.data(), n}, X_WR)) return false;
  pose.p_WR = X_WR.translation();
  pose.q_PB[0] = Eigen::Quaterniond(X_WR.linear()).normalized();
  place(pose);
  for (std::size_t i = 1; i < kJointCount; ++i) {
    if (columns_[i] < 0) continue;
    const auto joint = static_cast<Joint>(i);
    // What turns with this joint rigidly: its segment's markers, or those of the segments that hang
    // on it without a free joint between.
    const auto turns = [&](Joint segment) {
      std::size_t k = index(segment);
      while (k != i && k != 0 && columns_[k] < 0) k = *skeleton_[k].parent;
      return k == i;
    };
    const std::size_t parent = *skeleton_[i].parent;
    const Vector3 p_WB = pose.X_WB[parent] * skeleton_[i].p_PB;
    // Only a chain of rest rotations lies between, so the offsets add.
    const auto in_joint = [&](const Site& s) {
      Vector3 p = s.p_BM;
      for (std::size_t k = index(s.segment); k != i; k = *skeleton_[k].parent) {
        p += skeleton_[k].p_PB;
      }
      return p;
    };
    a[0].setZero();
    b[0] = p_WB;
    n = 1;
    gather(turns, in_joint);
    if (n == 1) continue;
    // Vectors from the joint.
    Matrix3 S = Matrix3::Zero();
    for (std::size_t k = 1; k < n; ++k) S += (b[k] - p_WB) * a[k].transpose();
    const Eigen::Quaterniond q_WP(pose.X_WB[parent].linear());
    const Eigen::JacobiSVD<Matrix3, Eigen::NoQRPreconditioner> svd(
        S, Eigen::ComputeFullU | Eigen::ComputeFullV);
    const Vector3 s = svd.singularValues();
    constexpr double kLine = 0.003;
    if (s[1] > kLine * s[0]) {
      const double sign =
          (svd.matrixU() * svd.matrixV().transpose()).determinant() < 0.0 ? -1.0 : 1.0;
      const Matrix3 R =
          svd.matrixU() * Vector3(1.0, 1.0, sign).asDiagonal() * svd.matrixV().transpose();
      pose.q_PB[i] = (q_WP.conjugate() * Eigen::Quaterniond(R)).normalized();
    } else {
      Vector3 from = Vector3::Zero(), to = Vector3::Zero();
      for (std::size_t k = 1; k < n; ++k) {
        from += a[k];
        to += q_WP.conjugate() * (b[k] - p_WB);
      }
      if (from.norm() < 1e-6 || to.norm() < 1e-6) continue;
      pose.q_PB[i] = shortest_arc(from, to);  // about its own length a limb stays as it was
    }
    place(pose);
    // Elbow and knee bend in one plane: where the limb below is bent, it tells the turn of the limb
    // above better than markers close to its axis do.
    const bool arm = joint == Joint::kLeftShoulder || joint == Joint::kRightShoulder;
    if (!arm && joint != Joint::kLeftHip && joint != Joint::kRightHip) continue;
    const Vector3 p_WE = pose.X_WB[i + 1].translation();
    Vector3 below = Vector3::Zero();
    for (std::size_t k = 0; k < sites_.size(); ++k) {
      if (is_seen(k) && index(sites_[k].segment) == i + 1) below += seen.p_WM[k] - p_WE;
    }
    const Vector3 bend = (arm ? 1.0 : -1.0) * pose.X_WB[i].linear().transpose() * below;
    constexpr double kBent = 0.4;  // sine
    if (!(bend.head<2>().norm() > kBent * bend.norm())) continue;
    const Eigen::AngleAxisd turn(std::atan2(bend.y(), bend.x()), Vector3::UnitZ());
    pose.q_PB[i] = (pose.q_PB[i] * turn).normalized();
    place(pose);
  }
  return true;
}

}  // namespace secondskin::server
