// SPDX-License-Identifier: Apache-2.0
/// @file How well matches agree with a homography or a fundamental matrix.
#pragma once

#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/group.hpp"
#include "ft/kernels/two_view/problem.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// Squared errors of a match in units of its variance, in both images.
struct transfer_error {
  wide first, second;
};

/// The model x2 ~ H x1.
struct homography_error {
  /// Of 2 degrees of freedom at 95 %.
  static constexpr double limit = 5.991;

  wide_mat3 H;        ///< first image to second
  wide_mat3 inverse;  ///< of any scale

  FT_HOST_DEVICE explicit homography_error(wide_mat3 const& H_21) : H(H_21) {
    wide_vec3 const r[3] = {
        {H.m[0], H.m[1], H.m[2]}, {H.m[3], H.m[4], H.m[5]}, {H.m[6], H.m[7], H.m[8]}};
    wide_vec3 const a = cross(r[1], r[2]);
    wide_vec3 const b = cross(r[2], r[0]);
    wide_vec3 const c = cross(r[0], r[1]);
    inverse = {{a.x, b.x, c.x, a.y, b.y, c.y, a.z, b.z, c.z}};
  }
  FT_HOST_DEVICE transfer_error operator()(wide_vec3 x1, wide_vec3 x2) const {
    return {distance2(inverse * x2, x1), distance2(H * x1, x2)};
  }

private:
  /// Squared distance of the point a, in homogeneous coordinates, and b.
  FT_HOST_DEVICE static wide distance2(wide_vec3 a, wide_vec3 b) {
    wide const i = scalar::reciprocal(a.z);
    wide const x = b.x - a.x * i;
    wide const y = b.y - a.y * i;
    return x * x + y * y;
  }
};

/// The model x2^T F x1 = 0.
struct fundamental_error {
  /// Of 1 degree of freedom at 95 %.
  static constexpr double limit = 3.841;

  wide_mat3 F;

  FT_HOST_DEVICE explicit fundamental_error(wide_mat3 const& F_21) : F(F_21) {}
  FT_HOST_DEVICE transfer_error operator()(wide_vec3 x1, wide_vec3 x2) const {
    return {distance2(F.transposed() * x2, x1), distance2(F * x1, x2)};
  }

private:
  FT_HOST_DEVICE static wide distance2(wide_vec3 line, wide_vec3 x) {
    wide const d = dot(line, x);
    return d * d / (line.x * line.x + line.y * line.y);
  }
};

/// What a match adds to the score of a model, and whether it agrees with it.
struct agreement {
  wide score;
  bool both;  ///< images
};

/// @param weight 1 / variance of a position, 1/pixels^2
template <typename Error>
FT_HOST_DEVICE agreement agreement_with(Error const& error, matched_pixels const& m, wide weight) {
  // The same for both models, so that their scores compare.
  constexpr double most = homography_error::limit;
  auto const homogeneous = [](float x, float y) {
    return wide_vec3{static_cast<double>(x), static_cast<double>(y), wide(1.0)};
  };
  transfer_error const e = error(homogeneous(m.x1, m.y1), homogeneous(m.x2, m.y2));
  wide const c1 = e.first * weight;
  wide const c2 = e.second * weight;
  // A NaN agrees with nothing.
  bool const near1 = c1 <= wide(Error::limit);
  bool const near2 = c2 <= wide(Error::limit);
  wide const zero = 0.0;
  return {(near1 ? wide(most) - c1 : zero) + (near2 ? wide(most) - c2 : zero), near1 && near2};
}

/// Sum of term(i) for i in [0, n) by a thread or a warp, with the same bits: lane i mod 32, then a
/// fixed tree.
template <typename Group, typename Term>
FT_HOST_DEVICE wide warp_ordered_sum(Group g, int n, Term const& term) {
  if constexpr (Group::max_threads == 1) {
    static_cast<void>(g);
    wide lane[32];
    for (int i = 0; i < 32; ++i) { lane[i] = 0.0; }
    for (int i = 0; i < n; ++i) { lane[i % 32] += term(i); }
    for (int d = 16; d > 0; d /= 2) {
      for (int i = 0; i < d; ++i) { lane[i] += lane[i + d]; }
    }
    return lane[0];
  } else {
    static_assert(Group::max_threads == 32, "a thread or a warp");
    wide sum = 0.0;
    for (int i = g.rank(); i < n; i += g.size()) { sum += term(i); }
    return g.reduce(sum, sum_op{});
  }
}

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
