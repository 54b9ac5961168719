// SPDX-License-Identifier: Apache-2.0
/// @file Second step of a reconstruction from two views: homographies and fundamental matrices of
/// samples of eight matches, and their scores. Source: Hartley and Zisserman, "Multiple view
/// geometry in computer vision", 2nd edition, algorithms 4.2 (DLT) and 11.1 (eight points).
#pragma once

#include <cstddef>
#include <cstdint>

#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/counter_draws.hpp"
#include "ft/core/group.hpp"
#include "ft/kernels/two_view/problem.hpp"
#include "ft/math/group_eigen.hpp"
#include "ft/math/jacobi.hpp"
#include "ft/types/odometry_params.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {

// How well matches agree with a homography or a fundamental matrix.

namespace detail {

/// Squared errors of a match in units of its variance, in both images.
struct transfer_error {
  real64 first, second;
};

/// The model x2 ~ H x1.
struct homography_error {
  /// Of 2 degrees of freedom at 95 %.
  static constexpr double limit = 5.991;

  strict_mat3d H;        ///< first image to second
  strict_mat3d inverse;  ///< of any scale

  FT_HOST_DEVICE explicit homography_error(strict_mat3d const& H_21) : H(H_21) {
    strict_vec3d const r[3] = {
        {H.m[0], H.m[1], H.m[2]}, {H.m[3], H.m[4], H.m[5]}, {H.m[6], H.m[7], H.m[8]}};
    strict_vec3d const a = cross(r[1], r[2]);
    strict_vec3d const b = cross(r[2], r[0]);
    strict_vec3d const c = cross(r[0], r[1]);
    inverse = {{a.x, b.x, c.x, a.y, b.y, c.y, a.z, b.z, c.z}};
  }
  FT_HOST_DEVICE transfer_error operator()(strict_vec3d x1, strict_vec3d x2) const {
    return {distance2(inverse * x2, x1), distance2(H * x1, x2)};
  }

private:
  /// Squared distance of the point a, in homogeneous coordinates, and b.
  FT_HOST_DEVICE static real64 distance2(strict_vec3d a, strict_vec3d b) {
    real64 const i = scalar::reciprocal(a.z);
    real64 const x = b.x - a.x * i;
    real64 const y = b.y - a.y * i;
    return x * x + y * y;
  }
};

/// The model x2^T F x1 = 0.
struct fundamental_error {
  /// Of 1 degree of freedom at 95 %.
  static constexpr double limit = 3.841;

  strict_mat3d F;

  FT_HOST_DEVICE explicit fundamental_error(strict_mat3d const& F_21) : F(F_21) {}
  FT_HOST_DEVICE transfer_error operator()(strict_vec3d x1, strict_vec3d x2) const {
    return {distance2(F.transposed() * x2, x1), distance2(F * x1, x2)};
  }

private:
  FT_HOST_DEVICE static real64 distance2(strict_vec3d line, strict_vec3d x) {
    real64 const d = dot(line, x);
    return d * d / (line.x * line.x + line.y * line.y);
  }
};

/// What a match adds to the score of a model, and whether it agrees with it.
struct agreement {
  real64 score;
  bool both;  ///< images
};

/// @param weight 1 / variance of a position, 1/pixels^2
template <typename Error>
FT_HOST_DEVICE agreement agreement_with(Error const& error, matched_pixels const& m,
                                        real64 weight) {
  // The same for both models, so that their scores compare.
  constexpr double most = homography_error::limit;
  auto const homogeneous = [](float x, float y) {
    return strict_vec3d{static_cast<double>(x), static_cast<double>(y), real64(1.0)};
  };
  transfer_error const e = error(homogeneous(m.x1, m.y1), homogeneous(m.x2, m.y2));
  real64 const c1 = e.first * weight;
  real64 const c2 = e.second * weight;
  // A NaN agrees with nothing.
  bool const near1 = c1 <= real64(Error::limit);
  bool const near2 = c2 <= real64(Error::limit);
  real64 const zero = 0.0;
  return {(near1 ? real64(most) - c1 : zero) + (near2 ? real64(most) - c2 : zero), near1 && near2};
}

/// Sum of term(i) for i in [0, n) by a thread or a warp, with the same bits: lane i mod 32, then a
/// fixed tree.
template <typename Group, typename Term>
FT_HOST_DEVICE real64 warp_ordered_sum(Group g, int n, Term const& term) {
  if constexpr (Group::max_threads == 1) {
    static_cast<void>(g);
    real64 lane[32];
    for (int i = 0; i < 32; ++i) { lane[i] = 0.0; }
    for (int i = 0; i < n; ++i) { lane[i % 32] += term(i); }
    for (int d = 16; d > 0; d /= 2) {
      for (int i = 0; i < d; ++i) { lane[i] += lane[i + d]; }
    }
    return lane[0];
  } else {
    static_assert(Group::max_threads == 32, "a thread or a warp");
    real64 sum = 0.0;
    for (int i = g.rank(); i < n; i += g.size()) { sum += term(i); }
    return g.reduce(sum, sum_op{});
  }
}

/// x -> T x of normalised homogeneous coordinates.
FT_HOST_DEVICE inline strict_mat3d matrix_of(pixel_normalization const& n) {
  real64 const zero = 0.0;
  return {{n.scale_x, zero, -(n.mean_x * n.scale_x), zero, n.scale_y, -(n.mean_y * n.scale_y), zero,
           zero, real64(1.0)}};
}
FT_HOST_DEVICE inline strict_mat3d inverse_matrix_of(pixel_normalization const& n) {
  real64 const zero = 0.0;
  real64 const one = 1.0;
  return {{one / n.scale_x, zero, n.mean_x, zero, one / n.scale_y, n.mean_y, zero, zero, one}};
}

/// Item: a sample and a model. Samples of a pair are consecutive, homographies come first. Threads
/// share the rows of the equations and the terms of the score.
struct try_sample {
  static constexpr int size = 8;      ///< matches of a sample
  static constexpr int unknowns = 9;  ///< entries of a model

  struct scratch {
    int taken[size];
    real64 rows[2 * size * unknowns];
    paired_eigen<unknowns> eigen;
  };

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int item, two_view_input const& in,
                                 two_view_params const& params, two_view_workspace const& w) const {
    int const round = item % params.samples;
    bool const homography = item / params.samples % 2 == 0;
    int const pair = item / params.samples / 2;
    prepared_pair const& p = w.prepared[pair];
    if (p.status != two_view_status::reconstructed) {
      if (g.rank() == 0) { w.score[item] = 0; }
      return;
    }
    matched_pixels const* const matched = w.matched + std::ptrdiff_t{pair} * w.capacity;
    if (g.rank() == 0) {
      counter_draws{in.seed[pair]}.distinct(p.matches, static_cast<std::uint64_t>(round), s.taken);
    }
    g.sync();
    write_rows(g, s, matched, p, homography);
    strict_mat3d const found = null_vector(g, s, homography ? 2 * size : size);
    strict_mat3d const M = homography ? denormalized_H(p, found) : denormalized_F(p, found);
    real64 const weight = weight_of(params);
    auto const score = [&](auto const& error) {
      return warp_ordered_sum(
          g, p.matches, [&](int i) { return agreement_with(error, matched[i], weight).score; });
    };
    real64 const total = homography ? score(homography_error(M)) : score(fundamental_error(M));
    if (g.rank() == 0) {
      w.model[item] = M.cast<double>();
      w.score[item] = total.value;
    }
  }

  FT_HOST_DEVICE static real64 weight_of(two_view_params const& params) {
    real64 const sigma = static_cast<double>(params.sigma_px);
    return scalar::reciprocal(sigma * sigma);
  }

private:
  template <typename Group>
  FT_HOST_DEVICE static void write_rows(Group g, scratch& s, matched_pixels const* matched,
                                        prepared_pair const& p, bool homography) {
    int const rows = homography ? 2 * size : size;
    for (int r = g.rank(); r < rows; r += g.size()) {
      matched_pixels const m = matched[s.taken[homography ? r / 2 : r]];
      auto const normal = [](float v, real64 mean, real64 scale) {
        return (real64(static_cast<double>(v)) - mean) * scale;
      };
      real64 const u1 = normal(m.x1, p.first.mean_x, p.first.scale_x);
      real64 const v1 = normal(m.y1, p.first.mean_y, p.first.scale_y);
      real64 const u2 = normal(m.x2, p.second.mean_x, p.second.scale_x);
      real64 const v2 = normal(m.y2, p.second.mean_y, p.second.scale_y);
      real64* const row = s.rows + unknowns * r;
      if (!homography) {
        real64 const of[unknowns] = {u2 * u1, u2 * v1, u2, v2 * u1, v2 * v1, v2, u1, v1, 1.0};
        for (int k = 0; k < unknowns; ++k) { row[k] = of[k]; }
        continue;
      }
      // Of x2 x (H x1) = 0 the first two rows, by turns.
      bool const upper = r % 2 == 0;
      real64 const x = upper ? v2 : u2;
      real64 const sign = upper ? 1.0 : -1.0;
      real64 const zero = 0.0;
      real64 const x1[3] = {u1, v1, 1.0};
      for (int k = 0; k < 3; ++k) {
        row[k] = upper ? zero : x1[k];
        row[3 + k] = upper ? -x1[k] : zero;
        row[6 + k] = sign * x * x1[k];
      }
    }
    g.sync();
  }

  /// The right singular vector of the smallest singular value, as a matrix.
  template <typename Group>
  FT_HOST_DEVICE static strict_mat3d null_vector(Group g, scratch& s, int rows) {
    for (int e = g.rank(); e < unknowns * unknowns; e += g.size()) {
      real64 sum = 0.0;
      for (int r = 0; r < rows; ++r) {
        real64 const* const row = s.rows + unknowns * r;
        sum += row[e / unknowns] * row[e % unknowns];
      }
      s.eigen.a[e] = sum;
    }
    g.sync();
    s.eigen.diagonalize(g, unknowns);
    int const least = s.eigen.smallest(unknowns);
    strict_mat3d M;
    for (int k = 0; k < 9; ++k) { M.m[k] = s.eigen.v[unknowns * k + least]; }
    return M;
  }

  FT_HOST_DEVICE static strict_mat3d denormalized_H(prepared_pair const& p, strict_mat3d const& H) {
    return inverse_matrix_of(p.second) * (H * matrix_of(p.first));
  }
  /// Also makes it singular: M - M v v^T, where v is the last right singular vector.
  FT_HOST_DEVICE static strict_mat3d denormalized_F(prepared_pair const& p, strict_mat3d M) {
    small_eigen<3> const eigen = eigen_of_square(M);
    int const last = eigen.smallest();
    strict_vec3d const v{eigen.component(0, last), eigen.component(1, last),
                         eigen.component(2, last)};
    strict_vec3d const Mv = M * v;
    real64 const left[3] = {Mv.x, Mv.y, Mv.z};
    real64 const right[3] = {v.x, v.y, v.z};
    for (int k = 0; k < 9; ++k) { M.m[k] = M.m[k] - left[k / 3] * right[k % 3]; }
    return matrix_of(p.second).transposed() * (M * matrix_of(p.first));
  }
};

}  // namespace detail

}  // namespace FT_ABI
}  // namespace ft
