// SPDX-License-Identifier: Apache-2.0
/// @file Stage: search for the map points of a keyframe in a frame whose pose is known roughly, as
/// relocalisation does. Source: Mur-Artal et al., "ORB-SLAM: a versatile and accurate monocular
/// SLAM system", T-RO 2015; specification sections 8 to 10 for what it shares with other searches.
#pragma once

#include <cstddef>

#include "ft/cameras/camera_model.hpp"
#include "ft/cameras/pinhole.hpp"
#include "ft/containers/frame.hpp"
#include "ft/containers/image_pyramid.hpp"
#include "ft/containers/map_points.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/kernels/search/assignment.hpp"
#include "ft/kernels/search/detail/candidate_list.hpp"
#include "ft/kernels/search/detail/candidates.hpp"
#include "ft/kernels/search/detail/orientation_check.hpp"
#include "ft/kernels/search/frustum.hpp"
#include "ft/kernels/search/last_frame_windows.hpp"
#include "ft/kernels/search/workspace.hpp"
#include "ft/types/poses.hpp"
#include "ft/types/relocalization.hpp"

namespace ft {
inline namespace FT_ABI {

/// Inputs of a search for a keyframe's points, apart from the frame and the map.
/// @tparam Camera the frame's left camera, the only one that is searched
/// @tparam Cameras of the frame
template <typename Camera, int Cameras = 1>
struct keyframe_search {
  static_assert(assert_camera_model<Camera>::value, "a search needs a camera model");
  static_assert(Cameras == 1 || Cameras == 2, "a frame has one camera or two");
  Camera camera;
  pose const* T_cw = nullptr;  ///< [batch] world to the left camera of the frame
  /// The keyframe: angles and points of its keypoints, in both cameras. A point that two keypoints
  /// hold is searched twice. Octaves are not read.
  last_frame_view keyframe;
  point_stamps found;      ///< stamped points are not searched; may be without arrays
  frustum_params frustum;  ///< the viewing angle is not compared
  pyramid_geometry geometry;
  keyframe_search_params params;

  FT_HOST_DEVICE search_params matching() const {
    search_params p;
    p.kind = search_kind::last_frame;
    p.max_hamming = params.max_hamming;
    p.all_observed = true;
    return p;
  }
};

namespace detail {

/// Whether a model depends on x / z and y / z alone, and so projects a point behind the camera
/// where it projects the opposite one.
template <typename Camera>
inline constexpr bool is_central_projection = false;
template <typename Scalar>
inline constexpr bool is_central_projection<pinhole<Scalar>> = true;

/// The windows of a search for a keyframe's points; see list_point.
template <typename Camera, int Cameras>
struct keyframe_windows {
  using search = keyframe_search<Camera, Cameras>;
  static constexpr int searches = 1;
  static constexpr int cameras = Cameras;
  static constexpr bool lists_by_column = false;  ///< see frame_search

  FT_HOST_DEVICE static int count(search const& in, int b) { return in.keyframe.count(b); }

  /// The window of the map point of keypoint i.
  FT_HOST_DEVICE static window_pair find(search const& in, map_points_view const& map, int b, int i,
                                         search_windows_view const& /*to*/, bool /*writes*/) {
    window_pair out;
    map_points_view const points = map.slice(b);
    int const slot = in.keyframe.slot(b, i);
    if (slot < 0 || slot >= points.capacity || in.found.stamped(b, points.capacity, slot)) {
      return out;
    }
    viewpoint const from = viewpoint::of(in.T_cw[b]);
    vec3<float> const world = points.position(slot);
    vec3<strict_float> const P{world.x, world.y, world.z};
    auto const seen = project(in.camera, from.T_cw.template cast<strict_float>() * P);
    float const x = seen.pixel.x.value;
    float const y = seen.pixel.y.value;
    frustum_params const& bounds = in.frustum;
    if (!seen.valid ||
        !(x >= bounds.min_x && x <= bounds.max_x && y >= bounds.min_y && y <= bounds.max_y)) {
      return out;
    }
    auto const view = P - from.centre.template cast<strict_float>();
    strict_float const distance = scalar::sqrt(dot(view, view));
    bool const finite = distance > strict_float(0.0f) && scalar::is_finite(distance);
    if (!finite || !sees_from(distance, points, slot)) { return out; }
    int const level = expected_level(distance, points.max_distance(slot), bounds);
    search_window& w = out.of[0];
    w.x = x;
    w.y = y;
    w.radius = mul(in.params.window_radius, in.geometry.scale[level]);
    w.min_level = level - 1;
    w.max_level = level + 1;
    w.slot = slot;
    return out;
  }

private:
  /// As in the reference, a point behind the camera may have a pixel.
  FT_HOST_DEVICE static projection<strict_float> project(Camera const& camera,
                                                         vec3<strict_float> p) {
    if (is_central_projection<Camera> && p.z < strict_float(0.0f)) { p = -p; }
    return camera.template cast<strict_float>().project(p);
  }
};

/// Item: a frame. Assigns its keypoints and checks orientations.
template <bool Turns>
struct assign_keyframe_points {
  using assignment = assign_keypoints<Turns>;
  struct scratch {
    typename assignment::scratch assigned;
    check_orientation::scratch orientation;
  };

  template <typename Group, typename Search>
  FT_HOST_DEVICE static void prologue(Group g, scratch& s, int b, Search const&,
                                      frame_view const& frame, map_points_view const&,
                                      search_buffers const&) {
    assignment::prologue(g, s.assigned, b, frame);
  }

  template <typename Group, typename Search>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int b, Search const& search,
                                 frame_view const& frame, map_points_view const& map,
                                 search_buffers const& buffers) const {
    search_params const params = search.matching();
    assignment::assign(g, s.assigned, {b, frame, map, params, buffers, false}, true,
                       [](auto, int const*) { return false; });
    g.sync();
    if (search.params.orientation_check) {
      check_orientation{}(g, s.orientation, b, frame, search.keyframe, buffers);
    }
  }
};

}  // namespace detail

/// Search for the map points of a keyframe, in a square around each point's projection and in three
/// octaves. In the order of the keyframe's keypoints, each takes the nearest keypoint of the left
/// camera that holds no point. Other keypoints keep what they hold.
///
/// Writes `frame.holder`, `work.match` and `work.matches`, the number of keypoints taken.
/// Asynchronous on `exec`; allocates nothing; two launches, of which only the first is concurrent
/// with its predecessor if `exec` says so.
/// @throws bad_argument if frame, keyframe and search do not agree in their number of cameras, or
///   there are fewer windows than keypoints of a keyframe, or the levels of the image are not given
template <typename Exec, typename Camera, int Cameras>
void search_keyframe(Exec const& exec, keyframe_search<Camera, Cameras> const& search,
                     frame_view const& frame, map_points_view const& map,
                     search_buffers const& buffers) {
  detail::require_range("cameras of the frame", frame.cameras, Cameras, Cameras);
  detail::require_range("cameras of the keyframe", search.keyframe.cameras, Cameras, Cameras);
  detail::require_range("cameras of the windows", buffers.windows.cameras, Cameras, Cameras);
  detail::require_range("levels of the image", search.frustum.levels, 1, max_levels);
  detail::require_range("log_scale_factor", search.frustum.log_scale_factor, 1e-6f, 1e6f);
  detail::require_range("windows of a frame", buffers.windows.capacity,
                        Cameras * search.keyframe.keypoints.capacity, 1 << 24);
  for_each_item<per_warp>(exec, buffers.windows.batch * buffers.windows.capacity,
                          detail::list_point<detail::keyframe_windows<Camera, Cameras>>{}, search,
                          frame, map, buffers);
  for_each_item<per_block<detail::assign_threads>>(
      detail::with_order(exec, detail::launch_order::serial), frame.batch,
      detail::assign_keyframe_points<Exec::asynchronous>{}, search, frame, map, buffers);
}

}  // namespace FT_ABI
}  // namespace ft
