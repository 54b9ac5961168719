// SPDX-License-Identifier: Apache-2.0
/// @file The covariance of a pose from its information matrix.
#pragma once

#include <cmath>
#include <limits>

#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// Writes infinite variances without covariances.
inline void unknown_covariance(double (&out)[36]) {
  for (int i = 0; i < 36; ++i) {
    out[i] = i % 7 == 0 ? std::numeric_limits<double>::infinity() : 0.0;
  }
}

/// Inverts a symmetric 6 x 6 matrix by a Cholesky factorisation. The covariance of a matrix that is
/// not positive definite is unknown.
/// @param upper its upper triangle by rows
inline void invert_information(float const* upper, double (&out)[36]) {
  using real = strict_double;
  real L[6][6];  // lower factor
  int at = 0;
  for (int i = 0; i < 6; ++i) {
    for (int j = i; j < 6; ++j) { L[j][i] = real(static_cast<double>(upper[at++])); }
  }
  for (int i = 0; i < 6; ++i) {
    for (int j = i; j < 6; ++j) {
      for (int k = 0; k < i; ++k) { L[j][i] = L[j][i] - L[j][k] * L[i][k]; }
    }
    if (!(L[i][i] > real(0))) { return unknown_covariance(out); }
    real const root = scalar::sqrt(L[i][i]);
    for (int j = i; j < 6; ++j) { L[j][i] = L[j][i] / root; }
  }
  for (int column = 0; column < 6; ++column) {
    real x[6];
    for (int i = 0; i < 6; ++i) {
      x[i] = i == column ? 1.0 : 0.0;
      for (int k = 0; k < i; ++k) { x[i] = x[i] - L[i][k] * x[k]; }
      x[i] = x[i] / L[i][i];
    }
    for (int i = 5; i >= 0; --i) {
      for (int k = i + 1; k < 6; ++k) { x[i] = x[i] - L[k][i] * x[k]; }
      x[i] = x[i] / L[i][i];
      // The lower triangle is written last, from the upper one: exactly symmetric.
      if (i <= column) { out[6 * i + column] = out[6 * column + i] = x[i].value; }
    }
  }
}

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
