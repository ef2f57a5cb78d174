#include "server/markers/triangles.h"

#include <fmt/format.h>

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <numbers>
#include <stdexcept>

#include "motion/rotation.h"

namespace secondskin::server {
namespace {

using Eigen::Isometry3d;
using Eigen::Matrix3d;
using Eigen::Quaterniond;
using Eigen::Vector3d;

}  // namespace

std::optional<Isometry3d> triangle_pose(const Vector3d& first, const Vector3d& second,
                                        const Vector3d& third) noexcept {
  constexpr double kLeastSine = 0.1, kLeastSide = 1e-3;
  const Vector3d a = second - first, b = third - first;
  const double la = a.norm(), lb = b.norm(), lc = (third - second).norm();
  if (!(std::min({la, lb, lc}) > kLeastSide)) return std::nullopt;
  const Vector3d normal = a.cross(b);
  // Twice the area over the two longest sides' product is the smallest angle's sine.
  if (!(normal.norm() > kLeastSine * la * lb * lc / std::min({la, lb, lc}))) return std::nullopt;
  Isometry3d X = Isometry3d::Identity();
  X.linear().col(0) = a / la;
  X.linear().col(1) = normal.normalized();
  X.linear().col(2) = X.linear().col(0).cross(X.linear().col(1));
  X.translation() = first;
  return X;
}

Quaterniond mean_rotation(std::span<const Quaterniond> rotations) noexcept {
  if (rotations.empty()) return Quaterniond::Identity();
  Quaterniond mean = rotations.front();
  constexpr int kIterations = 10;
  for (int i = 0; i < kIterations; ++i) {
    Vector3d sum = Vector3d::Zero();
    for (const Quaterniond& q : rotations) sum += rotation_vector(mean.conjugate() * q);
    const Vector3d step = sum / static_cast<double>(rotations.size());
    mean = (mean * quaternion_from(step)).normalized();
    if (step.norm() < 1e-9) break;
  }
  return mean;
}

std::optional<Vector3d> centre_of_markers(const MarkerMotion& motion,
                                          std::span<const std::size_t> markers) {
  Vector3d sum = Vector3d::Zero();
  double count = 0.0;
  for (const MarkerFrame& frame : motion.frames) {
    const bool all = std::all_of(markers.begin(), markers.end(), [&](std::size_t m) {
      return m < frame.visible.size() && frame.visible[m] != 0 && frame.p_WM[m].allFinite();
    });
    if (!all || markers.empty()) continue;
    for (const std::size_t m : markers) {
      sum += frame.p_WM[m];
      count += 1.0;
    }
  }
  if (count == 0.0) return std::nullopt;
  return sum / count;
}

tl::expected<JointCentre, NoCentre> centre_of_rotation(std::span<const Isometry3d> X_WP,
                                                       std::span<const Isometry3d> X_WB) {
  constexpr std::size_t kFewest = 10;
  const std::size_t n = std::min(X_WP.size(), X_WB.size());
  if (n < kFewest) return tl::unexpected(NoCentre::kTooFewFrames);
  // [R_WP, -R_WB] [p_PJ; p_BJ] = p_WB - p_WP, stacked over the frames.
  Eigen::Matrix<double, 6, 6> H = Eigen::Matrix<double, 6, 6>::Zero();
  Eigen::Matrix<double, 6, 1> g = Eigen::Matrix<double, 6, 1>::Zero();
  for (std::size_t i = 0; i < n; ++i) {
    Eigen::Matrix<double, 3, 6> A;
    A << X_WP[i].linear(), -X_WB[i].linear();
    const Vector3d b = X_WB[i].translation() - X_WP[i].translation();
    H += A.transpose() * A;
    g += A.transpose() * b;
  }
  H /= static_cast<double>(n);
  g /= static_cast<double>(n);
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix<double, 6, 6>> eigen(H);
  // Eigenvalues are 1 -+ c, c the singular values of the mean relative rotation; without movement c
  // = 1 three times, about one axis once. A turn of +-a about an axis makes the others 1 -
  // sin(a)/a.
  const auto& values = eigen.eigenvalues();
  const auto turn = [](double degrees) {
    const double a = degrees * std::numbers::pi / 180.0;
    return 1.0 - std::sin(a) / a;
  };
  if (values[1] < turn(10.0)) return tl::unexpected(NoCentre::kTooLittleMovement);
  if (values[0] < turn(5.0)) return tl::unexpected(NoCentre::kOneAxis);
  const Eigen::Matrix<double, 6, 1> p = H.ldlt().solve(g);
  JointCentre centre{p.head<3>(), p.tail<3>(), 0.0};
  for (std::size_t i = 0; i < n; ++i) {
    centre.residual += (X_WP[i] * centre.p_PJ - X_WB[i] * centre.p_BJ).squaredNorm();
  }
  centre.residual = std::sqrt(centre.residual / static_cast<double>(n));
  return centre;
}

std::optional<Vector3d> TriangleSkeleton::vertex(Vertex v,
                                                 const MarkerFrame& frame) const noexcept {
  if (v >= kJointVertex) {
    const auto& X = X_WJ_[v - kJointVertex];
    return X ? std::optional<Vector3d>(X->translation()) : std::nullopt;
  }
  if (v >= frame.p_WM.size() || v >= frame.visible.size()) return std::nullopt;
  if (frame.visible[v] == 0 || !frame.p_WM[v].allFinite()) return std::nullopt;
  return frame.p_WM[v];
}

std::optional<Isometry3d> TriangleSkeleton::pose(const Triangle& triangle,
                                                 const MarkerFrame& frame) const noexcept {
  const auto a = vertex(triangle.vertex[0], frame), b = vertex(triangle.vertex[1], frame),
             c = vertex(triangle.vertex[2], frame);
  if (!a || !b || !c) return std::nullopt;
  return triangle_pose(*a, *b, *c);
}

std::vector<TriangleSkeleton::Triangle> TriangleSkeleton::triangles_of(
    const std::vector<Vertex>& vertices, const MarkerFrame& frame, const Isometry3d& X_WJ) const {
  std::vector<Triangle> result;
  for (std::size_t i = 0; i < vertices.size(); ++i) {
    for (std::size_t j = i + 1; j < vertices.size(); ++j) {
      for (std::size_t k = j + 1; k < vertices.size(); ++k) {
        Triangle triangle{
            {vertices[i], vertices[j], vertices[k]}, Vector3d::Zero(), Quaterniond::Identity()};
        const auto X_WT = pose(triangle, frame);
        if (!X_WT) continue;
        triangle.p_TJ = X_WT->inverse() * X_WJ.translation();
        triangle.q_TJ = Quaterniond(X_WT->linear().transpose() * X_WJ.linear()).normalized();
        result.push_back(triangle);
      }
    }
  }
  return result;
}

TriangleSkeleton::TriangleSkeleton(const std::vector<CalibratedJoint>& joints,
                                   const MarkerFrame& frame) {
  std::array<std::vector<Vertex>, kJointCount> vertices;
  std::size_t most = 0;
  for (const CalibratedJoint& calibrated : joints) {
    const std::string_view name = joint_name(calibrated.joint);
    if (X_WJ_[index(calibrated.joint)]) {
      throw std::invalid_argument(fmt::format("triangles: joint {} is listed twice", name));
    }
    if (!entries_.empty() && entries_.back().joint > calibrated.joint) {
      throw std::invalid_argument(
          fmt::format("triangles: joint {} stands after one that it moves", name));
    }
    std::vector<Vertex>& own = vertices[index(calibrated.joint)];
    for (const std::size_t marker : calibrated.markers) {
      if (marker >= frame.p_WM.size()) {
        throw std::invalid_argument(
            fmt::format("triangles: joint {}: marker {} is not in the frame", name, marker));
      }
      own.push_back(marker);
    }
    // The nearest listed joint above.
    std::size_t above = index(calibrated.joint);
    do {
      above = index(canonical_anatomy()[above].parent);
    } while (above != 0 && vertices[above].empty());
    Entry entry{calibrated.joint, {}, {}};
    const bool first = entries_.empty();
    if (!first && vertices[above].empty()) {
      throw std::invalid_argument(
          fmt::format("triangles: no joint above {} comes before it", name));
    }
    entry.position = triangles_of(first ? own : vertices[above], frame, calibrated.X_WJ);
    X_WJ_[index(calibrated.joint)] = calibrated.X_WJ;
    if (!first) own.push_back(kJointVertex + index(calibrated.joint));
    entry.orientation = triangles_of(own, frame, calibrated.X_WJ);
    if (entry.position.empty() || entry.orientation.empty()) {
      throw std::invalid_argument(fmt::format(
          "triangles: joint {}: no three of its vertices that are seen span a triangle", name));
    }
    most = std::max({most, entry.position.size(), entry.orientation.size()});
    entries_.push_back(std::move(entry));
  }
  rotations_.reserve(most);
}

std::size_t TriangleSkeleton::triangles() const noexcept {
  std::size_t count = 0;
  for (const Entry& entry : entries_) count += entry.position.size() + entry.orientation.size();
  return count;
}

void TriangleSkeleton::update(const MarkerFrame& frame, Pose& out) noexcept {
  out.q_PB.resize(kJointCount, Quaterniond::Identity());
  out.confidence.resize(kJointCount, 0.0F);
  X_WJ_.fill(std::nullopt);
  std::array<Quaterniond, kJointCount> q_WB;
  std::array<bool, kJointCount> known{};
  for (const Entry& entry : entries_) {
    const std::size_t j = index(entry.joint);
    Vector3d p_WJ = Vector3d::Zero();
    double count = 0.0;
    for (const Triangle& triangle : entry.position) {
      const auto X_WT = pose(triangle, frame);
      if (!X_WT) continue;
      p_WJ += *X_WT * triangle.p_TJ;
      count += 1.0;
    }
    if (count == 0.0) continue;
    // The joint itself is a vertex of its segment's triangles.
    X_WJ_[j] = Isometry3d::Identity();
    X_WJ_[j]->translation() = p_WJ / count;
    rotations_.clear();
    for (const Triangle& triangle : entry.orientation) {
      if (const auto X_WT = pose(triangle, frame)) {
        rotations_.push_back(Quaterniond(X_WT->linear()) * triangle.q_TJ);
      }
    }
    if (rotations_.empty()) continue;
    q_WB[j] = mean_rotation(rotations_);
    X_WJ_[j]->linear() = q_WB[j].toRotationMatrix();
    known[j] = true;
  }
  // J_child,sys,P = J_parent,sys,G^-1 J_child,sys,G; what lies between two listed joints is at
  // rest.
  for (std::size_t j = 0; j < kJointCount; ++j) {
    out.confidence[j] = known[j] ? 1.0F : 0.0F;
    if (j == 0) {
      if (known[0]) {
        out.q_PB[0] = q_WB[0];
        out.p_WR = X_WJ_[0]->translation();
      }
    } else {
      const std::size_t parent = index(canonical_anatomy()[j].parent);
      if (known[j]) out.q_PB[j] = (q_WB[parent].conjugate() * q_WB[j]).normalized();
      if (known[j]) continue;
      q_WB[j] = q_WB[parent] * out.q_PB[j];
    }
    if (j == 0 && !known[0]) q_WB[0] = out.q_PB[0];
  }
}

}  // namespace secondskin::server
