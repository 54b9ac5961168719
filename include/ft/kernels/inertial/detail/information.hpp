// SPDX-License-Identifier: Apache-2.0
/// @file Information matrices of integrals, and of what is left of a state when another one is
/// eliminated.
#pragma once

#include "ft/containers/inertial.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/math/block_systems.hpp"
#include "ft/math/group_eigen.hpp"
#include "ft/math/so3.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// Working memory of matrix functions.
struct information_scratch {
  block_elimination system;
  symmetric_eigen eigen;
};

/// Eigenvalues below this one are set to 0.
inline constexpr double least_information = 1e-12;
/// Singular values up to this one are not inverted.
inline constexpr double least_eliminated = 1e-6;

/// Inverse of an integral's covariance of rotation, velocity and position, as an information
/// matrix: eigenvalues that are not positive are set to 0. A covariance of one step has rank 6; its
/// three smallest eigenvalues, which are rounding errors, are then no information.
/// @param as_they_are one step is like many: rounding errors that are positive are inverted, too
/// @param omega result, 9 x 9
template <typename Group>
FT_HOST_DEVICE void information_of(Group g, information_scratch& s, preintegrated const& integral,
                                   bool as_they_are, real64* omega) {
  constexpr int n = 9;
  auto const C = [&](int i, int j) {
    return real64(0.5) * (real64(static_cast<double>(integral.C[n * i + j])) +
                          real64(static_cast<double>(integral.C[n * j + i])));
  };
  for (int k = g.rank(); k < n * n; k += g.size()) {
    int const i = k / n;
    int const j = k - n * i;
    s.system.a[i][j] = C(i, j);
    s.system.a[i][n + j] = i == j ? 1.0 : 0.0;
    s.eigen.a[k] = C(i, j);
  }
  if (g.rank() == 0) { s.system.begin(); }
  g.sync();
  if (integral.steps > 1 || as_they_are) {
    s.system.eliminate_all(g, 0, n, 2 * n);
    if (s.system.positive != 0) {
      for (int k = g.rank(); k < n * n; k += g.size()) {
        int const i = k / n;
        int const j = k - n * i;
        auto const entry = [&](int r, int c) {
          strict_vec3d const x = s.system.solution(r / 3 * 3, n + c);
          return r % 3 == 0 ? x.x : (r % 3 == 1 ? x.y : x.z);
        };
        omega[k] = real64(0.5) * (entry(i, j) + entry(j, i));
      }
      g.sync();
      return;
    }
  }
  s.eigen.diagonalize(g, n);
  auto const inverted = [&](int k) {
    real64 const value = s.eigen.value(k, n);
    int below = 0;
    for (int m = 0; m < n; ++m) {
      real64 const other = s.eigen.value(m, n);
      below += static_cast<int>(other < value || (other == value && m < k));
    }
    bool const noise = integral.steps == 1 && !as_they_are && below < 3;
    return noise || !(value > real64(0.0)) ? real64(0.0) : scalar::reciprocal(value);
  };
  for (int k = g.rank(); k < n * n; k += g.size()) {
    int const i = k / n;
    omega[k] = s.eigen.recomposed(n, i, k - n * i, inverted);
  }
  g.sync();
}

/// Rows of a state: rotation, position, velocity, gyro bias, accelerometer bias.
inline constexpr int state_rows = 15;

/// Copies the 15 x 15 block of the system's upper triangle whose first row and column is `at` to
/// eigen.a, both triangles. Ends with a sync.
template <typename Group>
FT_HOST_DEVICE void copy_block(Group g, information_scratch& s, int at) {
  constexpr int n = state_rows;
  for (int k = g.rank(); k < n * n; k += g.size()) {
    int const i = k / n;
    int const j = k - n * i;
    s.eigen.a[k] = s.system.a[at + min_of(i, j)][at + max_of(i, j)];
  }
  g.sync();
}

/// Whether that block is positive definite when `shift` is subtracted from its diagonal. The
/// block's upper triangle is overwritten. Ends with a sync.
template <typename Group>
FT_HOST_DEVICE bool exceeds(Group g, information_scratch& s, int at, double shift) {
  if (g.rank() == 0) { s.system.begin(); }
  for (int k = g.rank(); k < state_rows; k += g.size()) { s.system.a[at + k][at + k] -= shift; }
  g.sync();
  for (int first = at; first < at + state_rows; first += 3) {
    s.system.eliminate(g, first, first + 3, at + state_rows, at + state_rows);
  }
  return s.system.positive != 0;
}

/// The 15 x 15 block of the system at `at` in other unknowns: A^T H A.
/// @param entry entry (i, j) of A's first 6 rows and columns; the rest of A is the identity
template <typename Group, typename Entry>
FT_HOST_DEVICE void change_unknowns(Group g, information_scratch& s, int at, Entry const& entry) {
  constexpr int n = state_rows;
  copy_block(g, s, at);
  real64 const* const H = s.eigen.a;
  real64* const HA = s.eigen.v;
  for (int k = g.rank(); k < n * n; k += g.size()) {
    int const i = k / n;
    int const j = k - n * i;
    real64 sum = j < 6 ? real64(0.0) : H[k];
    for (int m = 0; j < 6 && m < 6; ++m) { sum += H[n * i + m] * entry(m, j); }
    HA[k] = sum;
  }
  g.sync();
  for (int k = g.rank(); k < n * n; k += g.size()) {
    int const i = k / n;
    int const j = k - n * i;
    if (i > j) { continue; }
    real64 sum = i < 6 ? real64(0.0) : HA[k];
    for (int m = 0; i < 6 && m < 6; ++m) { sum += entry(m, i) * HA[n * m + j]; }
    s.system.a[at + i][at + j] = sum;
  }
  g.sync();
}

/// Eliminates the first 15 of the system's 30 rows: rows 15 to 29 get H22 - H21 H11^+ H12, where
/// singular values up to 1e-6 are not inverted. Where H11 has none of those, that is a Schur
/// complement. The group has synced; ends with a sync.
template <typename Group>
FT_HOST_DEVICE void eliminate_first_state(Group g, information_scratch& s) {
  constexpr int n = state_rows;
  auto& a = s.system.a;
  copy_block(g, s, 0);
  if (exceeds(g, s, 0, least_eliminated)) {
    for (int k = g.rank(); k < n * n; k += g.size()) { a[k / n][k % n] = s.eigen.a[k]; }
    g.sync();
    for (int first = 0; first < n; first += 3) {
      s.system.eliminate(g, first, first + 3, 2 * n, 2 * n);
    }
    return;
  }
  s.eigen.diagonalize(g, n);
  // V^T H12, in place of H11.
  for (int k = g.rank(); k < n * n; k += g.size()) {
    int const i = k / n;
    int const j = k - n * i;
    real64 sum = 0.0;
    for (int m = 0; m < n; ++m) { sum += s.eigen.v[m * n + i] * a[m][n + j]; }
    a[i][j] = sum;
  }
  g.sync();
  for (int k = g.rank(); k < n * n; k += g.size()) {
    int const i = k / n;
    int const j = k - n * i;
    if (i > j) { continue; }
    real64 sum = 0.0;
    for (int m = 0; m < n; ++m) {
      real64 const value = s.eigen.value(m, n);
      if (scalar::abs(value) > real64(least_eliminated)) { sum += a[m][i] * a[m][j] / value; }
    }
    a[n + i][n + j] -= sum;
  }
  g.sync();
}

/// The 15 x 15 block of the system at `at` as an information matrix: eigenvalues below 1e-12 are
/// set to 0. Where there are none it is the block itself. The group has synced.
/// @param information result, row-major
template <typename Group>
FT_HOST_DEVICE void write_information(Group g, information_scratch& s, int at,
                                      double* information) {
  constexpr int n = state_rows;
  copy_block(g, s, at);
  bool const whole = exceeds(g, s, at, least_information);
  if (!whole) { s.eigen.diagonalize(g, n); }
  auto const clipped = [&](int k) {
    real64 const value = s.eigen.value(k, n);
    return value < real64(least_information) ? real64(0.0) : value;
  };
  for (int k = g.rank(); k < n * n; k += g.size()) {
    int const i = k / n;
    information[k] = (whole ? s.eigen.a[k] : s.eigen.recomposed(n, i, k - n * i, clipped)).value;
  }
  g.sync();
}

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
