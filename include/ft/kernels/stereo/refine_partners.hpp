// SPDX-License-Identifier: Apache-2.0
/// @file Stage: stereo partners of two cameras that are not rectified, by least squares.
#pragma once

#include <cstddef>
#include <cstdint>

#include "ft/cameras/stereo_rig.hpp"
#include "ft/containers/image_pyramid.hpp"
#include "ft/containers/keypoints.hpp"
#include "ft/containers/stereo_matches.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/views.hpp"
#include "ft/kernels/stereo/detail/least_squares.hpp"
#include "ft/kernels/stereo/detail/triangulation.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// The window around a pixel of the left level, and windows of the right one between pixels. Sums
/// are of integers, so their order does not matter.
struct partner_windows {
  gray_view left, right;
  int u, v;  ///< left pixel

  static constexpr int one = 8;  ///< parts of a pixel
  static constexpr int steps = 3;
  static constexpr float farthest = 2;  ///< from the start along an axis, pixels

  /// The place with the smallest sum of squared differences, up to a constant: Gauss-Newton steps
  /// by the mean slope of both images. False if a step leads out of the levels or too far, or if
  /// the window has structure in one direction alone.
  /// @param[in,out] at start and result, pixels of the level
  template <typename Group>
  FT_HOST_DEVICE bool find(Group g, vec2<strict_float>& at) const {
    constexpr float parts = one;
    vec2<strict_float> const start = at;
    FT_NO_UNROLL
    for (int step = 0; step < steps; ++step) {
      int const x = round_away((at.x * parts).value);
      int const y = round_away((at.y * parts).value);
      if (!inside(x, y)) { return false; }
      vec2<strict_float> move;
      if (!solve(sum(g, x, y), move)) { return false; }
      at.x = strict_float(static_cast<float>(x)) / parts + move.x;
      at.y = strict_float(static_cast<float>(y)) / parts + move.y;
      if (!(near(at.x - start.x) && near(at.y - start.y))) { return false; }
    }
    return true;
  }

private:
  static constexpr int pixels = window_side * window_side;

  /// Over the pixels of the window: the difference left - right, in 1 / one^2 grey levels, and the
  /// slopes, those of both images together, in 1 / (4 one^2) grey levels a pixel.
  struct sums {
    int e = 0, x = 0, y = 0;
    long long xx = 0, xy = 0, yy = 0, xe = 0, ye = 0;
  };

  FT_HOST_DEVICE static bool near(strict_float d) { return d > -farthest && d < farthest; }

  FT_HOST_DEVICE bool inside(int x, int y) const {
    constexpr int reach = window_half + 1;
    return u >= reach && u + reach < left.width && v >= reach && v + reach < left.height &&
           x >= reach * one && x / one + reach + 1 < right.width && y >= reach * one &&
           y / one + reach + 1 < right.height;
  }

  /// @param x,y right place, in parts
  template <typename Group>
  FT_HOST_DEVICE sums sum(Group g, int x, int y) const {
    int const a = x % one;
    int const b = y % one;
    sums s;
    FT_NO_UNROLL
    for (int p = g.rank(); p < pixels; p += g.size()) {
      int const dx = p % window_side - window_half;
      int const dy = p / window_side - window_half;
      std::uint8_t const* const l = left.row(v + dy) + u + dx;
      std::uint8_t const* const r = right.row(y / one + dy) + x / one + dx;
      auto const theirs = [&](int i, int j) {
        std::uint8_t const* const q = r + j * right.stride + i;
        return (one - b) * ((one - a) * q[0] + a * q[1]) +
               b * ((one - a) * q[right.stride] + a * q[right.stride + 1]);
      };
      int const e = one * one * l[0] - theirs(0, 0);
      int const slope_x = one * one * (l[1] - l[-1]) + theirs(1, 0) - theirs(-1, 0);
      int const slope_y =
          one * one * (l[left.stride] - l[-left.stride]) + theirs(0, 1) - theirs(0, -1);
      auto const product = [](int m, int n) { return static_cast<long long>(m) * n; };
      s.e += e;
      s.x += slope_x;
      s.y += slope_y;
      s.xx += product(slope_x, slope_x);
      s.xy += product(slope_x, slope_y);
      s.yy += product(slope_y, slope_y);
      s.xe += product(slope_x, e);
      s.ye += product(slope_y, e);
    }
    auto const all = [&](auto mine) { return g.reduce(mine, sum_op{}); };
    return {all(s.e), all(s.x), all(s.y), all(s.xx), all(s.xy), all(s.yy), all(s.xe), all(s.ye)};
  }

  /// The step. False without structure in both directions.
  FT_HOST_DEVICE static bool solve(sums const& s, vec2<strict_float>& move) {
    // Without the means: one image may be brighter. All of these are integers below 2^53.
    auto const about_means = [](long long product, int m, int n) {
      return strict_double(static_cast<double>(pixels * product - static_cast<long long>(m) * n));
    };
    strict_double const xx = about_means(s.xx, s.x, s.x);
    strict_double const xy = about_means(s.xy, s.x, s.y);
    strict_double const yy = about_means(s.yy, s.y, s.y);
    strict_double const xe = about_means(s.xe, s.x, s.e);
    strict_double const ye = about_means(s.ye, s.y, s.e);
    strict_double const determinant = xx * yy - xy * xy;
    if (!(determinant > strict_double(1e-3) * (xx * yy))) { return false; }
    strict_double const factor = strict_double(4.0) / determinant;
    move.x = static_cast<float>(((yy * xe - xy * ye) * factor).value);
    move.y = static_cast<float>(((xx * ye - xy * xe) * factor).value);
    return true;
  }
};

/// Item: a left keypoint.
template <typename Rig>
struct refine_partner {
  static constexpr bool wide_on_host = true;
  using scratch = no_scratch;
  Rig rig;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int item, image_pyramid_view const& pyramid,
                                 keypoints_view const& keypoints,
                                 fisheye_matches_view const& matches) const {
    int const pair = item / matches.capacity;
    int const i = item % matches.capacity;
    keypoints_view const left = keypoints.slice(2 * pair);
    keypoints_view const right = keypoints.slice(2 * pair + 1);
    int const* const partner =
        matches.partner + static_cast<std::ptrdiff_t>(pair) * 2 * matches.capacity;
    if (i >= *left.count || partner[i] < 0 || partner[partner[i]] != i) { return; }
    int const j = partner[i] - matches.capacity;
    vec3<float> point = matches.point[item];
    if (!refine(g, pyramid, {left, right, i, j, 2 * pair, 2 * pair + 1}, point)) { return; }
    matches.point[item] = point;
    matches.depth[item] = point.z;
  }

  /// A left keypoint, its partner and their images.
  struct match {
    keypoints_view const& left;
    keypoints_view const& right;
    int i, j;
    int left_image, right_image;
  };
  /// Moves the right keypoint of a match. True for the group's first thread, if it moves.
  /// @param[in,out] point that both see, in the left camera's frame, metres
  template <typename Group>
  FT_HOST_DEVICE bool refine(Group g, image_pyramid_view const& pyramid, match const& m,
                             vec3<float>& point) const {
    keypoints_view const& left = m.left;
    keypoints_view const& right = m.right;
    int const i = m.i;
    int const j = m.j;
    level const of(pyramid.geometry, left.octave(i));
    float const inv = pyramid.geometry.inv_scale[of.octave];
    vec2<strict_float> const mine{strict_float(left.x(i)) * inv, strict_float(left.y(i)) * inv};
    partner_windows const windows{pyramid.level(m.left_image, of.octave),
                                  pyramid.level(m.right_image, of.octave), round_away(mine.x.value),
                                  round_away(mine.y.value)};
    vec2<strict_float> const off{mine.x - static_cast<float>(windows.u),
                                 mine.y - static_cast<float>(windows.v)};
    level const of_right(pyramid.geometry, right.octave(j));
    vec2<strict_float> at = of.from_input(of_right.to_input(right.x(j), right.y(j)));
    at = {at.x - off.x, at.y - off.y};
    bool const found = windows.find(g, at);
    g.sync();  // all threads have read the right keypoint
    if (!found || g.rank() != 0) { return false; }
    vec2<strict_float> const seen = of.to_input_of_pixel({at.x + off.x, at.y + off.y});
    vec3<float> const before = point;
    if (!triangulated(of.to_input(left.x(i), left.y(i)), seen, before, point)) { return false; }
    vec2<strict_float> const moved = of_right.from_input(seen);
    strict_float const scale = pyramid.geometry.scale[of_right.octave];
    right.x(j) = (moved.x * scale).value;
    right.y(j) = (moved.y * scale).value;
    return true;
  }

private:
  /// Places in a level and in the input image.
  struct level {
    pyramid_geometry const& geometry;
    int octave;
    strict_float wide, high;  ///< pixels of the level for one of the input image

    FT_HOST_DEVICE level(pyramid_geometry const& all, int o)
        : geometry(all),
          octave(o),
          wide(ratio(all.width[o], all.width[0])),
          high(ratio(all.height[o], all.height[0])) {}
    FT_HOST_DEVICE static strict_float ratio(int a, int b) {
      return strict_float(static_cast<float>(a)) / static_cast<float>(b);
    }
    /// Of a keypoint of this octave.
    FT_HOST_DEVICE vec2<strict_float> to_input(float x, float y) const {
      return {geometry.column(x, octave), geometry.row(y, octave)};
    }
    FT_HOST_DEVICE vec2<strict_float> to_input_of_pixel(vec2<strict_float> p) const {
      return {(p.x + 0.5f) / wide - 0.5f, (p.y + 0.5f) / high - 0.5f};
    }
    FT_HOST_DEVICE vec2<strict_float> from_input(vec2<strict_float> p) const {
      return {(p.x + 0.5f) * wide - 0.5f, (p.y + 0.5f) * high - 0.5f};
    }
  };

  /// The point that both cameras see; false if its depth differs beyond belief from that of
  /// `before`.
  FT_HOST_DEVICE bool triangulated(vec2<strict_float> of_left, vec2<strict_float> of_right,
                                   vec3<float> const& before, vec3<float>& point) const {
    auto const l = rig.left.template cast<strict_float>().unproject(of_left).direction;
    auto const r = rig.right.template cast<strict_float>().unproject(of_right).direction;
    if (!(l.z > 0.0f && r.z > 0.0f)) { return false; }
    point = triangulate({(l.x / l.z).value, (l.y / l.z).value, 1.0f},
                        {(r.x / r.z).value, (r.y / r.z).value, 1.0f}, rig.T_rl);
    strict_float const z = point.z;
    return z > strict_float(0.5f) * before.z && z < strict_float(2.0f) * before.z;
  }
};

}  // namespace detail

/// Moves the right keypoints of the matches of match_stereo_fisheye() to where the window around
/// their left partner, 11 x 11 pixels of its level, has the smallest squared differences, up to a
/// constant, and triangulates the points anew. A left keypoint between pixels takes its partner
/// with it. Three Gauss-Newton steps, linear between pixels. A match stays as it is if its window
/// would move by two pixels or leave its level, or if its depth would halve or double.
///
/// The two cameras look in about the same direction, so windows are not turned or scaled.
/// Asynchronous on `exec`; allocates nothing; one launch. Source: Lucas and Kanade, "An iterative
/// image registration technique with an application to stereo vision", 1981.
/// @param[in,out] keypoints positions of right ones
/// @param[in,out] matches points and depths
/// @throws bad_argument for a batch that is not that of the keypoints, or a pyramid whose geometry
/// is
///   not `exact`
template <typename Exec, typename Rig>
void refine_partners(Exec const& exec, Rig const& rig, image_pyramid_view const& pyramid,
                     keypoints_view const& keypoints, fisheye_matches_view const& matches) {
  detail::require(keypoints.batch == pyramid.batch && 2 * matches.batch == keypoints.batch &&
                      matches.capacity == keypoints.capacity,
                  "the matches are those of other images");
  detail::require(pyramid.geometry.exact, "partners are refined in a pyramid with exact positions");
  for_each_item<per_warp>(exec, matches.batch * matches.capacity, detail::refine_partner<Rig>{rig},
                          pyramid, keypoints, matches);
}

}  // namespace FT_ABI
}  // namespace ft
