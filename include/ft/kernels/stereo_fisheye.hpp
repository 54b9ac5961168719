// SPDX-License-Identifier: Apache-2.0
/// @file Stage: stereo matching of two cameras without rectification: brute force with a ratio
/// test, then triangulation and its checks. Source: specification section 6; Hartley and Zisserman,
/// "Multiple View Geometry", section 12.2 (linear triangulation).
#pragma once

#include <cstddef>
#include <cstdint>
#include <type_traits>

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

/// Nearest of the candidates seen so far, the lowest of equals, and the distance of the second.
struct two_nearest {
  static constexpr int none = 1 << 16;  ///< above any distance
  int first = none;
  int index = 0x7fffffff;
  int second = none;

  /// @param at above those of the candidates before
  FT_HOST_DEVICE void add(int distance, int at) {
    second = min_of(second, max_of(first, distance));
    index = distance < first ? at : index;
    first = min_of(first, distance);
  }
  /// Of what all threads have seen; the same in every thread.
  template <typename Group>
  FT_HOST_DEVICE two_nearest merged(Group g) const {
    two_nearest all;
    all.first = g.reduce(first, min_op{});
    all.index = g.reduce(first == all.first ? index : 0x7fffffff, min_op{});
    all.second = g.reduce(index == all.index ? second : first, min_op{});
    return all;
  }
};

/// hamming() for loops that do nothing else on a device, where counting bits is four times as dear
/// as logic: words are added bit by bit first, four counts in place of eight.
FT_HOST_DEVICE inline int hamming_by_adders(descriptor const& a, descriptor const& b) {
#if defined(__CUDA_ARCH__)
  std::uint32_t d[8];
  FT_UNROLL
  for (int i = 0; i < 8; ++i) { d[i] = a.words[i] ^ b.words[i]; }
  auto const carry = [](std::uint32_t x, std::uint32_t y, std::uint32_t z) {
    return (x & y) | (x & z) | (y & z);
  };
  std::uint32_t const ones_a = d[0] ^ d[1] ^ d[2];
  std::uint32_t const ones_b = d[3] ^ d[4] ^ d[5];
  std::uint32_t const ones = ones_a ^ ones_b ^ d[6];
  std::uint32_t const twos_a = carry(d[0], d[1], d[2]);
  std::uint32_t const twos_b = carry(d[3], d[4], d[5]);
  std::uint32_t const twos_c = carry(ones_a, ones_b, d[6]);
  std::uint32_t const twos = twos_a ^ twos_b ^ twos_c;
  std::uint32_t const fours = carry(twos_a, twos_b, twos_c);
  return popcount(ones) + popcount(d[7]) + 2 * popcount(twos) + 4 * popcount(fours);
#else
  return hamming(a, b);
#endif
}

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

/// A symmetric 4 x 4 matrix: row i holds columns i to 3.
struct symmetric_4 {
  strict_double m[4][4];

  FT_HOST_DEVICE strict_double& at(int i, int j) { return i <= j ? m[i][j] : m[j][i]; }
  FT_HOST_DEVICE strict_double const& at(int i, int j) const { return i <= j ? m[i][j] : m[j][i]; }
  FT_HOST_DEVICE strict_double trace() const { return (m[0][0] + m[1][1]) + (m[2][2] + m[3][3]); }
  /// What the inverse is, times the determinant. Without divisions, and with one a matrix without
  /// an inverse has, too.
  FT_HOST_DEVICE symmetric_4 adjugate() const {
    strict_double const a = m[0][0], b = m[0][1], c = m[0][2], d = m[0][3];
    strict_double const e = m[1][1], f = m[1][2], g = m[1][3];
    strict_double const h = m[2][2], i = m[2][3], j = m[3][3];
    strict_double const lower02 = c * i - h * d;  // determinants of rows 2 and 3
    strict_double const lower03 = c * j - i * d;
    strict_double const lower12 = f * i - h * g;
    strict_double const lower13 = f * j - i * g;
    strict_double const lower23 = h * j - i * i;
    strict_double const upper01 = a * e - b * b;  // and of rows 0 and 1
    strict_double const upper02 = a * f - c * b;
    strict_double const upper03 = a * g - d * b;
    strict_double const upper12 = b * f - c * e;
    strict_double const upper13 = b * g - d * e;
    strict_double const upper23 = c * g - d * f;
    symmetric_4 r;
    r.m[0][0] = e * lower23 - f * lower13 + g * lower12;
    r.m[0][1] = c * lower13 - b * lower23 - d * lower12;
    r.m[0][2] = g * upper23 - i * upper13 + j * upper12;
    r.m[0][3] = h * upper13 - f * upper23 - i * upper12;
    r.m[1][1] = a * lower23 - c * lower03 + d * lower02;
    r.m[1][2] = i * upper03 - d * upper23 - j * upper02;
    r.m[1][3] = c * upper23 - h * upper03 + i * upper02;
    r.m[2][2] = d * upper13 - g * upper03 + j * upper01;
    r.m[2][3] = f * upper03 - c * upper13 - i * upper01;
    r.m[3][3] = c * upper12 - f * upper02 + h * upper01;
    return r;
  }
  FT_HOST_DEVICE symmetric_4 scaled(strict_double factor) const {
    symmetric_4 r;
    FT_UNROLL
    for (int i = 0; i < 4; ++i) {
      FT_UNROLL
      for (int j = i; j < 4; ++j) { r.m[i][j] = m[i][j] * factor; }
    }
    return r;
  }
  FT_HOST_DEVICE symmetric_4 squared() const {
    symmetric_4 r;
    FT_UNROLL
    for (int i = 0; i < 4; ++i) {
      FT_UNROLL
      for (int j = i; j < 4; ++j) {
        r.m[i][j] = (at(i, 0) * at(0, j) + at(i, 1) * at(1, j)) +
                    (at(i, 2) * at(2, j) + at(i, 3) * at(3, j));
      }
    }
    return r;
  }
};

/// Eigenvector of the smallest eigenvalue of a matrix without negative ones: of the adjugate it is
/// the largest, and powers of that, each the square of the one before, leave nothing else. False
/// where rounding could be seen in a float.
FT_HOST_DEVICE inline bool smallest_eigenvector_by_squares(symmetric_4 const& a,
                                                           strict_double (&v)[4]) {
  constexpr double converged = 1.0 - 1.0 / (1 << 24);  // the next square has what is left squared
  constexpr int most = 20;
  symmetric_4 power = a.adjugate();
  strict_double trace = power.trace();
  // An entry of the adjugate is a sum of products of three entries, none of them above this.
  strict_double const products = a.m[0][0] * a.m[1][1] * (a.m[2][2] + a.m[3][3]) +
                                 a.m[2][2] * a.m[3][3] * (a.m[0][0] + a.m[1][1]);
  constexpr double most_lost = 1.0 / (1 << 20);
  if (!(trace > products * most_lost && trace > 1e-30 && trace < 1e30)) { return false; }
  bool done = false;
  FT_NO_UNROLL
  for (int k = 0; k < most && !done; ++k) {
    // About 1 / trace: a float will do.
    strict_double const factor = static_cast<double>(reciprocal(static_cast<float>(trace.value)));
    power = power.scaled(factor);
    strict_double const before = trace * factor;
    power = power.squared();
    trace = power.trace();
    done = trace >= before * before * converged;
  }
  strict_double largest = power.m[0][0];
  for (int k = 0; k < 4; ++k) { v[k] = power.at(k, 0); }
  FT_UNROLL
  for (int i = 1; i < 4; ++i) {
    bool const larger = power.m[i][i] > largest;
    largest = larger ? power.m[i][i] : largest;
    FT_UNROLL
    for (int k = 0; k < 4; ++k) { v[k] = larger ? power.at(k, i) : v[k]; }
  }
  return done;
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
        for (int j = i; j < 4; ++j) { M[i][j] = M[i][j] + row[i] * row[j]; }
      }
    }
  }
  symmetric_4 upper;
  for (int i = 0; i < 4; ++i) {
    for (int j = i; j < 4; ++j) {
      upper.m[i][j] = M[i][j];
      M[j][i] = M[i][j];
    }
  }
  strict_double v[4];
  if (!smallest_eigenvector_by_squares(upper, v)) { smallest_eigenvector_4(M, v); }
  return {static_cast<float>((v[0] / v[3]).value), static_cast<float>((v[1] / v[3]).value),
          static_cast<float>((v[2] / v[3]).value)};
}

}  // namespace detail

/// Forgets the partners of a frame before; also for with_small_items.
struct clear_partners {
  using scratch = no_scratch;
  fisheye_matches_view out;

  FT_HOST_DEVICE int count() const { return 2 * out.batch * out.capacity; }
  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int item) const {
    (*this)(item);
  }
  FT_HOST_DEVICE void operator()(int item) const {
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
    // All of them under way together, also for an entry that turns out to have no keypoint.
    int const count = *left.count;
    int const first = mono_count[2 * pair];
    int const right_first = mono_count[2 * pair + 1];
    int const right_count = *right.count;
    descriptor const mine = get<field::orb>(left, i);
    if (i >= count || i < first) { return; }

    detail::two_nearest const best = nearest(g, mine, right, right_first, right_count);
    if (best.second == best.none) { return; }
    if (params.ratio_den * best.first >= params.ratio_num * best.second) { return; }
    int const j = best.index;

    vec3<float> point;
    if (!accept(g, rig, left, i, right, j, geometry, params, point) || g.rank() != 0) { return; }
    int* const partner = out.partner + static_cast<std::ptrdiff_t>(pair) * 2 * out.capacity;
    partner[i] = out.capacity + j;
    atomic_max(partner + out.capacity + j, i);  // of several left keypoints the last one is kept
    out.depth[item] = point.z;
    out.point[item] = point;
  }

private:
  /// Of the right keypoints [begin, end).
  template <typename Group>
  FT_HOST_DEVICE static detail::two_nearest nearest(Group g, descriptor const& mine,
                                                    keypoints_view const& right, int begin,
                                                    int end) {
    // Of so many a thread's loads are under way together.
    constexpr int together = Group::max_threads == 1 ? 1 : 8;
    detail::two_nearest best;
    FT_NO_UNROLL
    for (int base = begin + g.rank(); base - g.rank() < end; base += together * g.size()) {
      descriptor theirs[together];
      FT_UNROLL
      for (int n = 0; n < together; ++n) {
        theirs[n] = get<field::orb>(right, min_of(base + n * g.size(), end - 1));
      }
      FT_UNROLL
      for (int n = 0; n < together; ++n) {
        int const j = base + n * g.size();
        int const distance = detail::hamming_by_adders(mine, theirs[n]);
        best.add(j < end ? distance : best.none, j);
      }
    }
    return best.merged(g);
  }

  /// The point, where the two keypoints can be images of one. Every thread of a group does the
  /// same, but that of two cameras of one model those of even rank look into the left one and the
  /// others into the right one.
  template <typename Group>
  FT_HOST_DEVICE static bool accept(Group g, Rig const& rig, keypoints_view const& left, int i,
                                    keypoints_view const& right, int j,
                                    pyramid_geometry const& geometry,
                                    fisheye_stereo_params const& params, vec3<float>& point) {
    using real = strict_float;
    constexpr bool by_halves =
        Group::max_threads == 32 && std::is_same<decltype(rig.left), decltype(rig.right)>::value;
    vec2<real> const pl{get<field::x>(left, i), get<field::y>(left, i)};
    vec2<real> const pr{get<field::x>(right, j), get<field::y>(right, j)};
    float const sigma2_l = geometry.sigma2[get<field::octave>(left, i)];
    float const sigma2_r = geometry.sigma2[get<field::octave>(right, j)];
    auto const cam_l = rig.left.template cast<real>();
    auto const cam_r = rig.right.template cast<real>();
    bool const is_right = g.rank() % 2 != 0;
    auto const own = [is_right](auto of_left, auto of_right) {
      return is_right ? of_right : of_left;
    };
    vec3<real> l;
    vec3<real> r;
    if constexpr (by_halves) {
      vec3<real> const ray = own(cam_l, cam_r).unproject(own(pl, pr)).direction;
      l = shuffled(g, ray, 0);
      r = shuffled(g, ray, 1);
    } else {
      l = cam_l.unproject(pl).direction;
      r = cam_r.unproject(pr).direction;
    }
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
    if (!(in_l.z > 0.0f && in_r.z > 0.0f && point.z > params.min_depth)) { return false; }
    if constexpr (by_halves) {
      bool const near = near_enough(own(cam_l, cam_r).project(own(in_l, in_r)).pixel, own(pl, pr),
                                    own(sigma2_l, sigma2_r), params);
      return (g.ballot(near) & 3u) == 3u;
    } else {
      return near_enough(cam_l.project(in_l).pixel, pl, sigma2_l, params) &&
             near_enough(cam_r.project(in_r).pixel, pr, sigma2_r, params);
    }
  }
  template <typename Group>
  FT_HOST_DEVICE static vec3<strict_float> shuffled(Group g, vec3<strict_float> v, int from) {
    return {g.shuffle(v.x.value, from), g.shuffle(v.y.value, from), g.shuffle(v.z.value, from)};
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
  clear_partners const clear{out};
  for_each_item<per_thread>(exec, clear.count(), clear);
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
