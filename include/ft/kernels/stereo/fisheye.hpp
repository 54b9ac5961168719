// SPDX-License-Identifier: Apache-2.0
/// @file Stage: stereo matching of two cameras without rectification: brute force with a ratio
/// test, then triangulation and its checks. Source: specification section 6.
#pragma once

#include <cstddef>
#include <type_traits>

#include "ft/cameras/stereo_rig.hpp"
#include "ft/containers/image_pyramid.hpp"
#include "ft/containers/keypoints.hpp"
#include "ft/containers/stereo_matches.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/atomics.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/kernels/stereo/detail/triangulation.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {

/// Parameters of stereo matching without rectification.
struct fisheye_stereo_params {
  int ratio_num = 7;  ///< the best distance must be below ratio_num / ratio_den of the second best
  int ratio_den = 10;
  // Doubles, as in the reference: they are compared with floats, and 0.9998f is above 0.9998.
  double max_cosine = 0.9998;  ///< of the angle between the rays; above, the parallax is too small
  double chi2 = 5.991;         ///< reprojection error, in units of the octave's variance
  float min_depth = 1e-4f;     ///< metres; no float lies between it and the double 1e-4
};

/// Inputs of stereo matching without rectification, apart from the keypoints.
template <typename Rig>
struct fisheye_stereo {
  Rig rig;
  pyramid_geometry geometry;
  int const* mono_count = nullptr;  ///< [images] keypoints outside the overlap; they come first
  fisheye_stereo_params params;
};

namespace detail {

/// Item: the number of a keypoint. Clears its match.
struct clear_partner {
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

/// Item: a left keypoint. Finds its partner and the point if it is in the overlap.
template <typename Rig>
struct match_fisheye_keypoint {
  static constexpr bool wide_on_host = true;
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int item, fisheye_stereo<Rig> const& stereo,
                                 keypoints_view const& keypoints,
                                 fisheye_matches_view const& out) const {
    int const pair = item / out.capacity;
    int const i = item % out.capacity;
    keypoints_view const left = keypoints.slice(2 * pair);
    keypoints_view const right = keypoints.slice(2 * pair + 1);
    // Loaded together, although the entry may turn out to be past the count.
    int const count = *left.count;
    int const first = stereo.mono_count[2 * pair];
    int const right_first = stereo.mono_count[2 * pair + 1];
    int const right_count = *right.count;
    descriptor const mine = left.orb(i);
    if (i >= count || i < first) { return; }

    vec3<float> point;
    int const j = find(g, stereo, {left, right, i, right_first, right_count}, mine, point);
    if (j < 0 || g.rank() != 0) { return; }
    int* const partner = out.partner + static_cast<std::ptrdiff_t>(pair) * 2 * out.capacity;
    partner[i] = out.capacity + j;
    atomic_max(partner + out.capacity + j, i);  // of several left keypoints the last one stays
    out.depth[item] = point.z;
    out.point[item] = point;
  }

  /// Left keypoint i, and the right ones [begin, end) among which its partner may be.
  struct choice {
    keypoints_view const& left;
    keypoints_view const& right;
    int i;
    int begin, end;
  };
  /// The partner; -1 = none. @param mine descriptor of the left keypoint
  /// @param[out] point in the left camera's frame, metres, if there is a partner
  template <typename Group>
  FT_HOST_DEVICE static int find(Group g, fisheye_stereo<Rig> const& stereo, choice const& of,
                                 descriptor const& mine, vec3<float>& point) {
    fisheye_stereo_params const& params = stereo.params;
    two_nearest const best = nearest(g, mine, of.right, of.begin, of.end);
    if (best.second == best.none) { return -1; }
    if (params.ratio_den * best.first >= params.ratio_num * best.second) { return -1; }
    int const j = best.index;
    return accept(g, stereo, {of.left, of.right, of.i, j}, point) ? j : -1;
  }

private:
  /// A left keypoint and its candidate.
  struct candidate_pair {
    keypoints_view const& left;
    keypoints_view const& right;
    int i, j;
  };

  /// The two nearest of the right keypoints [begin, end).
  template <typename Group>
  FT_HOST_DEVICE static two_nearest nearest(Group g, descriptor const& mine,
                                            keypoints_view const& right, int begin, int end) {
    two_nearest best;
    if constexpr (Group::max_threads == 1) {
      for (int j = begin; j < end; ++j) { best.add(search_distance(mine, right.orb(j)), j); }
    } else {
      constexpr int together = 8;  // keypoints per thread whose loads are in flight
      FT_NO_UNROLL
      for (int base = begin + g.rank(); base - g.rank() < end; base += together * g.size()) {
        descriptor theirs[together];
        FT_UNROLL
        for (int n = 0; n < together; ++n) {
          theirs[n] = right.orb(min_of(base + n * g.size(), end - 1));
        }
        FT_UNROLL
        for (int n = 0; n < together; ++n) {
          int const j = base + n * g.size();
          int const distance = search_distance_by_adders(mine, theirs[n]);
          best.add(j < end ? distance : best.none, j);
        }
      }
    }
    return best.merged(g);
  }

  /// Triangulates; false if the two keypoints cannot be images of one point. All threads of a group
  /// do the same work, with one exception: if both cameras have the same model, lanes of even rank
  /// evaluate the left camera and the others the right one.
  template <typename Group>
  FT_HOST_DEVICE static bool accept(Group g, fisheye_stereo<Rig> const& stereo,
                                    candidate_pair const& pair, vec3<float>& point) {
    Rig const& rig = stereo.rig;
    fisheye_stereo_params const& params = stereo.params;
    constexpr bool by_halves =
        Group::max_threads == 32 && std::is_same<decltype(rig.left), decltype(rig.right)>::value;
    vec2<strict_float> const pl = position(stereo.geometry, pair.left, pair.i);
    vec2<strict_float> const pr = position(stereo.geometry, pair.right, pair.j);
    float const sigma2_l = stereo.geometry.sigma2[pair.left.octave(pair.i)];
    float const sigma2_r = stereo.geometry.sigma2[pair.right.octave(pair.j)];
    auto const cam_l = rig.left.template cast<strict_float>();
    auto const cam_r = rig.right.template cast<strict_float>();
    bool const is_right = g.rank() % 2 != 0;
    auto const own = [is_right](auto of_left, auto of_right) {
      return is_right ? of_right : of_left;
    };
    vec3<strict_float> l;
    vec3<strict_float> r;
    if constexpr (by_halves) {
      vec3<strict_float> const ray = own(cam_l, cam_r).unproject(own(pl, pr)).direction;
      l = shuffled(g, ray, 0);
      r = shuffled(g, ray, 1);
    } else {
      l = cam_l.unproject(pl).direction;
      r = cam_r.unproject(pr).direction;
    }
    auto const T_rl = rig.T_rl.template cast<strict_float>();
    vec3<strict_float> const r_in_l = T_rl.R.transposed() * r;
    strict_float const cosine =
        dot(l, r_in_l) / (scalar::sqrt(dot(l, l)) * scalar::sqrt(dot(r_in_l, r_in_l)));
    if (!(widened(cosine) <= params.max_cosine && l.z > 0.0f && r.z > 0.0f)) { return false; }
    // Scaled to z = 1. Rays of some models already have z = 1 and do not change.
    point = triangulate({(l.x / l.z).value, (l.y / l.z).value, 1.0f},
                        {(r.x / r.z).value, (r.y / r.z).value, 1.0f}, rig.T_rl);
    vec3<strict_float> const in_l{point.x, point.y, point.z};
    vec3<strict_float> const in_r = T_rl * in_l;
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
  /// Of keypoint i in its input image, pixels.
  FT_HOST_DEVICE static vec2<strict_float> position(pyramid_geometry const& geometry,
                                                    keypoints_view const& keypoints, int i) {
    int const octave = keypoints.octave(i);
    return {geometry.column(keypoints.x(i), octave), geometry.row(keypoints.y(i), octave)};
  }
  template <typename Group>
  FT_HOST_DEVICE static vec3<strict_float> shuffled(Group g, vec3<strict_float> v, int from) {
    return {g.shuffle(v.x.value, from), g.shuffle(v.y.value, from), g.shuffle(v.z.value, from)};
  }
  FT_HOST_DEVICE static bool near_enough(vec2<strict_float> a, vec2<strict_float> b, float sigma2,
                                         fisheye_stereo_params const& params) {
    strict_float const dx = a.x - b.x;
    strict_float const dy = a.y - b.y;
    return widened(dx * dx + dy * dy) <= params.chi2 * double{sigma2};
  }
};

}  // namespace detail

/// Finds partners, depths and points of the keypoints in the overlap of every pair; images 2 b and
/// 2 b + 1 are pair b. Asynchronous on `exec`; allocates nothing; two launches, of which only the
/// first is concurrent with its predecessor if `exec` says so.
template <typename Exec, typename Rig>
void match_stereo_fisheye(Exec const& exec, fisheye_stereo<Rig> const& stereo,
                          keypoints_view const& keypoints, fisheye_matches_view const& out) {
  for_each_item<per_thread>(exec, 2 * out.batch * out.capacity, detail::clear_partner{}, out);
  for_each_item<per_warp>(detail::with_order(exec, detail::launch_order::serial),
                          out.batch * out.capacity, detail::match_fisheye_keypoint<Rig>{}, stereo,
                          keypoints, out);
}

}  // namespace FT_ABI
}  // namespace ft
