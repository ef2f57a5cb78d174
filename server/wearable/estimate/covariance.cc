#include "server/wearable/estimate/covariance.h"

#include <algorithm>
#include <cassert>
#include <cmath>
#include <cstring>
#include <new>
#include <stdexcept>

namespace secondskin::server {
namespace {

constexpr std::align_val_t kAlignment{64};
constexpr int kMostRows = 256;

// Transposes the square of the first `panels` panels in place.
void transpose_square(int panels, int columns, double* P) noexcept {
  for (int i = 0; i < panels; ++i) {
    for (int j = 0; j <= i; ++j) {
      double* a = P + (i * columns + j * kPanel) * kPanel;
      double* b = P + (j * columns + i * kPanel) * kPanel;
      double t[kPanel * kPanel];
      for (int c = 0; c < kPanel; ++c) {
        for (int r = 0; r < kPanel; ++r) t[r * kPanel + c] = a[c * kPanel + r];
      }
      if (i != j) {
        for (int c = 0; c < kPanel; ++c) {
          for (int r = 0; r < kPanel; ++r) a[r * kPanel + c] = b[c * kPanel + r];
        }
      }
      std::memcpy(b, t, sizeof t);
    }
  }
}

// Copies the panels from `first` on, left of column 8 * first, to their mirrored places.
void mirror_lower(int first, int panels, double* P) noexcept {
  const int columns = kPanel * panels;
  for (int i = first; i < panels; ++i) {
    for (int j = 0; j < first; ++j) {
      const double* a = P + (i * columns + j * kPanel) * kPanel;
      double* b = P + (j * columns + i * kPanel) * kPanel;
      for (int c = 0; c < kPanel; ++c) {
        for (int r = 0; r < kPanel; ++r) b[r * kPanel + c] = a[c * kPanel + r];
      }
    }
  }
}

}  // namespace

Covariance::Buffer Covariance::allocate(std::size_t count) {
  auto* data = static_cast<double*>(::operator new[](count * sizeof(double), kAlignment));
  std::fill_n(data, count, 0.0);
  return {data, [](double* p) { ::operator delete[](p, kAlignment); }};
}

Covariance::Covariance(const BodyLayout& layout, int most_rows)
    : layout_(&layout),
      panels_(server::panels(layout.size())),
      most_rows_(most_rows),
      P_(allocate(static_cast<std::size_t>(panels_ * kPanel * panels_ * kPanel))),
      B_(allocate(static_cast<std::size_t>(panels_ * kPanel * most_rows))),
      A_(allocate(static_cast<std::size_t>(panels_ * kPanel * server::panels(most_rows) * kPanel))),
      Lp_(allocate(static_cast<std::size_t>(server::panels(most_rows) * kPanel * most_rows))),
      Bt_(static_cast<std::size_t>(panels_ * kPanel * most_rows)),
      S_(static_cast<std::size_t>(most_rows * most_rows)),
      y_(static_cast<std::size_t>(most_rows)),
      F_(static_cast<std::size_t>(layout.groups + 1)) {
  if (most_rows > kMostRows) {
    throw std::invalid_argument("wearable filter: more boards than one set of readings can have");
  }
}

void Covariance::clear() noexcept {
  std::fill_n(P_.get(), panels_ * kPanel * panels_ * kPanel, 0.0);
}

double& Covariance::element(int row, int column) noexcept {
  return P_[static_cast<std::size_t>(((row / kPanel) * panels_ * kPanel + column) * kPanel +
                                     row % kPanel)];
}

double Covariance::at(int row, int column) const noexcept {
  return const_cast<Covariance*>(this)->element(row, column);
}

void Covariance::reset(int column, double variance) noexcept {
  for (int i = 0; i < layout_->size(); ++i) element(i, column) = element(column, i) = 0.0;
  element(column, column) = variance;
}

void Covariance::reset_block(int column, const Eigen::Matrix3d& covariance) noexcept {
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) element(column + i, column + j) = covariance(i, j);
  }
}

void Covariance::add(int column, double variance) noexcept { element(column, column) += variance; }

void Covariance::predict(const BodyState& state, double time, const ProcessNoise& noise) noexcept {
  const BodyLayout& layout = *layout_;
  const double half = 0.5 * time * time;
  for (int g = 0; g <= layout.groups; ++g) {
    ColumnTransition& f = F_[static_cast<std::size_t>(g)];
    GroupTransition t{Eigen::Matrix3d::Identity(), Eigen::Matrix3d::Identity()};
    if (g < layout.groups) t = transition(state.groups[static_cast<std::size_t>(g)], time);
    // The root's position comes after the last group in each level.
    f.rotation = layout.rotation(g, 0);
    f.rate = layout.rotation(g, 1);
    f.acceleration = layout.rotation(g, 2);
    f.time = time;
    for (int r = 0; r < 3; ++r) {
      for (int c = 0; c < 3; ++c) {
        f.turn[r][c] = t.turn(r, c);
        f.by_rate[r][c] = time * t.jacobian(r, c);
        f.by_acceleration[r][c] = half * t.jacobian(r, c);
      }
    }
  }
  // P F^T; then (P F^T)^T F^T where F is not the identity, and the rest by symmetry.
  const int moving = server::panels(layout.moving());
  transform_columns(panels_, panels_ * kPanel, F_, P_.get());
  transpose_square(moving, panels_ * kPanel, P_.get());
  transform_columns(moving, panels_ * kPanel, F_, P_.get());
  mirror_lower(moving, panels_, P_.get());

  // White jerk of spectral density q over the time: integrals of exp(F s) G q G^T exp(F s)^T.
  const Eigen::Matrix3d Q = white_jerk(time);
  const int level = layout.level_size();
  const auto drive = [&](int row, int column, double q) {
    for (int a = 0; a < 3; ++a) {
      for (int b = 0; b < 3; ++b) {
        for (int i = 0; i < 3; ++i) {
          element(row + a * level + i, column + b * level + i) += q * Q(a, b);
        }
      }
    }
  };
  drive(layout.rotation(0, 0), layout.rotation(0, 0), noise.root_turn_jerk);
  drive(layout.root(0), layout.root(0), noise.root_jerk);
  // The sum of a chain's m members has a joint's jerk; against each other they have little.
  for (const std::vector<int>& chain : layout.chains) {
    const auto m = static_cast<double>(chain.size());
    for (const int i : chain) {
      for (const int j : chain) {
        const double apart = (i == j ? 1.0 : 0.0) - 1.0 / m;
        drive(layout.rotation(i, 0), layout.rotation(j, 0),
              noise.joint_jerk / (m * m) + noise.chain_jerk * apart);
      }
    }
  }
  for (int i = 0; i < 3 * layout.boards; ++i) {
    add(layout.moving() + i, time * noise.gyro_bias);
    add(layout.moving() + 3 * layout.boards + i, time * noise.accel_bias);
    add(layout.moving() + 6 * layout.boards + i, time * noise.mount);
  }
  add(layout.sound(), time * noise.sound);
}

void Covariance::gate(const ObservationSet& set, const std::array<double, 3>& gates,
                      std::span<const char> relax, std::span<char> passed) noexcept {
  const int k = set.size();
  const auto s = [&](int i, int j) -> double& { return S_[static_cast<std::size_t>(i * k + j)]; };
  for (std::size_t o = 0; o < set.rows.size(); ++o) {
    const SparseRows& rows = set.rows[o];
    // d^2 by the Cholesky factor of the observation's own block of S.
    double L[3][3] = {}, z[3] = {}, d2 = 0.0;
    for (int i = 0; i < rows.rows; ++i) {
      double rest = y_[static_cast<std::size_t>(rows.first + i)];
      for (int j = 0; j <= i; ++j) {
        double sum = s(rows.first + i, rows.first + j);
        for (int m = 0; m < j; ++m) sum -= L[i][m] * L[j][m];
        if (j < i) {
          L[i][j] = sum / L[j][j];
          rest -= L[i][j] * z[j];
        } else {
          L[i][i] = std::sqrt(sum);
        }
      }
      z[i] = rest / L[i][i];
      d2 += z[i] * z[i];
    }
    const double limit = gates[static_cast<std::size_t>(rows.rows - 1)];
    passed[o] = d2 <= limit;  // false for a NaN
    if (passed[o]) continue;
    if (relax[o] && std::isfinite(d2)) {
      const double factor = d2 / limit;
      for (int i = 0; i < rows.rows; ++i) {
        for (int j = 0; j < rows.rows; ++j) s(rows.first + i, rows.first + j) *= factor;
      }
      continue;
    }
    // Left out: its rows of S become those of an observation of nothing.
    for (int i = rows.first; i < rows.first + rows.rows; ++i) {
      for (int j = 0; j < k; ++j) s(i, j) = s(j, i) = 0.0;
      s(i, i) = 1.0;
      y_[static_cast<std::size_t>(i)] = 0.0;
      for (int p = 0; p < panels_; ++p) {
        std::fill_n(B_.get() + (p * k + i) * kPanel, kPanel, 0.0);
      }
    }
  }
}

// S_ becomes its Cholesky factor, then that factor's inverse; Lp_ the inverse in panels.
bool Covariance::factorise(int k) noexcept {
  using Matrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
  Eigen::Map<Matrix> S(S_.data(), k, k);
  for (int i = 0; i < k; ++i) {
    for (int j = 0; j <= i; ++j) {
      const double sum = S(i, j) - S.row(i).head(j).dot(S.row(j).head(j));
      if (j < i) {
        S(i, j) = sum / S(j, j);
      } else if (sum > 0.0) {
        S(i, i) = std::sqrt(sum);
      } else {
        return false;
      }
    }
  }
  // Row i of the inverse from the rows above it: L^-1(i, :) = -(L(i, :i) L^-1(:i, :)) / L(i, i).
  const int blocks = server::panels(k);
  std::fill_n(Lp_.get(), blocks * kPanel * k, 0.0);
  for (int i = 0; i < k; ++i) {
    const double scale = 1.0 / S(i, i);
    std::array<double, kMostRows> row;
    Eigen::Map<Eigen::RowVectorXd> out(row.data(), i);
    out.setZero();
    for (int m = 0; m < i; ++m) out.head(m + 1) -= S(i, m) * S.row(m).head(m + 1);
    S.row(i).head(i) = scale * out;
    S(i, i) = scale;
    for (int j = 0; j <= i; ++j) {
      Lp_[static_cast<std::size_t>(((i / kPanel) * k + j) * kPanel + i % kPanel)] = S(i, j);
    }
  }
  return true;
}

UpdateResult Covariance::update(const ObservationSet& set, const std::array<double, 3>& gates,
                                std::span<const char> relax, std::span<char> passed,
                                std::span<double> error) noexcept {
  const int k = set.size();
  assert(k <= most_rows_ && static_cast<int>(error.size()) >= padded_size());
  std::fill(error.begin(), error.end(), 0.0);
  if (k == 0) return {};

  times_transposed_sparse(panels_, k, P_.get(), set.rows, set.entries, B_.get());
  for (int p = 0; p < panels_; ++p) {
    for (int j = 0; j < k; ++j) {
      const double* from = B_.get() + (p * k + j) * kPanel;
      for (int r = 0; r < kPanel; ++r) {
        Bt_[static_cast<std::size_t>((p * kPanel + r) * k + j)] = from[r];
      }
    }
  }
  // S = H B + R, rows of H times B; the upper half follows.
  std::fill_n(S_.begin(), k * k, 0.0);
  for (const SparseRows& rows : set.rows) {
    const int reach = rows.first + rows.rows;
    for (int e = rows.begin; e < rows.end; ++e) {
      const SparseEntry& entry = set.entries[static_cast<std::size_t>(e)];
      const double* b = Bt_.data() + entry.column * k;
      for (int r = 0; r < rows.rows; ++r) {
        double* s = S_.data() + (rows.first + r) * k;
        for (int j = 0; j < reach; ++j) s[j] += entry.h[r] * b[j];
      }
    }
  }
  for (int i = 0; i < k; ++i) {
    const auto at = static_cast<std::size_t>(i);
    S_[at * static_cast<std::size_t>(k + 1)] += set.variance[at];
    y_[at] = set.y[at];
  }
  gate(set, gates, relax, passed);
  UpdateResult result;
  for (std::size_t o = 0; o < set.rows.size(); ++o) {
    if (passed[o] || relax[o]) result.rows += set.rows[o].rows;
  }
  if (result.rows == 0 || !factorise(k)) {
    std::fill(passed.begin(), passed.end(), 0);
    return {};
  }

  const int blocks = server::panels(k);
  times_transposed_lower(panels_, k, B_.get(), Lp_.get(), A_.get());
  for (int i = 0; i < k; ++i) {  // z = L^-1 y; error = A z
    double z = 0.0;
    for (int j = 0; j <= i; ++j) {
      z += S_[static_cast<std::size_t>(i * k + j)] * y_[static_cast<std::size_t>(j)];
    }
    result.nis += z * z;
    for (int p = 0; p < panels_; ++p) {
      const double* a = A_.get() + (p * blocks * kPanel + i) * kPanel;
      for (int r = 0; r < kPanel; ++r) error[static_cast<std::size_t>(p * kPanel + r)] += z * a[r];
    }
  }
  subtract_outer(panels_, blocks * kPanel, A_.get(), P_.get());
  return result;
}

}  // namespace secondskin::server
