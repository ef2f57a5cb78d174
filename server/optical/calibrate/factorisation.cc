#include "server/optical/calibrate/factorisation.h"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <Eigen/SVD>
#include <algorithm>
#include <cmath>
#include <random>

namespace secondskin::server {
namespace {

using Vector8d = Eigen::Matrix<double, 8, 1>;
using Matrix24d = Eigen::Matrix<double, 2, 4>;

// The spread of the normalised points: about half the volume over the distance of a projector.
constexpr double kSpread = 0.2;
constexpr double kStretch = 4.0;  // brings the tangents of a 30 degree field to about +-1
constexpr double kWild = 3.0;     // Cauchy's scale [counts]
constexpr double kGood = 0.5;     // median residual at which no further start is tried [counts]
constexpr double kInFront = 0.9;  // share of the points that must lie before a projector
constexpr int kStarts = 12;
constexpr std::size_t kLeastSightings = 20;  // of a projector
constexpr std::size_t kLeastPoints = 40;

// A sighting with the nominal optics taken off: m is kStretch times the tangent of the angle from
// the axis.
struct View {
  std::size_t projector;
  double m;
  double weight = 1.0;  // of the algebraic residual: 1/h makes it one of the value
};

struct Problem {
  std::vector<std::vector<View>> points;
  std::size_t projectors = 0;
};

// The state of the variable projection: matrices and, solved for them, the points.
struct State {
  std::vector<Matrix24d> P;
  std::vector<Eigen::Vector3d> X;
  double cost = 0.0;
};

// Of one point: rows of the residuals r = A x + b, two a view:
//   (P1 - m P2) [x 1]            the algebraic residual (2.2.2)
//   w (P2 [x 1] - 1)             the wish for equal depths
void rows_of(const std::vector<View>& views, const std::vector<Matrix24d>& P, double w,
             Eigen::MatrixX3d& A, Eigen::VectorXd& b) {
  const auto n = static_cast<Eigen::Index>(views.size());
  A.resize(2 * n, 3);
  b.resize(2 * n);
  for (Eigen::Index k = 0; k < n; ++k) {
    const View& view = views[static_cast<std::size_t>(k)];
    const Matrix24d& p = P[view.projector];
    A.row(2 * k) = view.weight * (p.row(0).head<3>() - view.m * p.row(1).head<3>());
    b[2 * k] = view.weight * (p(0, 3) - view.m * p(1, 3));
    A.row(2 * k + 1) = w * p.row(1).head<3>();
    b[2 * k + 1] = w * (p(1, 3) - 1.0);
  }
}

// The best points for given matrices; a hair of damping keeps points with poor views in place.
void solve_points(const Problem& problem, double w, State& state) {
  Eigen::MatrixX3d A;
  Eigen::VectorXd b;
  state.X.resize(problem.points.size());
  state.cost = 0.0;
  for (std::size_t p = 0; p < problem.points.size(); ++p) {
    rows_of(problem.points[p], state.P, w, A, b);
    const Eigen::Matrix3d V = A.transpose() * A + 1e-12 * Eigen::Matrix3d::Identity();
    state.X[p] = -V.ldlt().solve(A.transpose() * b);
    state.cost += (A * state.X[p] + b).squaredNorm();
  }
}

// Levenberg-Marquardt over the matrices alone, the points projected out.
void minimise(const Problem& problem, double w, int iterations, State& state) {
  const auto size = static_cast<Eigen::Index>(8 * problem.projectors);
  Eigen::MatrixX3d A;
  Eigen::VectorXd b;
  Eigen::MatrixXd S(size, size);
  Eigen::VectorXd g(size);
  std::vector<Eigen::Matrix<double, 8, 3>> W;
  double damping = 1e-3;
  solve_points(problem, w, state);
  for (int iteration = 0; iteration < iterations; ++iteration) {
    S.setZero();
    g.setZero();
    for (std::size_t p = 0; p < problem.points.size(); ++p) {
      const auto& views = problem.points[p];
      rows_of(views, state.P, w, A, b);
      const Eigen::VectorXd r = A * state.X[p] + b;
      const Eigen::Matrix3d V = A.transpose() * A + 1e-12 * Eigen::Matrix3d::Identity();
      const Eigen::Matrix3d V_inverse = V.inverse();
      const Eigen::Vector4d x = state.X[p].homogeneous();
      W.resize(views.size());
      for (std::size_t k = 0; k < views.size(); ++k) {
        const auto row = static_cast<Eigen::Index>(2 * k);
        Eigen::Matrix<double, 2, 8> J;
        J << views[k].weight * x.transpose(), -views[k].weight * views[k].m * x.transpose(),  //
            Eigen::RowVector4d::Zero(), w * x.transpose();
        const auto at = static_cast<Eigen::Index>(8 * views[k].projector);
        S.block<8, 8>(at, at) += J.transpose() * J;
        g.segment<8>(at) += J.transpose() * r.segment<2>(row);
        W[k] = J.transpose() * A.middleRows<2>(row);
      }
      for (std::size_t k = 0; k < views.size(); ++k) {
        const Eigen::Matrix<double, 8, 3> Y = W[k] * V_inverse;
        for (std::size_t l = 0; l < views.size(); ++l) {
          S.block<8, 8>(static_cast<Eigen::Index>(8 * views[k].projector),
                        static_cast<Eigen::Index>(8 * views[l].projector)) -= Y * W[l].transpose();
        }
      }
    }
    const double scale = S.diagonal().mean();
    bool better = false;
    double gain = 0.0;
    for (int attempt = 0; attempt < 8 && !better; ++attempt) {
      Eigen::MatrixXd damped = S;
      damped.diagonal().array() += damping * scale;
      const Eigen::VectorXd step = -damped.ldlt().solve(g);
      State next = state;
      for (std::size_t i = 0; i < problem.projectors; ++i) {
        const Vector8d s = step.segment<8>(static_cast<Eigen::Index>(8 * i));
        next.P[i].row(0) += s.head<4>().transpose();
        next.P[i].row(1) += s.tail<4>().transpose();
      }
      solve_points(problem, w, next);
      if (next.cost < state.cost) {
        gain = 1.0 - next.cost / state.cost;
        state = std::move(next);
        damping = std::max(1e-12, 0.2 * damping);
        better = true;
      } else {
        damping *= 8.0;
      }
    }
    if (!better || gain < 1e-6) break;
  }
}

// Robust weights of the value residuals: 1/h, and less for those that do not fit (Cauchy).
void reweight(Problem& problem, const State& state, double scale) {
  for (std::size_t p = 0; p < problem.points.size(); ++p) {
    const Eigen::Vector4d x = state.X[p].homogeneous();
    for (View& view : problem.points[p]) {
      const Eigen::Vector2d hv = state.P[view.projector] * x;
      const double h = std::max(std::fabs(hv[1]), 0.05);
      const double r = (hv[0] / hv[1] - view.m) / scale;
      view.weight = 1.0 / (h * std::sqrt(1.0 + r * r));
    }
  }
}

// Moves the points to the origin and gives them equal spread in all directions, a spread that makes
// a projector's direction and its distance numbers of one size.
void normalise(State& state) {
  const auto n = static_cast<double>(state.X.size());
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();
  for (const auto& x : state.X) mean += x / n;
  Eigen::Matrix3d covariance = Eigen::Matrix3d::Zero();
  for (const auto& x : state.X) covariance += (x - mean) * (x - mean).transpose() / n;
  const Eigen::LLT<Eigen::Matrix3d> llt(covariance);
  const Eigen::Matrix3d L = llt.matrixL();
  Eigen::Matrix4d T = Eigen::Matrix4d::Identity();
  T.topLeftCorner<3, 3>() = L / kSpread;
  T.topRightCorner<3, 1>() = mean;
  for (auto& P : state.P) P = P * T;
  for (auto& x : state.X) x = kSpread * llt.matrixL().solve(x - mean);
}

// The map H that makes the projectors physical: P H = [R | t] in the nominal optics' units, from
// P Omega P^T ~ I with the dual quadric Omega = H diag(1, 1, 1, 0) H^T (Triggs 1997), two linear
// equations a projector.
std::optional<Eigen::Matrix4d> metric_upgrade(const std::vector<Matrix24d>& P) {
  Eigen::MatrixXd A(static_cast<Eigen::Index>(2 * P.size()), 10);
  const auto coefficients = [](const Eigen::RowVector4d& a, const Eigen::RowVector4d& b) {
    Eigen::Matrix<double, 1, 10> row;
    Eigen::Index k = 0;
    for (Eigen::Index i = 0; i < 4; ++i) {
      for (Eigen::Index j = i; j < 4; ++j, ++k) {
        row[k] = i == j ? a[i] * b[i] : a[i] * b[j] + a[j] * b[i];
      }
    }
    return row;
  };
  for (std::size_t i = 0; i < P.size(); ++i) {
    const Matrix24d p = P[i] / P[i].norm() * std::sqrt(2.0);
    const auto row = static_cast<Eigen::Index>(2 * i);
    A.row(row) = coefficients(p.row(0), p.row(0)) - coefficients(p.row(1), p.row(1));
    A.row(row + 1) = 2.0 * coefficients(p.row(0), p.row(1));
  }
  const Eigen::JacobiSVD<Eigen::MatrixXd> svd(A, Eigen::ComputeFullV);
  const Eigen::VectorXd q = svd.matrixV().col(9);
  Eigen::Matrix4d Omega;
  for (Eigen::Index i = 0, k = 0; i < 4; ++i) {
    for (Eigen::Index j = i; j < 4; ++j, ++k) Omega(i, j) = Omega(j, i) = q[k];
  }
  Eigen::SelfAdjointEigenSolver<Eigen::Matrix4d> eigen(Omega);
  Eigen::Vector4d values = eigen.eigenvalues();
  Eigen::Matrix4d vectors = eigen.eigenvectors();
  if (values.sum() < 0.0) {
    values = -values.reverse().eval();
    vectors = vectors.rowwise().reverse().eval();
  }
  if (values[1] <= 0.0) return std::nullopt;
  Eigen::Matrix4d H;
  for (int c = 0; c < 3; ++c) H.col(c) = std::sqrt(values[3 - c]) * vectors.col(3 - c);
  H.col(3) = vectors.col(0);
  return H;
}

State random_start(std::size_t projectors, std::mt19937_64& random) {
  std::normal_distribution<double> normal;
  State state;
  state.P.resize(projectors);
  for (Matrix24d& P : state.P) {
    for (int c = 0; c < 3; ++c) P(0, c) = normal(random);
    for (int c = 0; c < 3; ++c) P(1, c) = 0.2 * normal(random);
    P(0, 3) = 0.0;
    P(1, 3) = 1.0;
  }
  return state;
}

// From a start to a metric reconstruction; empty when it ends elsewhere than in front.
std::optional<Reconstruction> descend(Problem problem, const NominalOptics& optics, State state) {
  for (const double w : {0.3, 0.1, 0.03, 0.01}) minimise(problem, w, 60, state);
  for (int pass = 0; pass < 4; ++pass) {
    reweight(problem, state, kWild * kStretch / optics.focal);
    minimise(problem, 1e-3, 20, state);
  }
  normalise(state);
  for (Matrix24d& P : state.P) P.row(0) /= kStretch;
  const auto H = metric_upgrade(state.P);
  if (!H) return std::nullopt;
  const Eigen::Matrix4d inverse = H->inverse();
  Reconstruction out;
  for (const Eigen::Vector3d& x : state.X) {
    const Eigen::Vector4d X = inverse * x.homogeneous();
    out.points.emplace_back(X.hnormalized());
  }
  Eigen::Matrix2d counts;
  counts << optics.focal, optics.middle, 0.0, 1.0;
  for (const Matrix24d& P : state.P) out.rig.projectors.push_back(Projector{counts * P * *H});

  std::vector<double> residuals;
  std::vector<int> in_front(state.P.size(), 0);
  for (std::size_t p = 0; p < out.points.size(); ++p) {
    for (const View& view : problem.points[p]) {
      const Matrix24d& P = out.rig.projectors[view.projector]->P;
      const Eigen::Vector2d hv = P * out.points[p]->homogeneous();
      residuals.push_back(
          std::fabs(hv[0] / hv[1] - optics.middle - view.m / kStretch * optics.focal));
      in_front[view.projector] += hv[1] > 0.0 ? 1 : -1;
    }
  }
  // A matrix may be turned by -1, but all points must lie on one side.
  std::vector<int> seen(state.P.size(), 0);
  for (const auto& views : problem.points) {
    for (const View& view : views) ++seen[view.projector];
  }
  for (std::size_t i = 0; i < seen.size(); ++i) {
    if (std::abs(in_front[i]) < static_cast<int>(kInFront * seen[i])) return std::nullopt;
    if (in_front[i] < 0) out.rig.projectors[i]->P *= -1.0;
  }
  const auto middle = residuals.begin() + static_cast<std::ptrdiff_t>(residuals.size() / 2);
  std::nth_element(residuals.begin(), middle, residuals.end());
  out.residual = *middle;
  if (!std::isfinite(out.residual)) return std::nullopt;
  return out;
}

}  // namespace

std::optional<Reconstruction> factorise(std::span<const std::vector<Sighting>> points,
                                        std::size_t projectors, const NominalOptics& optics,
                                        const ProjectorRig* guess, std::uint64_t seed) {
  // Those that see enough, counted from 0.
  std::vector<std::size_t> seen(projectors, 0), place(projectors, projectors);
  for (const auto& sightings : points) {
    for (const Sighting& s : sightings) ++seen[s.projector];
  }
  Problem problem;
  for (std::size_t i = 0; i < projectors; ++i) {
    if (seen[i] >= kLeastSightings) place[i] = problem.projectors++;
  }
  std::vector<std::size_t> which;  // of the given points each one of the problem is
  for (std::size_t p = 0; p < points.size(); ++p) {
    std::vector<View> views;
    for (const Sighting& s : points[p]) {
      if (place[s.projector] == projectors) continue;
      views.push_back(
          {place[s.projector], kStretch * (s.value - optics.middle) / optics.focal, 1.0});
    }
    if (views.size() < 4) continue;
    problem.points.push_back(std::move(views));
    which.push_back(p);
  }
  if (problem.projectors < 5 || problem.points.size() < kLeastPoints) return std::nullopt;

  std::mt19937_64 random(seed);
  std::optional<Reconstruction> best;
  for (int start = 0; start < kStarts; ++start) {
    State state = random_start(problem.projectors, random);
    if (start == 0 && guess != nullptr) {
      Eigen::Matrix2d stretched;
      stretched << kStretch / optics.focal, -kStretch * optics.middle / optics.focal, 0.0, 1.0;
      for (std::size_t i = 0; i < projectors; ++i) {
        if (place[i] == projectors || !guess->projectors[i]) continue;
        state.P[place[i]] = stretched * guess->projectors[i]->P;
      }
    }
    auto found = descend(problem, optics, std::move(state));
    if (found && (!best || found->residual < best->residual)) best = std::move(found);
    if (best && best->residual < kGood) break;
  }
  if (!best) return std::nullopt;
  Reconstruction out;
  out.residual = best->residual;
  out.rig.projectors.resize(projectors);
  for (std::size_t i = 0; i < projectors; ++i) {
    if (place[i] != projectors) out.rig.projectors[i] = best->rig.projectors[place[i]];
  }
  out.points.resize(points.size());
  for (std::size_t k = 0; k < which.size(); ++k) out.points[which[k]] = best->points[k];
  return out;
}

}  // namespace secondskin::server
