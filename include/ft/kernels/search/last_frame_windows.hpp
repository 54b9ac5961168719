// SPDX-License-Identifier: Apache-2.0
/// @file Windows and candidates of the search from the last frame.
#pragma once

#include <cstddef>

#include "ft/cameras/stereo_rig.hpp"
#include "ft/containers/frame.hpp"
#include "ft/containers/image_pyramid.hpp"
#include "ft/containers/keypoints.hpp"
#include "ft/containers/map_points.hpp"
#include "ft/core/config.hpp"
#include "ft/kernels/search/candidates.hpp"
#include "ft/kernels/search/windows.hpp"
#include "ft/kernels/search/workspace.hpp"

namespace ft {
inline namespace FT_ABI {

/// The last frame, as far as the search needs it: keypoints of the left camera and, in a fisheye
/// pair, of the right one. Laid out as in frame_view.
struct last_frame_view {
  soa_view<field::angle, field::octave> keypoints;
  int keypoint_step = 2;
  int cameras = 1;
  /// [batch][cameras * capacity] slot of an inlier map point, -1 = none.
  int const* holder = nullptr;
};

struct last_search_params {
  /// Half side of a window at scale 1, pixels.
  float th = 7;
  /// Ignores the direction of motion when choosing octaves.
  bool mono = false;
  /// With fewer matches the search is repeated with twice the radius.
  int retry_below = 0;
  /// Drops matches whose rotation differs from that of most others.
  bool orientation_check = true;
  /// Projects into the right fisheye camera with the left camera's model, as the reference does.
  bool reference_quirks = false;
  float min_x = 0, min_y = 0, max_x = 0, max_y = 0;  ///< image bounds, pixels, inclusive
};

/// Number of keypoints of the last frame. The search takes the left ones first, then the right
/// ones.
FT_HOST_DEVICE inline int last_point_count(last_frame_view const& last, int b) {
  return last.keypoints.count[last.keypoint_step * b] +
         (last.cameras == 2 ? last.keypoints.count[last.keypoint_step * b + 1] : 0);
}

/// Inputs of the windows of a search from the last frame.
template <typename Rig>
struct last_search {
  Rig rig;
  pose const* poses;       ///< [batch] T_cw predicted for this frame
  pose const* last_poses;  ///< [batch] T_cw of the last frame
  last_frame_view last;
  last_search_params params;
  /// [batch] rotations of `poses` as unit quaternions, or null. Where given, they rotate the points
  /// in place of the matrices, whose result differs in the last bit.
  quaternion<float> const* rotations = nullptr;
};

namespace detail {

/// Item: a keypoint of the last frame. Lists the candidates in the windows of its map point.
template <typename Rig>
struct list_last_point {
  using scratch = list_candidates::scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int item, last_search<Rig> const& search,
                                 frame_view const& frame, map_points_view const& map,
                                 pyramid_geometry const& geometry, search_params const& params,
                                 search_windows_view const& windows,
                                 search_workspace const& work) const {
    int const b = item / windows.capacity;
    int const i = item % windows.capacity;
    int const count = last_point_count(search.last, b);
    if (i == 0 && g.rank() == 0) { windows.count[b] = count; }
    if (i >= count) { return; }
    list(g, s, b, i, search, search.params.th, frame, map, geometry, params, windows, work);
  }

  /// Lists the candidates of keypoint i of batch entry b.
  /// @param th half side of a window at scale 1, pixels
  template <typename Group>
  FT_HOST_DEVICE static void list(Group g, scratch& s, int b, int i, last_search<Rig> const& search,
                                  float th, frame_view const& frame, map_points_view const& map,
                                  pyramid_geometry const& geometry, search_params const& params,
                                  search_windows_view const& windows,
                                  search_workspace const& work) {
    // All threads compute the same windows, which is faster than a broadcast.
    window_pair const pair = project(b, i, search, th, map, geometry);
    if (g.rank() == 0) {
      windows.at(0, b, i) = pair.of[0];
      if constexpr (!Rig::rectified) { windows.at(1, b, i) = pair.of[1]; }
    }
    list_candidates::list(g, s, b, i, pair, frame, map, params, work);
  }

private:
  FT_HOST_DEVICE static window_pair project(int b, int i, last_search<Rig> const& search, float th,
                                            map_points_view const& map,
                                            pyramid_geometry const& geometry) {
    Rig const& rig = search.rig;
    last_frame_view const& last = search.last;
    last_search_params const& params = search.params;
    window_pair out;
    int const left_count = last.keypoints.count[last.keypoint_step * b];
    int const c_last = i < left_count ? 0 : 1;
    int const k = i < left_count ? i : i - left_count;
    int const number = c_last * last.keypoints.capacity + k;
    int const slot =
        last.holder[static_cast<std::ptrdiff_t>(b) * last.cameras * last.keypoints.capacity +
                    number];
    map_points_view const points = map.slice(b);
    if (slot < 0 || slot >= points.capacity) { return out; }

    auto const T_cw = search.poses[b].template cast<strict_float>();
    auto const T_lw = search.last_poses[b].template cast<strict_float>();
    vec3<float> const world = get<field::position>(points, slot);
    vec3<strict_float> Pc = T_cw * vec3<strict_float>{world.x, world.y, world.z};
    if (search.rotations != nullptr) { Pc = rotated(search.rotations[b], world) + T_cw.t; }
    strict_float const inv_z = strict_float(1.0f) / Pc.z;
    if (!(inv_z >= 0.0f)) { return out; }
    int const octave = get<field::octave>(last.keypoints.slice(last.keypoint_step * b + c_last), k);
    strict_float const baseline = rig.baseline_length();
    strict_float const ahead = (T_lw * T_cw.centre()).z;
    bool const forward = ahead > baseline && !params.mono;
    bool const backward = -ahead > baseline && !params.mono;

    search_window w{};
    w.radius = mul(th, geometry.scale[octave]);
    w.min_level = forward ? octave : (backward ? 0 : octave - 1);
    w.max_level = forward ? -1 : (backward ? octave : octave + 1);
    w.slot = slot;
    if constexpr (Rig::rectified) {
      auto const seen = rig.camera.template cast<strict_float>().project(Pc);
      if (!in_bounds(seen, params)) { return out; }
      w.x = seen.pixel.x.value;
      w.y = seen.pixel.y.value;
      w.right_x = (seen.pixel.x - rig.bf * inv_z).value;
      w.check_right = true;
      out.of[0] = w;
    } else {
      auto const seen = rig.left.template cast<strict_float>().project(Pc);
      if (!in_bounds(seen, params)) { return out; }
      w.x = seen.pixel.x.value;
      w.y = seen.pixel.y.value;
      out.of[0] = w;
      vec3<strict_float> const Pr = rig.T_rl.template cast<strict_float>() * Pc;
      auto const right = project_right(rig, Pr, params.reference_quirks);
      if (!right.valid) { return out; }
      w.x = right.pixel.x.value;
      w.y = right.pixel.y.value;
      out.of[1] = w;
    }
    return out;
  }

  FT_HOST_DEVICE static vec3<strict_float> rotated(quaternion<float> q, vec3<float> v) {
    return quaternion<strict_float>{q.x, q.y, q.z, q.w} * vec3<strict_float>{v.x, v.y, v.z};
  }
  FT_HOST_DEVICE static bool in_bounds(projection<strict_float> const& p,
                                       last_search_params const& b) {
    return p.valid && p.pixel.x >= b.min_x && p.pixel.x <= b.max_x && p.pixel.y >= b.min_y &&
           p.pixel.y <= b.max_y;
  }
  FT_HOST_DEVICE static projection<strict_float> project_right(Rig const& rig, vec3<strict_float> p,
                                                               bool quirks) {
    if (quirks) { return rig.left.template cast<strict_float>().project(p); }
    return rig.right.template cast<strict_float>().project(p);
  }
};

}  // namespace detail

}  // namespace FT_ABI
}  // namespace ft
