#pragma once

#include <cmath>
#include <filesystem>
#include <random>

#include "server/wearable/estimate/body_filter.h"
#include "server/wearable/estimate/covariance.h"

/// Bodies, states and motion drawn from the filter's own model.
namespace secondskin::server {

inline Garment practical_garment() {
  return Garment::load(std::filesystem::path(SECONDSKIN_SOURCE_DIR) / "garments" /
                       "practical.toml");
}

inline std::vector<Eigen::Isometry3d> places(const Skeleton& skeleton, const Garment& garment) {
  std::vector<Eigen::Isometry3d> X_BS;
  for (const SensorBoard& board : garment.boards) X_BS.push_back(board_place(skeleton, board));
  return X_BS;
}

class Draw {
 public:
  explicit Draw(std::uint64_t seed) : random_(seed) {}
  double normal(double sigma) { return sigma * normal_(random_); }
  Eigen::Vector3d vector(double sigma) {
    const double x = normal(sigma), y = normal(sigma), z = normal(sigma);
    return {x, y, z};
  }
  /// A state in lively motion, far from rest.
  BodyState state(const BodyLayout& layout, const BodyState& mean, double scale) {
    std::vector<double> error(static_cast<std::size_t>(layout.size()));
    for (int c = 0; c < layout.size(); ++c) {
      const int level = c < layout.moving() ? c / layout.level_size() : 3;
      const double sigma = level == 0 ? 0.5 : level == 1 ? 3.0 : level == 2 ? 20.0 : 0.05;
      error[static_cast<std::size_t>(c)] = normal(scale * sigma);
    }
    BodyState result = mean;
    correct(layout, error, result);
    return result;
  }
  /// An error with a covariance (its lower triangle's Cholesky factor).
  Eigen::VectorXd error(const Eigen::MatrixXd& factor) {
    Eigen::VectorXd e(factor.rows());
    for (double& v : e) v = normal(1.0);
    return factor.triangularView<Eigen::Lower>() * e;
  }
  std::mt19937_64& engine() { return random_; }

 private:
  std::mt19937_64 random_;
  std::normal_distribution<double> normal_;
};

inline Eigen::MatrixXd dense(const Covariance& P, int size) {
  Eigen::MatrixXd result(size, size);
  for (int i = 0; i < size; ++i) {
    for (int j = 0; j < size; ++j) result(i, j) = P.at(i, j);
  }
  return result;
}

inline Eigen::MatrixXd dense(const ObservationSet& set, int size) {
  Eigen::MatrixXd H = Eigen::MatrixXd::Zero(set.size(), size);
  for (const SparseRows& rows : set.rows) {
    for (int e = rows.begin; e < rows.end; ++e) {
      const SparseEntry& entry = set.entries[static_cast<std::size_t>(e)];
      for (int r = 0; r < rows.rows; ++r) H(rows.first + r, entry.column) += entry.h[r];
    }
  }
  return H;
}

}  // namespace secondskin::server
