#include "server/optical/calibrate/bundle.h"

#include <ceres/ceres.h>

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <Eigen/QR>
#include <array>
#include <cmath>
#include <limits>
#include <memory>

namespace secondskin::server {
namespace {

using RowVector7d = Eigen::Matrix<double, 1, 7>;

// The projectors' seven numbers about the middle of the points, where h is never near 0.
struct Centred {
  Eigen::Vector3d middle = Eigen::Vector3d::Zero();
  std::vector<std::optional<std::array<double, 7>>> parameters;

  Centred(const ProjectorRig& rig, const std::vector<BundleFrame>& frames) {
    std::size_t n = 0;
    for (const BundleFrame& f : frames) {
      for (const auto& p : f.points) middle += p;
      n += f.points.size();
    }
    if (n > 0) middle /= static_cast<double>(n);
    for (const auto& projector : rig.projectors) {
      auto& q = parameters.emplace_back();
      if (!projector) continue;
      Eigen::Matrix<double, 2, 4> P = projector->P;
      P.col(3) += P.leftCols<3>() * middle;
      P /= P(1, 3);
      q.emplace();
      for (int k = 0; k < 7; ++k) (*q)[static_cast<std::size_t>(k)] = P(k / 4, k % 4);
    }
  }

  void restore(ProjectorRig& rig) const {
    for (std::size_t i = 0; i < rig.size(); ++i) {
      if (!parameters[i]) continue;
      Eigen::Matrix<double, 2, 4>& P = rig.projectors[i]->P;
      for (int k = 0; k < 7; ++k) P(k / 4, k % 4) = (*parameters[i])[static_cast<std::size_t>(k)];
      P(1, 3) = 1.0;
      P.col(3) -= P.leftCols<3>() * middle;
      P /= P(1, 3);
    }
  }
};

// The value at x and its derivatives, from the seven numbers.
struct Value {
  double v;
  RowVector7d by_projector;
  Eigen::RowVector3d by_point;

  Value(const double* q, const Eigen::Vector3d& x) {
    const Eigen::Map<const Eigen::RowVector3d> p1(q), p2(q + 4);
    const double h = p2.dot(x.transpose()) + 1.0;
    v = (p1.dot(x.transpose()) + q[3]) / h;
    by_projector << x.transpose() / h, 1.0 / h, -v / h * x.transpose();
    by_point = (p1 - v * p2) / h;
  }
};

// (value - measured) / sigma; blocks: a projector, a frame's points.
class ValueCost : public ceres::CostFunction {
 public:
  ValueCost(double value, double sigma, std::size_t point, std::size_t points)
      : value_(value), sigma_(sigma), at_(static_cast<Eigen::Index>(3 * point)) {
    set_num_residuals(1);
    mutable_parameter_block_sizes()->push_back(7);
    mutable_parameter_block_sizes()->push_back(static_cast<int>(3 * points));
  }
  bool Evaluate(double const* const* parameters, double* residuals,
                double** jacobians) const override {
    const Eigen::Vector3d x = Eigen::Map<const Eigen::Vector3d>(parameters[1] + at_);
    const Value value(parameters[0], x);
    residuals[0] = (value.v - value_) / sigma_;
    if (jacobians == nullptr) return true;
    if (jacobians[0] != nullptr) {
      Eigen::Map<RowVector7d> J(jacobians[0]);
      J = value.by_projector / sigma_;
    }
    if (jacobians[1] != nullptr) {
      Eigen::Map<Eigen::RowVectorXd> J(jacobians[1], parameter_block_sizes()[1]);
      J.setZero();
      J.segment<3>(at_) = value.by_point / sigma_;
    }
    return true;
  }

 private:
  double value_, sigma_;
  Eigen::Index at_;
};

// (|x_a - x_b| - length) / sigma; block: a frame's points.
class LengthCost : public ceres::CostFunction {
 public:
  LengthCost(double length, double sigma, std::size_t a, std::size_t b, std::size_t points)
      : length_(length),
        sigma_(sigma),
        a_(static_cast<Eigen::Index>(3 * a)),
        b_(static_cast<Eigen::Index>(3 * b)) {
    set_num_residuals(1);
    mutable_parameter_block_sizes()->push_back(static_cast<int>(3 * points));
  }
  bool Evaluate(double const* const* parameters, double* residuals,
                double** jacobians) const override {
    const Eigen::Map<const Eigen::Vector3d> a(parameters[0] + a_), b(parameters[0] + b_);
    const double distance = (a - b).norm();
    residuals[0] = (distance - length_) / sigma_;
    if (jacobians == nullptr || jacobians[0] == nullptr) return true;
    Eigen::Map<Eigen::RowVectorXd> J(jacobians[0], parameter_block_sizes()[0]);
    J.setZero();
    const Eigen::RowVector3d along = (a - b).transpose() / (std::max(distance, 1e-9) * sigma_);
    J.segment<3>(a_) = along;
    J.segment<3>(b_) = -along;
    return true;
  }

 private:
  double length_, sigma_;
  Eigen::Index a_, b_;
};

// A projector's focal and middle against the design's; from P = s [f x + c z | ...; z | ...].
struct OpticsCost {
  BundleSettings settings;

  template <typename T>
  bool operator()(const T* q, T* residuals) const {
    const Eigen::Map<const Eigen::Matrix<T, 3, 1>> p1(q), p2(q + 4);
    const T square = p2.squaredNorm();
    const T middle = p1.dot(p2) / square;
    const Eigen::Matrix<T, 3, 1> across = p1 - middle * p2;
    using std::sqrt;
    const T focal = sqrt(across.squaredNorm() / square);
    residuals[0] = (focal / settings.optics.focal - 1.0) / settings.focal_sigma;
    residuals[1] = (middle - settings.optics.middle) / settings.middle_sigma;
    return true;
  }
};

template <typename Function>
void for_each_length(const BundleFrame& frame, const Function& function) {
  for (std::size_t a = 0; a < frame.detectors.size(); ++a) {
    for (std::size_t b = a + 1; b < frame.detectors.size(); ++b) function(a, b);
  }
}

double length_of(const BundleFrame& frame, const Eigen::MatrixXd& lengths, std::size_t a,
                 std::size_t b) {
  return lengths(static_cast<Eigen::Index>(frame.detectors[a]),
                 static_cast<Eigen::Index>(frame.detectors[b]));
}

}  // namespace

bool adjust(ProjectorRig& rig, std::vector<BundleFrame>& frames, const Eigen::MatrixXd& lengths,
            const BundleSettings& settings) {
  Centred centred(rig, frames);
  std::vector<Eigen::VectorXd> points;
  for (const BundleFrame& frame : frames) {
    auto& x = points.emplace_back(3 * static_cast<Eigen::Index>(frame.points.size()));
    for (std::size_t k = 0; k < frame.points.size(); ++k) {
      x.segment<3>(3 * static_cast<Eigen::Index>(k)) = frame.points[k] - centred.middle;
    }
  }
  ceres::Problem problem;
  auto* ordering = new ceres::ParameterBlockOrdering;
  std::vector<bool> used(rig.size(), false);
  for (std::size_t f = 0; f < frames.size(); ++f) {
    const BundleFrame& frame = frames[f];
    const std::size_t n = frame.points.size();
    for (std::size_t k = 0; k < n; ++k) {
      for (const Sighting& s : frame.sightings[k]) {
        if (!centred.parameters[s.projector]) continue;
        used[s.projector] = true;
        problem.AddResidualBlock(new ValueCost(s.value, settings.value_sigma, k, n),
                                 new ceres::CauchyLoss(2.5),
                                 centred.parameters[s.projector]->data(), points[f].data());
      }
    }
    for_each_length(frame, [&](std::size_t a, std::size_t b) {
      problem.AddResidualBlock(
          new LengthCost(length_of(frame, lengths, a, b), settings.length_sigma, a, b, n),
          new ceres::CauchyLoss(10.0), points[f].data());
    });
    if (problem.HasParameterBlock(points[f].data())) {
      ordering->AddElementToGroup(points[f].data(), 0);
    }
  }
  for (std::size_t i = 0; i < rig.size(); ++i) {
    if (!used[i]) continue;
    problem.AddResidualBlock(
        new ceres::AutoDiffCostFunction<OpticsCost, 2, 7>(new OpticsCost{settings}), nullptr,
        centred.parameters[i]->data());
    ordering->AddElementToGroup(centred.parameters[i]->data(), 1);
  }
  ceres::Solver::Options options;
  options.linear_solver_type = ceres::DENSE_SCHUR;
  options.linear_solver_ordering.reset(ordering);
  options.max_num_iterations = settings.iterations;
  options.function_tolerance = 1e-7;
  options.num_threads = 1;
  options.logging_type = ceres::SILENT;
  ceres::Solver::Summary summary;
  ceres::Solve(options, &problem, &summary);
  if (!summary.IsSolutionUsable()) return false;
  centred.restore(rig);
  for (std::size_t f = 0; f < frames.size(); ++f) {
    for (std::size_t k = 0; k < frames[f].points.size(); ++k) {
      frames[f].points[k] = points[f].segment<3>(3 * static_cast<Eigen::Index>(k)) + centred.middle;
    }
  }
  return true;
}

double predicted_error(const ProjectorRig& rig, const std::vector<BundleFrame>& frames,
                       const BundleSettings& settings, std::span<const BundleFrame> probes) {
  const Centred centred(rig, frames);
  const auto size = static_cast<Eigen::Index>(7 * rig.size());
  // The normal equations of the projectors, the points eliminated.
  Eigen::MatrixXd S = Eigen::MatrixXd::Zero(size, size);
  for (const BundleFrame& frame : frames) {
    const auto n = 3 * static_cast<Eigen::Index>(frame.points.size());
    Eigen::MatrixXd V = Eigen::MatrixXd::Identity(n, n) * 1e-6;
    Eigen::MatrixXd W = Eigen::MatrixXd::Zero(size, n);
    for (std::size_t k = 0; k < frame.points.size(); ++k) {
      const auto at = 3 * static_cast<Eigen::Index>(k);
      const Eigen::Vector3d x = frame.points[k] - centred.middle;
      for (const Sighting& s : frame.sightings[k]) {
        if (!centred.parameters[s.projector]) continue;
        const Value value(centred.parameters[s.projector]->data(), x);
        const double r = (value.v - s.value) / settings.value_sigma;
        const double w = 1.0 / (settings.value_sigma * settings.value_sigma * (1.0 + r * r / 6.25));
        const auto row = static_cast<Eigen::Index>(7 * s.projector);
        S.block<7, 7>(row, row) += w * value.by_projector.transpose() * value.by_projector;
        W.block<7, 3>(row, at) += w * value.by_projector.transpose() * value.by_point;
        V.block<3, 3>(at, at) += w * value.by_point.transpose() * value.by_point;
      }
    }
    for_each_length(frame, [&](std::size_t a, std::size_t b) {
      Eigen::RowVectorXd J = Eigen::RowVectorXd::Zero(n);
      const Eigen::RowVector3d along =
          (frame.points[a] - frame.points[b]).normalized().transpose() / settings.length_sigma;
      J.segment<3>(3 * static_cast<Eigen::Index>(a)) = along;
      J.segment<3>(3 * static_cast<Eigen::Index>(b)) = -along;
      V += J.transpose() * J;
    });
    S -= W * V.ldlt().solve(W.transpose());
  }
  for (std::size_t i = 0; i < rig.size(); ++i) {
    if (!centred.parameters[i]) continue;
    using Jet = ceres::Jet<double, 7>;
    std::array<Jet, 7> q;
    for (int k = 0; k < 7; ++k) {
      q[static_cast<std::size_t>(k)] =
          Jet((*centred.parameters[i])[static_cast<std::size_t>(k)], k);
    }
    std::array<Jet, 2> r;
    OpticsCost{settings}(q.data(), r.data());
    const auto at = static_cast<Eigen::Index>(7 * i);
    for (const Jet& residual : r) S.block<7, 7>(at, at) += residual.v * residual.v.transpose();
  }
  // In units that make the diagonal 1; directions without information (place and orientation of
  // the whole among them) get a variance that is great but finite.
  const Eigen::VectorXd scale =
      S.diagonal().unaryExpr([](double d) { return d > 0.0 ? 1.0 / std::sqrt(d) : 0.0; });
  const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> eigen(scale.asDiagonal() * S *
                                                             scale.asDiagonal());
  const double least = 1e-9 * eigen.eigenvalues().maxCoeff();
  const Eigen::MatrixXd root =
      scale.asDiagonal() * eigen.eigenvectors() *
      eigen.eigenvalues().cwiseMax(least).cwiseSqrt().cwiseInverse().asDiagonal();

  // dp = A dq for each probed point p, and how p moves with the whole.
  std::size_t n = 0;
  for (const BundleFrame& frame : probes) n += frame.points.size();
  if (n < 3) return std::numeric_limits<double>::infinity();
  Eigen::MatrixXd A = Eigen::MatrixXd::Zero(3 * static_cast<Eigen::Index>(n), size);
  Eigen::MatrixXd rigid = Eigen::MatrixXd::Zero(A.rows(), 6);
  Eigen::Index row = 0;
  for (const BundleFrame& frame : probes) {
    for (std::size_t k = 0; k < frame.points.size(); ++k, row += 3) {
      const Eigen::Vector3d x = frame.points[k] - centred.middle;
      Eigen::Matrix3d normal = Eigen::Matrix3d::Zero();
      for (const Sighting& s : frame.sightings[k]) {
        if (!centred.parameters[s.projector]) continue;
        const Value value(centred.parameters[s.projector]->data(), x);
        normal += value.by_point.transpose() * value.by_point;
        A.block<3, 7>(row, static_cast<Eigen::Index>(7 * s.projector)) =
            value.by_point.transpose() * value.by_projector;
      }
      A.middleRows<3>(row) = (-normal.ldlt().solve(A.middleRows<3>(row))).eval();
      rigid.block<3, 3>(row, 0).setIdentity();
      rigid.block<3, 3>(row, 3) << 0.0, x.z(), -x.y(), -x.z(), 0.0, x.x(), x.y(), -x.x(), 0.0;
    }
  }
  const Eigen::MatrixXd Q = Eigen::HouseholderQR<Eigen::MatrixXd>(rigid).householderQ() *
                            Eigen::MatrixXd::Identity(rigid.rows(), 6);
  A -= Q * (Q.transpose() * A);
  return std::sqrt((A * root).squaredNorm() / static_cast<double>(n));
}

}  // namespace secondskin::server
