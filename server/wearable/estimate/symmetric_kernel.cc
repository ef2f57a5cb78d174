#include "server/wearable/estimate/symmetric_kernel.h"

#include <cstring>

// The same source is compiled for three instruction sets by inlining it into functions with a
// target attribute; target_clones would do so too, but its resolvers run before the sanitizers'
// start.
#define SECONDSKIN_INLINE inline __attribute__((always_inline))

namespace secondskin::server {
namespace {

template <int kLanes>
struct Lanes;
template <>
struct Lanes<2> {
  typedef double Vector __attribute__((vector_size(16), may_alias));
};
template <>
struct Lanes<4> {
  typedef double Vector __attribute__((vector_size(32), may_alias));
};
template <>
struct Lanes<8> {
  typedef double Vector __attribute__((vector_size(64), may_alias));
};

// c[8][kColumns] = sum over j < k of a[j][8] * b[j][column + 0..kColumns-1], kept in registers.
// a and b are columns of panels. Written to c column by column.
template <int kLanes, int kColumns>
SECONDSKIN_INLINE void tile(int k, const double* a, const double* b, double* c) noexcept {
  using V = typename Lanes<kLanes>::Vector;
  constexpr int kParts = kPanel / kLanes;
  V sum[kParts][kColumns];
  for (int p = 0; p < kParts; ++p) {
    for (int j = 0; j < kColumns; ++j) sum[p][j] = V{};
  }
  for (int m = 0; m < k; ++m) {
    for (int p = 0; p < kParts; ++p) {
      const V left = *reinterpret_cast<const V*>(a + m * kPanel + p * kLanes);
      for (int j = 0; j < kColumns; ++j) sum[p][j] += left * b[m * kPanel + j];
    }
  }
  for (int j = 0; j < kColumns; ++j) {
    for (int p = 0; p < kParts; ++p) {
      *reinterpret_cast<V*>(c + j * kPanel + p * kLanes) = sum[p][j];
    }
  }
}

template <int kLanes, int kColumns>
SECONDSKIN_INLINE void subtract_outer_with(int panels, int k, const double* A, double* P) noexcept {
  const int columns = kPanel * panels;
  alignas(64) double product[kPanel * kPanel];
  for (int i = 0; i < panels; ++i) {
    for (int j = 0; j <= i; ++j) {
      for (int c = 0; c < kPanel; c += kColumns) {
        tile<kLanes, kColumns>(k, A + i * k * kPanel, A + j * k * kPanel + c, product + c * kPanel);
      }
      double* lower = P + (i * columns + j * kPanel) * kPanel;
      for (int e = 0; e < kPanel * kPanel; ++e) lower[e] -= product[e];
      // The mirrored tile. On the diagonal this makes the upper half the lower one's copy.
      double* upper = P + (j * columns + i * kPanel) * kPanel;
      for (int c = 0; c < kPanel; ++c) {
        for (int r = (i == j ? c + 1 : 0); r < kPanel; ++r) {
          upper[r * kPanel + c] = lower[c * kPanel + r];
        }
      }
    }
  }
}

template <int kLanes, int kColumns>
SECONDSKIN_INLINE void times_transposed_lower_with(int panels, int k, const double* B,
                                                   const double* L, double* A) noexcept {
  const int blocks = server::panels(k);
  for (int i = 0; i < panels; ++i) {
    for (int j = 0; j < blocks; ++j) {
      const int reach = k < (j + 1) * kPanel ? k : (j + 1) * kPanel;  // L is zero beyond
      for (int c = 0; c < kPanel; c += kColumns) {
        tile<kLanes, kColumns>(reach, B + i * k * kPanel, L + j * k * kPanel + c,
                               A + (i * blocks * kPanel + j * kPanel + c) * kPanel);
      }
    }
  }
}

template <int kLanes, int kRows>
SECONDSKIN_INLINE void sparse_product(const double* P, const SparseEntry* begin,
                                      const SparseEntry* end, double* out) noexcept {
  using V = typename Lanes<kLanes>::Vector;
  constexpr int kParts = kPanel / kLanes;
  V sum[kParts][kRows];
  for (int p = 0; p < kParts; ++p) {
    for (int r = 0; r < kRows; ++r) sum[p][r] = V{};
  }
  for (const SparseEntry* e = begin; e != end; ++e) {
    for (int p = 0; p < kParts; ++p) {
      const V column = *reinterpret_cast<const V*>(P + e->column * kPanel + p * kLanes);
      for (int r = 0; r < kRows; ++r) sum[p][r] += column * e->h[r];
    }
  }
  for (int r = 0; r < kRows; ++r) {
    for (int p = 0; p < kParts; ++p) {
      *reinterpret_cast<V*>(out + r * kPanel + p * kLanes) = sum[p][r];
    }
  }
}

template <int kLanes>
SECONDSKIN_INLINE void times_transposed_sparse_with(int panels, int k, const double* P,
                                                    std::span<const SparseRows> rows,
                                                    std::span<const SparseEntry> entries,
                                                    double* B) noexcept {
  for (int i = 0; i < panels; ++i) {
    const double* from = P + i * panels * kPanel * kPanel;
    for (const SparseRows& set : rows) {
      const SparseEntry* begin = entries.data() + set.begin;
      const SparseEntry* end = entries.data() + set.end;
      double* out = B + (i * k + set.first) * kPanel;
      if (set.rows == 1) {
        sparse_product<kLanes, 1>(from, begin, end, out);
      } else if (set.rows == 2) {
        sparse_product<kLanes, 2>(from, begin, end, out);
      } else {
        sparse_product<kLanes, 3>(from, begin, end, out);
      }
    }
  }
}

template <int kLanes>
SECONDSKIN_INLINE void transform_columns_with(int panels, int columns,
                                              std::span<const ColumnTransition> F,
                                              double* P) noexcept {
  using V = typename Lanes<kLanes>::Vector;
  for (int i = 0; i < panels; ++i) {
    for (const ColumnTransition& f : F) {
      for (int p = 0; p < kPanel; p += kLanes) {
        double* panel = P + i * columns * kPanel + p;
        const auto at = [panel](int column) {
          return reinterpret_cast<V*>(panel + column * kPanel);
        };
        V e[3], w[3], a[3];
        for (int c = 0; c < 3; ++c) {
          e[c] = *at(f.rotation + c);
          w[c] = *at(f.rate + c);
          a[c] = *at(f.acceleration + c);
        }
        for (int r = 0; r < 3; ++r) {
          V sum = V{};
          for (int c = 0; c < 3; ++c) {
            sum += e[c] * f.turn[r][c] + w[c] * f.by_rate[r][c] + a[c] * f.by_acceleration[r][c];
          }
          *at(f.rotation + r) = sum;
          *at(f.rate + r) = w[r] + a[r] * f.time;
        }
      }
    }
  }
}

// One set of entry points for each instruction set. The number of columns of a tile fills the
// registers: 8 of 32, 8 of 16, 8 of 16.
#define SECONDSKIN_KERNELS(suffix, attribute, kLaneCount, kTile)                                   \
  attribute void subtract_outer_##suffix(int panels, int k, const double* A, double* P) noexcept { \
    subtract_outer_with<kLaneCount, kTile>(panels, k, A, P);                                       \
  }                                                                                                \
  attribute void times_transposed_lower_##suffix(int panels, int k, const double* B,               \
                                                 const double* L, double* A) noexcept {            \
    times_transposed_lower_with<kLaneCount, kTile>(panels, k, B, L, A);                            \
  }                                                                                                \
  attribute void times_transposed_sparse_##suffix(                                                 \
      int panels, int k, const double* P, std::span<const SparseRows> rows,                        \
      std::span<const SparseEntry> entries, double* B) noexcept {                                  \
    times_transposed_sparse_with<kLaneCount>(panels, k, P, rows, entries, B);                      \
  }                                                                                                \
  attribute void transform_columns_##suffix(                                                       \
      int panels, int columns, std::span<const ColumnTransition> F, double* P) noexcept {          \
    transform_columns_with<kLaneCount>(panels, columns, F, P);                                     \
  }

SECONDSKIN_KERNELS(baseline, , 2, 2)
#if defined(__x86_64__)
SECONDSKIN_KERNELS(avx2, __attribute__((target("avx2,fma"))), 4, 4)
SECONDSKIN_KERNELS(avx512, __attribute__((target("avx512f,avx512vl,avx512dq,fma"))), 8, 8)
#endif

struct Kernels {
  const char* name;
  void (*subtract_outer)(int, int, const double*, double*) noexcept;
  void (*times_transposed_lower)(int, int, const double*, const double*, double*) noexcept;
  void (*times_transposed_sparse)(int, int, const double*, std::span<const SparseRows>,
                                  std::span<const SparseEntry>, double*) noexcept;
  void (*transform_columns)(int, int, std::span<const ColumnTransition>, double*) noexcept;
};

Kernels choose() noexcept {
#if defined(__x86_64__)
  if (__builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512vl") &&
      __builtin_cpu_supports("avx512dq")) {
    return {"avx512", subtract_outer_avx512, times_transposed_lower_avx512,
            times_transposed_sparse_avx512, transform_columns_avx512};
  }
  if (__builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma")) {
    return {"avx2", subtract_outer_avx2, times_transposed_lower_avx2, times_transposed_sparse_avx2,
            transform_columns_avx2};
  }
#endif
  return {"baseline", subtract_outer_baseline, times_transposed_lower_baseline,
          times_transposed_sparse_baseline, transform_columns_baseline};
}

const Kernels& kernels() noexcept {
  static const Kernels chosen = choose();
  return chosen;
}

}  // namespace

void subtract_outer(int panels, int k, const double* A, double* P) noexcept {
  kernels().subtract_outer(panels, k, A, P);
}
void times_transposed_lower(int panels, int k, const double* B, const double* L,
                            double* A) noexcept {
  kernels().times_transposed_lower(panels, k, B, L, A);
}
void times_transposed_sparse(int panels, int k, const double* P, std::span<const SparseRows> rows,
                             std::span<const SparseEntry> entries, double* B) noexcept {
  kernels().times_transposed_sparse(panels, k, P, rows, entries, B);
}
void transform_columns(int panels, int columns, std::span<const ColumnTransition> F,
                       double* P) noexcept {
  kernels().transform_columns(panels, columns, F, P);
}
const char* kernel_name() noexcept { return kernels().name; }

}  // namespace secondskin::server
