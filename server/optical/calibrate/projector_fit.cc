#include "server/optical/calibrate/projector_fit.h"

#include <fmt/format.h>

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <Eigen/QR>
#include <Eigen/SVD>
#include <algorithm>
#include <cmath>
#include <iterator>
#include <optional>
#include <random>
#include <vector>

namespace secondskin::server {
namespace {

using Vector7d = Eigen::Matrix<double, 7, 1>;
using RowVector7d = Eigen::Matrix<double, 1, 7>;

constexpr std::size_t kUnknowns = 7;
constexpr double kFits = 3.0;          // [counts]
constexpr double kCauchy = 1.0;        // [counts]
constexpr double kFlat = 0.05;         // least spread of the points over the greatest
constexpr double kConditioned = 1e-4;  // least over greatest singular value of the normalised rows
constexpr double kScale = 128.0;       // of the values, and their middle [counts]

// The row and right side of 2.2.2.
RowVector7d row_of(const Eigen::Vector3d& x, double v) {
  RowVector7d row;
  row << x.transpose(), 1.0, -v * x.transpose();
  return row;
}

Projector as_projector(const Vector7d& q) {
  Projector projector;
  projector.P << q.head<4>().transpose(), q.tail<3>().transpose(), 1.0;
  return projector;
}

// Points about their middle and in units of their spread, values from -1 to 1.
struct Normalised {
  std::vector<Reading> readings;
  Eigen::Vector3d middle;
  double scale = 1.0;

  // P for normalised points and values to P for metres and counts.
  Projector restore(const Projector& normalised) const {
    Eigen::Matrix2d counts;
    counts << kScale, kScale, 0.0, 1.0;
    Eigen::Matrix4d T = Eigen::Matrix4d::Identity();
    T.topLeftCorner<3, 3>() /= scale;
    T.topRightCorner<3, 1>() = -middle / scale;
    Projector projector;
    projector.P = counts * normalised.P * T;
    projector.P /= projector.P(1, 3);
    return projector;
  }
};

std::optional<Refusal> refuse(std::span<const Reading> readings) {
  std::vector<Eigen::Vector3d> distinct;
  Eigen::Vector3d middle = Eigen::Vector3d::Zero();
  for (const Reading& r : readings) {
    middle += r.p_W / static_cast<double>(readings.size());
    if (distinct.size() < kUnknowns &&
        std::none_of(distinct.begin(), distinct.end(),
                     [&](const auto& p) { return (p - r.p_W).norm() < 1e-6; })) {
      distinct.push_back(r.p_W);
    }
  }
  if (distinct.size() < kUnknowns) {
    return Refusal{
        RefusalKind::kTooFewPoints,
        fmt::format("readings at {} places; at least {} are needed", distinct.size(), kUnknowns)};
  }
  Eigen::Matrix3d covariance = Eigen::Matrix3d::Zero();
  for (const Reading& r : readings) {
    covariance += (r.p_W - middle) * (r.p_W - middle).transpose();
  }
  const Eigen::Vector3d spread =
      Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d>(covariance, Eigen::EigenvaluesOnly)
          .eigenvalues()
          .cwiseMax(0.0)
          .cwiseSqrt();
  if (spread[1] < kFlat * spread[2]) {
    return Refusal{RefusalKind::kDegenerate, "all readings lie on a line"};
  }
  if (spread[0] < kFlat * spread[2]) {
    return Refusal{RefusalKind::kDegenerate,
                   "all readings lie in one plane; read the grid at a second height too"};
  }
  return std::nullopt;
}

Normalised normalise(std::span<const Reading> readings) {
  Normalised out;
  out.middle.setZero();
  const auto n = static_cast<double>(readings.size());
  for (const Reading& r : readings) out.middle += r.p_W / n;
  double square = 0.0;
  for (const Reading& r : readings) square += (r.p_W - out.middle).squaredNorm() / n;
  out.scale = std::sqrt(square);
  for (const Reading& r : readings) {
    out.readings.push_back({(r.p_W - out.middle) / out.scale, (r.value - kScale) / kScale});
  }
  return out;
}

// Weighted least squares of 2.2.2; empty where the rows leave a direction open.
std::optional<Projector> algebraic(std::span<const Reading> readings,
                                   const std::vector<double>& weights) {
  const auto n = static_cast<Eigen::Index>(readings.size());
  Eigen::Matrix<double, Eigen::Dynamic, 7> A(n, 7);
  Eigen::VectorXd b(n);
  for (Eigen::Index k = 0; k < n; ++k) {
    const auto i = static_cast<std::size_t>(k);
    A.row(k) = weights[i] * row_of(readings[i].p_W, readings[i].value);
    b[k] = weights[i] * readings[i].value;
  }
  Eigen::JacobiSVD<Eigen::MatrixXd> svd(A, Eigen::ComputeThinU | Eigen::ComputeThinV);
  if (svd.singularValues()[6] < kConditioned * svd.singularValues()[0]) return std::nullopt;
  return as_projector(svd.solve(b));
}

// Gauss-Newton on the counts with Cauchy weights, from a start that is near.
void refine(std::span<const Reading> readings, Projector& projector) {
  const double cauchy = kCauchy / kScale;
  for (int iteration = 0; iteration < 20; ++iteration) {
    Eigen::Matrix<double, 7, 7> H = Eigen::Matrix<double, 7, 7>::Zero();
    Vector7d g = Vector7d::Zero();
    for (const Reading& reading : readings) {
      const double v = projector.value(reading.p_W);
      const double h =
          projector.P.row(1).head<3>().dot(reading.p_W.transpose()) + projector.P(1, 3);
      const double r = v - reading.value;
      const double w = 1.0 / (1.0 + r * r / (cauchy * cauchy));
      const RowVector7d J = row_of(reading.p_W, v) / h;
      H += w * J.transpose() * J;
      g += w * r * J.transpose();
    }
    H.diagonal().array() += 1e-12 * H.trace();
    const Vector7d step = H.ldlt().solve(g);
    if (!step.allFinite()) return;
    Vector7d q;
    q << projector.P.row(0).transpose(), projector.P.row(1).head<3>().transpose();
    projector = as_projector(q - step);
    if (step.norm() < 1e-12 * q.norm()) return;
  }
}

// Ten rounds of weighted least squares: 1/h makes the algebraic residual one of the value, and
// 1/sqrt|r| on top makes the sum one of absolute values, which a few wild readings move little.
std::optional<Projector> least_absolute(std::span<const Reading> readings,
                                        std::vector<double> weights) {
  std::optional<Projector> projector;
  for (int pass = 0; pass < 10; ++pass) {
    projector = algebraic(readings, weights);
    if (!projector) return std::nullopt;
    for (std::size_t k = 0; k < weights.size(); ++k) {
      const Reading& reading = readings[k];
      const double h =
          projector->P.row(1).head<3>().dot(reading.p_W.transpose()) + projector->P(1, 3);
      const double r = std::fabs(projector->value(reading.p_W) - reading.value);
      weights[k] =
          1.0 / (std::max(std::fabs(h), 0.1) * std::sqrt(std::max(r, 0.3 / kScale) * kScale));
    }
  }
  return projector;
}

// Sum of |residual|, each at most kFits, in counts.
double misfit(std::span<const Reading> readings, const Projector& projector) {
  double sum = 0.0;
  for (const Reading& r : readings) {
    sum += std::min(kScale * std::fabs(projector.value(r.p_W) - r.value), kFits);
  }
  return sum;
}

// The best start from readings of which some are wild: the least misfit of all readings from a few
// of them, drawn at random (Fischler and Bolles 1981).
Projector draw(std::span<const Reading> readings, int draws, Projector best) {
  std::mt19937_64 random(1);
  std::vector<Reading> few;
  double least = misfit(readings, best);
  for (int k = 0; k < draws; ++k) {
    few.clear();
    std::sample(readings.begin(), readings.end(), std::back_inserter(few), kUnknowns + 2, random);
    const auto trial = algebraic(few, std::vector<double>(few.size(), 1.0));
    if (!trial) continue;
    if (const double m = misfit(readings, *trial); m < least) {
      least = m;
      best = *trial;
    }
  }
  return best;
}

}  // namespace

tl::expected<Projector, Refusal> fit_projector_algebraic(std::span<const Reading> readings) {
  if (auto refusal = refuse(readings)) return tl::unexpected(*refusal);
  const auto n = static_cast<Eigen::Index>(readings.size());
  Eigen::Matrix<double, Eigen::Dynamic, 7> A(n, 7);
  Eigen::VectorXd b(n);
  for (Eigen::Index k = 0; k < n; ++k) {
    const auto i = static_cast<std::size_t>(k);
    A.row(k) = row_of(readings[i].p_W, readings[i].value);
    b[k] = readings[i].value;
  }
  return as_projector(A.colPivHouseholderQr().solve(b));
}

tl::expected<ProjectorFit, Refusal> fit_projector(std::span<const Reading> readings, int draws) {
  if (auto refusal = refuse(readings)) return tl::unexpected(*refusal);
  const Normalised normalised = normalise(readings);
  auto projector = least_absolute(normalised.readings, std::vector<double>(readings.size(), 1.0));
  if (!projector) {
    return tl::unexpected(
        Refusal{RefusalKind::kDegenerate,
                "the readings leave some of the seven numbers open; spread them over more of the "
                "projector's field and over more distances from it"});
  }
  if (misfit(normalised.readings, *projector) >
      0.2 * kFits * static_cast<double>(readings.size())) {
    *projector = draw(normalised.readings, draws, *projector);
  }
  refine(normalised.readings, *projector);
  ProjectorFit fit;
  fit.projector = normalised.restore(*projector);
  if (!fit.projector.P.allFinite()) {
    return tl::unexpected(Refusal{RefusalKind::kDoesNotFit, "no projector explains the readings"});
  }
  double square = 0.0;
  for (const Reading& reading : readings) {
    const double r = fit.projector.value(reading.p_W) - reading.value;
    if (std::fabs(r) > kFits) continue;
    square += r * r;
    ++fit.fitting;
  }
  fit.residual = fit.fitting > 0 ? std::sqrt(square / static_cast<double>(fit.fitting)) : 0.0;
  return fit;
}

}  // namespace secondskin::server
