#pragma once

#include <span>

/// The few dense products in which the filter spends its time, for the processor that it finds
/// itself on (AVX-512, AVX2 with FMA, or what the compiler's baseline has).
///
/// Panel layout: a matrix of r rows and c columns lies as ceil(r / 8) panels of 8 rows, each panel
/// column by column: element (i, j) at [(i / 8) * c + j] * 8 + i % 8. Rows beyond r are zero.
namespace secondskin::server {

inline constexpr int kPanel = 8;
constexpr int panels(int rows) noexcept { return (rows + kPanel - 1) / kPanel; }

/// Up to three rows of a sparse matrix H: they share the columns in which they are not zero.
struct SparseEntry {
  int column;
  double h[3];  ///< one a row; those beyond the row count are not read
};
struct SparseRows {
  int first;       ///< row of H
  int rows;        ///< 1 to 3
  int begin, end;  ///< its entries
};

/// P -= A A^T.
/// @param P  symmetric, 8 * panels columns in panel layout; both triangles are written
/// @param A  k columns in panel layout, as many panels as P
void subtract_outer(int panels, int k, const double* A, double* P) noexcept;

/// A = B L^T with L lower triangular of k rows.
/// @param B  k columns in panel layout
/// @param L  k columns in panel layout, its k rows filled up to 8 * panels(k) with zeros
/// @param A  8 * panels(k) columns in panel layout
void times_transposed_lower(int panels, int k, const double* B, const double* L,
                            double* A) noexcept;

/// B = P H^T. @param B  k columns in panel layout
void times_transposed_sparse(int panels, int k, const double* P, std::span<const SparseRows> rows,
                             std::span<const SparseEntry> entries, double* B) noexcept;

/// How a group's three error columns at each of the levels rotation, rate, acceleration become the
/// new ones: e' = turn * e + rate * e_w + acceleration * e_dw, e_w' = e_w + time * e_dw.
struct ColumnTransition {
  int rotation, rate, acceleration;  ///< first column of three
  double turn[3][3], by_rate[3][3], by_acceleration[3][3];
  double time;
};

/// P = P F^T for a matrix of `columns` columns in panel layout.
void transform_columns(int panels, int columns, std::span<const ColumnTransition> F,
                       double* P) noexcept;

/// Which instructions are used: "avx512", "avx2" or "baseline".
const char* kernel_name() noexcept;

}  // namespace secondskin::server
