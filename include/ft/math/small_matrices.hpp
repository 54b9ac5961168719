// SPDX-License-Identifier: Apache-2.0
/// @file Small vectors and matrices of strict numbers: norms, determinants, products with a cross
/// product, ranks. Equal bits on every executor.
#pragma once

#include <cstdint>
#include <cstring>

#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

using real64 = strict_double;  ///< for formulas that are long

using strict_vec3d = vec3<strict_double>;
using strict_mat3d = mat3<strict_double>;
using strict_vec3f = vec3<strict_float>;
using strict_mat3f = mat3<strict_float>;

FT_HOST_DEVICE inline real64 norm(strict_vec3d v) { return scalar::sqrt(dot(v, v)); }
FT_HOST_DEVICE inline strict_vec3d unit(strict_vec3d v) {
  return scaled(v, scalar::reciprocal(norm(v)));
}
FT_HOST_DEVICE inline strict_vec3d row_of(strict_mat3d const& A, int r) {
  return {A.m[3 * r], A.m[3 * r + 1], A.m[3 * r + 2]};
}
FT_HOST_DEVICE inline strict_vec3d column_of(strict_mat3d const& A, int c) {
  return {A.m[c], A.m[3 + c], A.m[6 + c]};
}
FT_HOST_DEVICE inline strict_mat3d from_rows(strict_vec3d a, strict_vec3d b, strict_vec3d c) {
  return {{a.x, a.y, a.z, b.x, b.y, b.z, c.x, c.y, c.z}};
}
/// Row vector v times A.
FT_HOST_DEVICE inline strict_vec3d row_times(strict_vec3d v, strict_mat3d const& A) {
  return {v.x * A.m[0] + (v.y * A.m[3] + v.z * A.m[6]),
          v.x * A.m[1] + (v.y * A.m[4] + v.z * A.m[7]),
          v.x * A.m[2] + (v.y * A.m[5] + v.z * A.m[8])};
}
FT_HOST_DEVICE inline real64 determinant(strict_mat3d const& A) {
  return dot(cross(row_of(A, 0), row_of(A, 1)), row_of(A, 2));
}

FT_HOST_DEVICE inline strict_mat3f sum(strict_mat3f const& a, strict_mat3f const& b) {
  strict_mat3f c;
  FT_UNROLL
  for (int i = 0; i < 9; ++i) { c.m[i] = a.m[i] + b.m[i]; }
  return c;
}

/// a [v], where [v] u = v x u.
FT_HOST_DEVICE inline strict_mat3f times_cross(strict_mat3f const& a, strict_vec3f v) {
  strict_mat3f c;
  FT_UNROLL
  for (int i = 0; i < 9; i += 3) {
    c.m[i] = a.m[i + 1] * v.z - a.m[i + 2] * v.y;
    c.m[i + 1] = a.m[i + 2] * v.x - a.m[i] * v.z;
    c.m[i + 2] = a.m[i] * v.y - a.m[i + 1] * v.x;
  }
  return c;
}

/// [v], where [v] u = v x u.
FT_HOST_DEVICE inline strict_mat3d cross_matrix(strict_vec3d v) {
  real64 const zero = 0.0;
  return {{zero, -v.z, v.y, v.z, zero, -v.x, -v.y, v.x, zero}};
}

/// The cube root, with an error of a few units in the last place; 0, infinity and NaN as they are.
/// Halley's iteration triples the correct digits, from 1.3 that a third of the bits, read as a
/// whole number, has.
FT_HOST_DEVICE inline real64 cube_root(real64 v) {
  if (!(v.value > 1e-300 && v.value < 1e300)) { return v; }
  std::uint64_t bits;
  std::memcpy(&bits, &v.value, sizeof bits);
  bits = bits / 3 + 0x2A9F7893782DA1CEull;
  double start;
  std::memcpy(&start, &bits, sizeof start);
  real64 y = start;
  FT_UNROLL
  for (int i = 0; i < 3; ++i) {
    real64 const cube = y * y * y;
    y = y * ((cube + v + v) / (cube + cube + v));
  }
  return y;
}

/// Rank by Householder's QR with full pivoting: pivots above 6.66e-16 of the largest count. Source:
/// Golub and Van Loan, "Matrix computations", section 5.5.7.
FT_HOST_DEVICE inline int rank_of(strict_mat3d const& M) {
  strict_vec3d column[3] = {column_of(M, 0), column_of(M, 1), column_of(M, 2)};
  real64 pivot[3] = {0.0, 0.0, 0.0};
  // Turning the rows of the corner that is left changes no norm, so that the pivot's column alone
  // matters. It is projected out of the others.
  bool used[3] = {false, false, false};
  for (int k = 0; k < 3; ++k) {
    int best = -1;
    real64 largest = 0.0;
    for (int c = 0; c < 3; ++c) {
      real64 const x = scalar::abs(column[c].x);
      real64 const y = scalar::abs(column[c].y);
      real64 const z = scalar::abs(column[c].z);
      real64 const size = max_of(max_of(x, y), z);
      if (!used[c] && size > largest) {
        largest = size;
        best = c;
      }
    }
    if (best < 0) { break; }
    used[best] = true;
    pivot[k] = norm(column[best]);
    strict_vec3d const u = scaled(column[best], scalar::reciprocal(pivot[k]));
    for (int c = 0; c < 3; ++c) {
      if (!used[c]) { column[c] = column[c] - scaled(u, dot(u, column[c])); }
    }
  }
  real64 const limit = real64(6.66e-16) * max_of(max_of(pivot[0], pivot[1]), pivot[2]);
  int rank = 0;
  for (int k = 0; k < 3; ++k) { rank += static_cast<int>(pivot[k] > limit); }
  return rank;
}

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
