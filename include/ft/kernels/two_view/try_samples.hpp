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
#include "ft/kernels/matrices/paired_eigen.hpp"
#include "ft/kernels/matrices/small_eigen.hpp"
#include "ft/kernels/two_view/problem.hpp"
#include "ft/kernels/two_view/transfer_error.hpp"
#include "ft/types/odometry_params.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// x -> T x of normalised homogeneous coordinates.
FT_HOST_DEVICE inline wide_mat3 matrix_of(pixel_normalization const& n) {
  wide const zero = 0.0;
  return {{n.scale_x, zero, -(n.mean_x * n.scale_x), zero, n.scale_y, -(n.mean_y * n.scale_y), zero,
           zero, wide(1.0)}};
}
FT_HOST_DEVICE inline wide_mat3 inverse_matrix_of(pixel_normalization const& n) {
  wide const zero = 0.0;
  wide const one = 1.0;
  return {{one / n.scale_x, zero, n.mean_x, zero, one / n.scale_y, n.mean_y, zero, zero, one}};
}

/// Item: a sample and a model. Samples of a pair are consecutive, homographies come first. Threads
/// share the rows of the equations and the terms of the score.
struct try_sample {
  static constexpr int size = 8;      ///< matches of a sample
  static constexpr int unknowns = 9;  ///< entries of a model

  struct scratch {
    int taken[size];
    wide rows[2 * size * unknowns];
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
    wide_mat3 const found = null_vector(g, s, homography ? 2 * size : size);
    wide_mat3 const M = homography ? denormalized_H(p, found) : denormalized_F(p, found);
    wide const weight = weight_of(params);
    auto const score = [&](auto const& error) {
      return warp_ordered_sum(
          g, p.matches, [&](int i) { return agreement_with(error, matched[i], weight).score; });
    };
    wide const total = homography ? score(homography_error(M)) : score(fundamental_error(M));
    if (g.rank() == 0) {
      w.model[item] = M.cast<double>();
      w.score[item] = total.value;
    }
  }

  FT_HOST_DEVICE static wide weight_of(two_view_params const& params) {
    wide const sigma = static_cast<double>(params.sigma_px);
    return scalar::reciprocal(sigma * sigma);
  }

private:
  template <typename Group>
  FT_HOST_DEVICE static void write_rows(Group g, scratch& s, matched_pixels const* matched,
                                        prepared_pair const& p, bool homography) {
    int const rows = homography ? 2 * size : size;
    for (int r = g.rank(); r < rows; r += g.size()) {
      matched_pixels const m = matched[s.taken[homography ? r / 2 : r]];
      auto const normal = [](float v, wide mean, wide scale) {
        return (wide(static_cast<double>(v)) - mean) * scale;
      };
      wide const u1 = normal(m.x1, p.first.mean_x, p.first.scale_x);
      wide const v1 = normal(m.y1, p.first.mean_y, p.first.scale_y);
      wide const u2 = normal(m.x2, p.second.mean_x, p.second.scale_x);
      wide const v2 = normal(m.y2, p.second.mean_y, p.second.scale_y);
      wide* const row = s.rows + unknowns * r;
      if (!homography) {
        wide const of[unknowns] = {u2 * u1, u2 * v1, u2, v2 * u1, v2 * v1, v2, u1, v1, 1.0};
        for (int k = 0; k < unknowns; ++k) { row[k] = of[k]; }
        continue;
      }
      // Of x2 x (H x1) = 0 the first two rows, by turns.
      bool const upper = r % 2 == 0;
      wide const x = upper ? v2 : u2;
      wide const sign = upper ? 1.0 : -1.0;
      wide const zero = 0.0;
      wide const x1[3] = {u1, v1, 1.0};
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
  FT_HOST_DEVICE static wide_mat3 null_vector(Group g, scratch& s, int rows) {
    for (int e = g.rank(); e < unknowns * unknowns; e += g.size()) {
      wide sum = 0.0;
      for (int r = 0; r < rows; ++r) {
        wide const* const row = s.rows + unknowns * r;
        sum += row[e / unknowns] * row[e % unknowns];
      }
      s.eigen.a[e] = sum;
    }
    g.sync();
    s.eigen.diagonalize(g, unknowns);
    int const least = s.eigen.smallest(unknowns);
    wide_mat3 M;
    for (int k = 0; k < 9; ++k) { M.m[k] = s.eigen.v[unknowns * k + least]; }
    return M;
  }

  FT_HOST_DEVICE static wide_mat3 denormalized_H(prepared_pair const& p, wide_mat3 const& H) {
    return inverse_matrix_of(p.second) * (H * matrix_of(p.first));
  }
  /// Also makes it singular: M - M v v^T, where v is the last right singular vector.
  FT_HOST_DEVICE static wide_mat3 denormalized_F(prepared_pair const& p, wide_mat3 M) {
    small_eigen<3> const eigen = eigen_of_square(M);
    int const last = eigen.smallest();
    wide_vec3 const v{eigen.component(0, last), eigen.component(1, last), eigen.component(2, last)};
    wide_vec3 const Mv = M * v;
    wide const left[3] = {Mv.x, Mv.y, Mv.z};
    wide const right[3] = {v.x, v.y, v.z};
    for (int k = 0; k < 9; ++k) { M.m[k] = M.m[k] - left[k / 3] * right[k % 3]; }
    return matrix_of(p.second).transposed() * (M * matrix_of(p.first));
  }
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
