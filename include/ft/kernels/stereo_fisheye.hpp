// SPDX-License-Identifier: Apache-2.0
/// @file Stage: stereo matching of two cameras without rectification: brute force with a ratio
/// test, then triangulation and its checks. Source: specification section 6; Hartley and Zisserman,
/// "Multiple View Geometry", section 12.2 (linear triangulation).
#pragma once

#include <cstddef>
#include <cstdint>

#include "ft/cameras/stereo_rig.hpp"
#include "ft/containers/image_pyramid.hpp"
#include "ft/containers/keypoints.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"

namespace ft {
inline namespace FT_ABI {

struct fisheye_stereo_params {
  int ratio_num = 7;  ///< best distance below ratio_num / ratio_den of the second best
  int ratio_den = 10;
  float max_cosine = 0.9998f;  ///< between the two rays; above, the parallax is too small
  float chi2 = 5.991f;         ///< reprojection error, in units of the octave's variance
  float min_depth = 1e-4f;     ///< metres
};

/// Stereo partners and points of a batch of pairs. Keypoint k of the left camera has number k, of
/// the right one capacity + k.
struct fisheye_matches_view {
  int* partner = nullptr;        ///< [batch][2 * capacity] number of the partner, -1 = none
  float* depth = nullptr;        ///< [batch][capacity] of left keypoints, metres, -1 = none
  vec3<float>* point = nullptr;  ///< [batch][capacity] in the left camera's frame, 0 = none
  int capacity = 0;
  int batch = 0;
};

inline void carve(carver& c, fisheye_matches_view& v, int capacity, int batch) {
  std::size_t const n =
      detail::checked_mul(static_cast<std::size_t>(batch), static_cast<std::size_t>(capacity));
  v.capacity = capacity;
  v.batch = batch;
  v.partner = c.take<int>(2 * n);
  v.depth = c.take<float>(n);
  v.point = c.take<vec3<float>>(n);
}

namespace detail {

/// Nearest and second nearest of the candidates seen so far, keys (distance << 32 | index).
struct two_nearest {
  unsigned long long first = ~0ull;
  unsigned long long second = ~0ull;

  FT_HOST_DEVICE void add(unsigned long long key) {
    if (key < first) {
      second = first;
      first = key;
    } else if (key < second) {
      second = key;
    }
  }
};
struct merge_two_nearest {
  FT_HOST_DEVICE two_nearest operator()(two_nearest a, two_nearest b) const {
    a.add(b.first);
    a.add(b.second);
    return a;
  }
};

/// One Jacobi rotation: makes a[P][Q] of a symmetric matrix 0, and turns the columns of e with it.
/// False where the angle is below what a double can tell.
template <int P, int Q>
FT_HOST_DEVICE bool rotate_4(strict_double (&a)[4][4], strict_double (&e)[4][4]) {
  strict_double const off = a[P][Q];
  strict_double const apart = a[Q][Q] - a[P][P];
  constexpr double nothing = 1.0 / (1ull << 60);
  if (scalar::abs(off) <= strict_double(nothing) * scalar::abs(apart)) { return false; }
  // The smaller root of t^2 + 2 t apart / (2 off) - 1 = 0.
  strict_double const twice = off + off;
  strict_double const root = scalar::sqrt(apart * apart + twice * twice);
  strict_double const t = apart >= 0.0 ? twice / (apart + root) : twice / (apart - root);
  strict_double const c = strict_double(1.0) / scalar::sqrt(t * t + 1.0);
  strict_double const s = t * c;
  FT_UNROLL
  for (int k = 0; k < 4; ++k) {
    strict_double const kp = a[k][P];
    strict_double const kq = a[k][Q];
    a[k][P] = c * kp - s * kq;
    a[k][Q] = s * kp + c * kq;
  }
  FT_UNROLL
  for (int k = 0; k < 4; ++k) {
    strict_double const pk = a[P][k];
    strict_double const qk = a[Q][k];
    a[P][k] = c * pk - s * qk;
    a[Q][k] = s * pk + c * qk;
    strict_double const ep = e[k][P];
    strict_double const eq = e[k][Q];
    e[k][P] = c * ep - s * eq;
    e[k][Q] = s * ep + c * eq;
  }
  return true;
}

/// Eigenvector of the smallest eigenvalue of a symmetric 4 x 4 matrix, by Jacobi rotations in a
/// fixed order.
FT_HOST_DEVICE inline void smallest_eigenvector_4(strict_double (&a)[4][4], strict_double (&v)[4]) {
  strict_double e[4][4];
  for (int i = 0; i < 4; ++i) {
    for (int j = 0; j < 4; ++j) { e[i][j] = i == j ? 1.0 : 0.0; }
  }
  FT_NO_UNROLL
  for (int sweep = 0; sweep < 10; ++sweep) {
    bool turned = rotate_4<0, 1>(a, e);
    turned = rotate_4<0, 2>(a, e) || turned;
    turned = rotate_4<0, 3>(a, e) || turned;
    turned = rotate_4<1, 2>(a, e) || turned;
    turned = rotate_4<1, 3>(a, e) || turned;
    turned = rotate_4<2, 3>(a, e) || turned;
    if (!turned) { break; }
  }
  strict_double lowest = a[0][0];
  for (int k = 0; k < 4; ++k) { v[k] = e[k][0]; }
  for (int i = 1; i < 4; ++i) {
    if (a[i][i] < lowest) {
      lowest = a[i][i];
      for (int k = 0; k < 4; ++k) { v[k] = e[k][i]; }
    }
  }
}

/// Point in the left frame whose images are the z = 1 rays `left` and `right`. @param T_rl left to
/// right
FT_HOST_DEVICE inline vec3<float> triangulate(vec3<float> left, vec3<float> right,
                                              pose const& T_rl) {
  strict_double P[2][3][4];
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 4; ++j) { P[0][i][j] = i == j ? 1.0 : 0.0; }
    for (int j = 0; j < 3; ++j) { P[1][i][j] = static_cast<double>(T_rl.R.m[3 * i + j]); }
  }
  P[1][0][3] = static_cast<double>(T_rl.t.x);
  P[1][1][3] = static_cast<double>(T_rl.t.y);
  P[1][2][3] = static_cast<double>(T_rl.t.z);
  strict_double const xy[2][2] = {{static_cast<double>(left.x), static_cast<double>(left.y)},
                                  {static_cast<double>(right.x), static_cast<double>(right.y)}};
  strict_double M[4][4];
  for (int i = 0; i < 4; ++i) {
    for (int j = 0; j < 4; ++j) { M[i][j] = 0.0; }
  }
  for (int c = 0; c < 2; ++c) {
    for (int r = 0; r < 2; ++r) {
      strict_double row[4];
      for (int j = 0; j < 4; ++j) { row[j] = xy[c][r] * P[c][2][j] - P[c][r][j]; }
      for (int i = 0; i < 4; ++i) {
        for (int j = 0; j < 4; ++j) { M[i][j] = M[i][j] + row[i] * row[j]; }
      }
    }
  }
  strict_double v[4];
  smallest_eigenvector_4(M, v);
  return {static_cast<float>((v[0] / v[3]).value), static_cast<float>((v[1] / v[3]).value),
          static_cast<float>((v[2] / v[3]).value)};
}

}  // namespace detail

/// Forgets the partners of a frame before.
struct clear_partners {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int item, fisheye_matches_view const& out) const {
    out.partner[item] = -1;
    int const k = item % (2 * out.capacity);
    if (k < out.capacity) {
      std::ptrdiff_t const at =
          static_cast<std::ptrdiff_t>(item / (2 * out.capacity)) * out.capacity + k;
      out.depth[at] = -1;
      out.point[at] = {0, 0, 0};
    }
  }
};

/// One left keypoint of the overlap: its partner and the point.
template <typename Rig>
struct match_fisheye_keypoint {
  static constexpr bool wide_on_host = true;
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int item, Rig const& rig,
                                 keypoints_view const& keypoints, int const* mono_count,
                                 pyramid_geometry const& geometry,
                                 fisheye_stereo_params const& params,
                                 fisheye_matches_view const& out) const {
    int const pair = item / out.capacity;
    int const i = item % out.capacity;
    keypoints_view const left = keypoints.slice(2 * pair);
    keypoints_view const right = keypoints.slice(2 * pair + 1);
    if (i >= *left.count || i < mono_count[2 * pair]) { return; }

    descriptor const mine = get<field::orb>(left, i);
    detail::two_nearest best;
    for (int j = mono_count[2 * pair + 1] + g.rank(); j < *right.count; j += g.size()) {
      int const distance = hamming(mine, get<field::orb>(right, j));
      best.add(static_cast<unsigned long long>(distance) << 32 | static_cast<unsigned>(j));
    }
    best = g.reduce(best, detail::merge_two_nearest{});
    if (g.rank() != 0 || best.second == ~0ull) { return; }
    int const d1 = static_cast<int>(best.first >> 32);
    int const d2 = static_cast<int>(best.second >> 32);
    if (params.ratio_den * d1 >= params.ratio_num * d2) { return; }
    int const j = static_cast<int>(best.first & 0xffffffffu);

    vec3<float> point;
    if (!accept(rig, left, i, right, j, geometry, params, point)) { return; }
    int* const partner = out.partner + static_cast<std::ptrdiff_t>(pair) * 2 * out.capacity;
    partner[i] = out.capacity + j;
    atomic_max(partner + out.capacity + j, i);  // of several left keypoints the last one is kept
    out.depth[item] = point.z;
    out.point[item] = point;
  }

private:
  FT_HOST_DEVICE static bool accept(Rig const& rig, keypoints_view const& left, int i,
                                    keypoints_view const& right, int j,
                                    pyramid_geometry const& geometry,
                                    fisheye_stereo_params const& params, vec3<float>& point) {
    using real = strict_float;
    vec2<real> const pl{get<field::x>(left, i), get<field::y>(left, i)};
    vec2<real> const pr{get<field::x>(right, j), get<field::y>(right, j)};
    auto const cam_l = rig.left.template cast<real>();
    auto const cam_r = rig.right.template cast<real>();
    vec3<real> const l = cam_l.unproject(pl).direction;
    vec3<real> const r = cam_r.unproject(pr).direction;
    auto const T_rl = rig.T_rl.template cast<real>();
    vec3<real> const r_in_l = T_rl.R.transposed() * r;
    real const cosine =
        dot(l, r_in_l) / (scalar::sqrt(dot(l, l)) * scalar::sqrt(dot(r_in_l, r_in_l)));
    if (!(cosine <= params.max_cosine && l.z > 0.0f && r.z > 0.0f)) { return false; }
    // Rays come in any length; of some models they have z = 1 already, and nothing changes.
    point = detail::triangulate({(l.x / l.z).value, (l.y / l.z).value, 1.0f},
                                {(r.x / r.z).value, (r.y / r.z).value, 1.0f}, rig.T_rl);
    vec3<real> const in_l{point.x, point.y, point.z};
    vec3<real> const in_r = T_rl * in_l;
    if (!(in_l.z > 0.0f && in_r.z > 0.0f)) { return false; }
    return near_enough(cam_l.project(in_l).pixel, pl, geometry.sigma2[get<field::octave>(left, i)],
                       params) &&
           near_enough(cam_r.project(in_r).pixel, pr, geometry.sigma2[get<field::octave>(right, j)],
                       params) &&
           point.z > params.min_depth;
  }
  FT_HOST_DEVICE static bool near_enough(vec2<strict_float> a, vec2<strict_float> b, float sigma2,
                                         fisheye_stereo_params const& params) {
    strict_float const dx = a.x - b.x;
    strict_float const dy = a.y - b.y;
    return dx * dx + dy * dy <= strict_float(params.chi2) * sigma2;
  }
};

/// The part of match_stereo_fisheye() that needs no keypoints; one launch.
template <typename Exec>
void clear_fisheye_matches(Exec const& exec, fisheye_matches_view const& out) {
  for_each_item<per_thread>(exec, 2 * out.batch * out.capacity, clear_partners{}, out);
}

/// The rest of it; one launch.
template <typename Exec, typename Rig>
void match_cleared_fisheye(Exec const& exec, Rig const& rig, keypoints_view const& keypoints,
                           int const* mono_count, pyramid_geometry const& geometry,
                           fisheye_stereo_params const& params, fisheye_matches_view const& out) {
  for_each_item<per_warp>(exec, out.batch * out.capacity, match_fisheye_keypoint<Rig>{}, rig,
                          keypoints, mono_count, geometry, params, out);
}

/// Partners, depths and points of the keypoints in the overlap of every pair; images 2 b and 2 b +
/// 1 are pair b. Asynchronous on `exec`; allocates nothing; two launches.
/// @param mono_count [images] keypoints before the overlap's, from describe_corners
template <typename Exec, typename Rig>
void match_stereo_fisheye(Exec const& exec, Rig const& rig, keypoints_view const& keypoints,
                          int const* mono_count, pyramid_geometry const& geometry,
                          fisheye_stereo_params const& params, fisheye_matches_view const& out) {
  clear_fisheye_matches(exec, out);
  match_cleared_fisheye(exec, rig, keypoints, mono_count, geometry, params, out);
}

}  // namespace FT_ABI
}  // namespace ft
