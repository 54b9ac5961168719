// SPDX-License-Identifier: Apache-2.0
/// @file The linear system of a bundle's adjustment on an executor.
///
/// For an observation let d be the vector from the view's centre to the point, A and f the
/// curvature and half the gradient of its cost by the point's position, along the axes of the
/// world, and G = (-[d]x, I) the motion of the point seen from the view, for a turn w and a shift u
/// of the view. With H the sum of A over a point's views, damped, and b the negative sum of f, the
/// points are eliminated: blocks of views i and j and right-hand sides are
///
///     S_ij = [i = j] (sum G^T A G + damping) - sum G_i^T A_i H^-1 A_j G_j
///     r_i = -sum G_i^T (f_i + A_i H^-1 b)
///
/// S is never formed but for its diagonal blocks. Source: Triggs and others, "Bundle adjustment - a
/// modern synthesis", 1999; Agarwal and others, "Bundle adjustment in the large", 2010.
#pragma once

#include <cstddef>
#include <type_traits>

#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/math/positive_definite.hpp"
#include "ft/math/small_matrices.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// Where the conjugate gradients are. Written by the launches themselves.
struct gradient_state {
  double rho;    ///< residual times preconditioned residual
  double first;  ///< that of the start
  double model;  ///< by how much the linear system says that the solution lowers the cost
  int steps;
  int running;
};

/// Arrays in executor memory. Observations are sorted by view, in a view by point. The views that
/// move are numbered by `place`.
struct bundle_system_view {
  int views = 0, moving = 0, points = 0, observations = 0;

  int const* camera = nullptr;       ///< [views]
  int const* place = nullptr;        ///< [views] of a view that moves; -1: it stays
  int const* moving_view = nullptr;  ///< [moving]
  int const* view_begin = nullptr;   ///< [views + 1] first observation
  int const* view = nullptr;         ///< [observations]
  int const* point = nullptr;        ///< [observations]
  int const* point_begin = nullptr;  ///< [points + 1] into the next one
  int const* sighting = nullptr;     ///< [observations] a point's observations, ascending
  vec2<double>* pixel = nullptr;     ///< [observations]
  double* weight = nullptr;          ///< [observations] 1 / sigma^2
  double* baseline = nullptr;        ///< [cameras] of rectified pairs, metres
  double* right_x = nullptr;  ///< [observations] NaN: none; null where no observation has one

  double* curvature = nullptr;      ///< [observations][6] A, upper triangle by rows
  double* gradient = nullptr;       ///< [observations][3] f
  vec3<double>* centre = nullptr;   ///< [views]
  double* view_diagonal = nullptr;  ///< [moving][6] of sum G^T A G
  double* view_right = nullptr;     ///< [moving][6] -sum G^T f
  double* point_matrix = nullptr;   ///< [points][6] sum A
  double* point_right = nullptr;    ///< [points][3] b
  double* point_factor = nullptr;   ///< [points][6] point_solver of H
  double* point_start = nullptr;    ///< [points][3] H^-1 b
  double* point_answer = nullptr;   ///< [points][3] H^-1 sum A G x
  double* block_factor = nullptr;   ///< [moving][36] of diagonal blocks of S; diagonal inverted

  double* right = nullptr;      ///< [moving][6] r
  double* solution = nullptr;   ///< [moving][6]
  double* residual = nullptr;   ///< [moving][6]
  double* direction = nullptr;  ///< [moving][6]
  double* product = nullptr;    ///< [moving][6] S times direction; preconditioned residual
  gradient_state* state = nullptr;

  double* cost = nullptr;  ///< [views][3] robust cost, squared errors, observations without image
  double* promise = nullptr;  ///< [moving + points] parts of the linear system's promise
};
static_assert(std::is_trivially_copyable<bundle_system_view>::value, "passed to kernels");

FT_HOST_DEVICE inline strict_vec3d load_3(double const* at) { return {at[0], at[1], at[2]}; }
FT_HOST_DEVICE inline void store_3(double* at, strict_vec3d const& v) {
  at[0] = v.x.value;
  at[1] = v.y.value;
  at[2] = v.z.value;
}
FT_HOST_DEVICE inline symmetric_3<real64> load_symmetric(double const* at) {
  return {at[0], at[1], at[2], at[3], at[4], at[5]};
}
/// Entry i of an array of K numbers each.
template <int K>
FT_HOST_DEVICE double* entry(double* array, int i) {
  return array + static_cast<std::ptrdiff_t>(K) * i;
}

/// Solves with the Cholesky factor of a symmetric 3 x 3 matrix: more accurate than its inverse
/// where the point's depth is known far less than its direction.
struct point_solver {
  real64 l10, l20, l21;
  real64 i0, i1, i2;  ///< inverses of the factor's diagonal

  /// Of A, its diagonal 1 + damping times as large. Where that is not positive definite solutions
  /// are 0: the point stays.
  FT_HOST_DEVICE static point_solver of(symmetric_3<real64> const& A, real64 damping) {
    real64 const zero = 0.0;
    point_solver f{zero, zero, zero, zero, zero, zero};
    real64 const factor = real64(1.0) + damping;
    real64 const least = 1e-14;
    real64 const a = A.xx * factor;
    if (!(a > zero)) { return f; }
    real64 const i0 = scalar::reciprocal(scalar::sqrt(a));
    real64 const l10 = A.xy * i0;
    real64 const l20 = A.xz * i0;
    real64 const b = A.yy * factor - l10 * l10;
    if (!(b > least * A.yy)) { return f; }
    real64 const i1 = scalar::reciprocal(scalar::sqrt(b));
    real64 const l21 = (A.yz - l20 * l10) * i1;
    real64 const c = A.zz * factor - l20 * l20 - l21 * l21;
    if (!(c > least * A.zz)) { return f; }
    return {l10, l20, l21, i0, i1, scalar::reciprocal(scalar::sqrt(c))};
  }
  FT_HOST_DEVICE static point_solver load(double const* at) {
    return {at[0], at[1], at[2], at[3], at[4], at[5]};
  }
  FT_HOST_DEVICE void store(double* at) const {
    store_3(at, {l10, l20, l21});
    store_3(at + 3, {i0, i1, i2});
  }
  /// L^-1 v
  FT_HOST_DEVICE strict_vec3d forward(strict_vec3d const& v) const {
    real64 const x = v.x * i0;
    real64 const y = (v.y - l10 * x) * i1;
    return {x, y, (v.z - l20 * x - l21 * y) * i2};
  }
  FT_HOST_DEVICE strict_vec3d solve(strict_vec3d const& v) const {
    strict_vec3d const h = forward(v);
    real64 const z = h.z * i2;
    real64 const y = (h.y - l21 * z) * i1;
    return {(h.x - l10 * y - l20 * z) * i0, y, z};
  }
};

/// Whether an observation has a right image.
FT_HOST_DEVICE inline bool has_right(bundle_system_view const& A, int o) {
  return A.right_x != nullptr && scalar::is_finite(A.right_x[o]);
}
/// A point in the frame of a view, seen from the view's right camera.
FT_HOST_DEVICE inline strict_vec3d from_right(bundle_system_view const& A, int view,
                                              strict_vec3d const& p) {
  return {p.x - real64(A.baseline[A.camera[view]]), p.y, p.z};
}

/// G x: how a point at d from a view's centre moves, seen from the view, that turns and moves by x.
FT_HOST_DEVICE inline strict_vec3d seen_motion(double const* x, strict_vec3d const& d) {
  return cross(load_3(x), d) + load_3(x + 3);
}

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
