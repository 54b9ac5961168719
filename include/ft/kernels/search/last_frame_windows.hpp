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
#include "ft/kernels/search/workspace.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {

/// The parts of the last frame that the search needs: keypoints of the left camera and, in a
/// fisheye pair, of the right one. Laid out as in frame_view.
struct last_frame_view {
  soa_view<field::angle, field::octave> keypoints;
  int keypoint_step = 2;
  int cameras = 1;
  /// [batch][cameras * capacity] slot of an inlier map point, -1 = none.
  int const* holder = nullptr;

  /// Keypoints of batch entry b in both cameras. A search takes the left ones first, then the right
  /// ones.
  FT_HOST_DEVICE int count(int b) const {
    return keypoints.count[keypoint_step * b] +
           (cameras == 2 ? keypoints.count[keypoint_step * b + 1] : 0);
  }
  /// Number of keypoint i of batch entry b in that order.
  FT_HOST_DEVICE int number(int b, int i) const {
    int const left_count = keypoints.count[keypoint_step * b];
    return i < left_count ? i : keypoints.capacity + i - left_count;
  }
  /// Slot that keypoint i of batch entry b holds.
  FT_HOST_DEVICE int slot(int b, int i) const {
    return holder[static_cast<std::ptrdiff_t>(b) * cameras * keypoints.capacity + number(b, i)];
  }
};

struct last_search_params {
  /// Half side of a window at scale 1, pixels.
  float window_radius = 7;
  /// Searches all neighbouring octaves, regardless of the camera's direction of motion.
  bool ignore_motion_direction = false;
  int max_hamming = detail::descriptor_scale::limit(100);  ///< see search_params
  /// With fewer matches the search is repeated with twice the radius.
  int retry_below = 0;
  /// Drops matches whose rotation differs from that of most others.
  bool orientation_check = true;
  /// Projects into the right fisheye camera with the left camera's model, as the reference does.
  bool reference_quirks = false;
  float min_x = 0, min_y = 0, max_x = 0, max_y = 0;  ///< image bounds, pixels, inclusive
};

/// Inputs of a search from the last frame, apart from the frame and the map.
template <typename Rig>
struct last_search {
  Rig rig;
  pose const* T_cw = nullptr;       ///< [batch] predicted for this frame
  pose const* last_T_cw = nullptr;  ///< [batch] of the last frame
  last_frame_view last;             ///< as frame_view::of_searches() of the rig
  pyramid_geometry geometry;
  last_search_params params;
  point_stamps stamps;  ///< gets the matched points; may be without arrays
  /// [batch] rotations of `T_cw` as unit quaternions, or null. If given, they rotate the points
  /// instead of the matrices, whose result differs in the last bit.
  quaternion<float> const* rotations = nullptr;

  /// All but one member are known at compile time, which saves registers.
  FT_HOST_DEVICE search_params matching() const {
    search_params p;
    p.kind = search_kind::last_frame;
    p.max_hamming = params.max_hamming;
    p.from_empty = true;
    return p;
  }
};

namespace detail {

/// The windows of a search from the last frame; see list_point.
template <typename Rig>
struct last_frame_windows {
  using search = last_search<Rig>;
  static constexpr int searches = Rig::searches;
  static constexpr int cameras = Rig::cameras / searches;  ///< of a search
  static constexpr bool lists_by_column = false;           ///< see frame_search

  /// Number of keypoints of the last frame.
  FT_HOST_DEVICE static int count(search const& in, int b) { return in.last.count(b); }
  FT_HOST_DEVICE static window_pair find(search const& in, map_points_view const& map, int b, int i,
                                         search_windows_view const& /*to*/, bool /*writes*/) {
    return project(in, map, b, i, in.params.window_radius);
  }

  /// The windows of the map point of keypoint i, search b.
  /// @param radius half side of a window at scale 1, pixels
  FT_HOST_DEVICE static window_pair project(search const& in, map_points_view const& map, int b,
                                            int i, float radius) {
    Rig const& rig = in.rig;
    window_pair out;
    keypoint const from = keypoint_of(in.last, b, i);
    int const at = b / searches;
    map_points_view const points = map.slice(at);
    if (from.slot < 0 || from.slot >= points.capacity) { return out; }

    auto const T_cw = in.T_cw[at].template cast<strict_float>();
    vec3<float> const world = points.position(from.slot);
    vec3<strict_float> Pc = T_cw * vec3<strict_float>{world.x, world.y, world.z};
    if (in.rotations != nullptr) { Pc = rotated(in.rotations[at], world) + T_cw.t; }
    if constexpr (Rig::rectified) { Pc = rig.to_camera(b % searches, Pc); }
    strict_float const inv_z = strict_float(1.0f) / Pc.z;
    if (!(inv_z >= 0.0f)) { return out; }
    search_window w = without_centre(in, T_cw, b, from, radius);
    if constexpr (Rig::rectified) {
      auto const& pair = rig.pair(b % searches);
      auto const seen = pair.camera.template cast<strict_float>().project(Pc);
      if (!in_bounds(seen, in.params)) { return out; }
      w.x = seen.pixel.x.value;
      w.y = seen.pixel.y.value;
      w.right_x = (seen.pixel.x - pair.bf() * inv_z).value;
      w.check_right = true;
      out.of[0] = w;
    } else {
      auto const seen = rig.left.template cast<strict_float>().project(Pc);
      if (!in_bounds(seen, in.params)) { return out; }
      w.x = seen.pixel.x.value;
      w.y = seen.pixel.y.value;
      out.of[0] = w;
      vec3<strict_float> const Pr = rig.T_rl.template cast<strict_float>() * Pc;
      auto const right = project_right(rig, Pr, in.params.reference_quirks);
      if (!right.valid) { return out; }
      w.x = right.pixel.x.value;
      w.y = right.pixel.y.value;
      out.of[1] = w;
    }
    return out;
  }

private:
  /// A keypoint of the last frame.
  struct keypoint {
    int image;  ///< batch entry of its keypoints
    int k;      ///< index there
    int slot;   ///< of its map point, -1 = none
  };
  FT_HOST_DEVICE static keypoint keypoint_of(last_frame_view const& last, int b, int i) {
    int const number = last.number(b, i);
    int const camera = number < last.keypoints.capacity ? 0 : 1;
    int const k = number - camera * last.keypoints.capacity;
    return {last.keypoint_step * b + camera, k, last.slot(b, i)};
  }

  /// Radius and octaves. The octaves depend on whether the camera has moved along its axis by more
  /// than the baseline, if it has one.
  FT_HOST_DEVICE static search_window without_centre(search const& in,
                                                     rigid<strict_float> const& T_cw, int b,
                                                     keypoint const& from, float radius) {
    auto const T_lw = in.last_T_cw[b / searches].template cast<strict_float>();
    int const octave = in.last.keypoints.slice(from.image).octave(from.k);
    strict_float baseline;
    strict_float forward_motion;
    bool any_direction = in.params.ignore_motion_direction;
    if constexpr (Rig::rectified) {
      int const c = b % searches;
      auto const& pair = in.rig.pair(c);
      baseline = pair.baseline_length();
      forward_motion = (in.rig.to_camera(c, T_lw) * in.rig.to_camera(c, T_cw).centre()).z;
      any_direction = any_direction || pair.single();
    } else {
      baseline = in.rig.baseline_length();
      forward_motion = (T_lw * T_cw.centre()).z;
    }
    bool const forward = forward_motion > baseline && !any_direction;
    bool const backward = -forward_motion > baseline && !any_direction;
    search_window w{};
    w.radius = mul(radius, in.geometry.scale[octave]);
    w.min_level = forward ? octave : (backward ? 0 : octave - 1);
    w.max_level = forward ? -1 : (backward ? octave : octave + 1);
    w.slot = from.slot;
    return w;
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
