// SPDX-License-Identifier: Apache-2.0
/// @file Stages: keep the keypoints of a frame that have a depth, or hold a map point.
#pragma once

#include <cstddef>

#include "ft/containers/frame.hpp"
#include "ft/containers/loop_archive.hpp"
#include "ft/containers/map_points.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/kernels/map/keyframe_input.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// One item: batch entry b of the frames becomes a row.
template <typename Rig>
struct keep_loop_keyframe {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int, keyframe_input<Rig> const& in, int b,
                                 int row, loop_archive_view const& to) const {
    int mine = 0;
    for (int c = 0; c < cameras; ++c) {
      int const keypoints = *in.frame.camera(b, c).count;
      for (int i = g.rank(); i < keypoints; i += g.size()) {
        mine += static_cast<int>(has_depth(in, b, c, i));
      }
    }
    int const all = g.reduce(mine, sum_op{});
    int const kept = min_of(all, to.points);
    if (g.rank() == 0) { to.count[row] = kept; }
    int before = 0;
    for (int c = 0; c < cameras; ++c) {
      int const keypoints = *in.frame.camera(b, c).count;
      for (int base = 0; base < keypoints; base += g.size()) {
        int const i = base + g.rank();
        bool const there = i < keypoints && has_depth(in, b, c, i);
        int here = 0;
        int const k = before + g.exclusive_count(there, here);
        before += here;
        if (!there) { continue; }
        // Of `all` keypoints in their order every (all / kept)th.
        int const place = share(k, kept, all);
        if (share(k + 1, kept, all) != place) { write(in, b, c, i, to, to.at(row) + place); }
      }
    }
  }

private:
  static constexpr int cameras = keyframe_task<Rig>::depth_cameras;

  FT_HOST_DEVICE static int share(int k, int kept, int all) {
    return static_cast<int>(static_cast<long long>(k) * kept / all);
  }
  FT_HOST_DEVICE static bool has_depth(keyframe_input<Rig> const& in, int b, int c, int i) {
    std::ptrdiff_t const camera = static_cast<std::ptrdiff_t>(b) * cameras + c;
    float const d = in.depth[camera * in.frame.capacity() + i];
    return d > 0 && d < 1e30f;
  }
  FT_HOST_DEVICE static void write(keyframe_input<Rig> const& in, int b, int c, int i,
                                   loop_archive_view const& to, std::ptrdiff_t at) {
    keypoints_view const keypoints = in.frame.camera(b, c);
    int const octave = get<field::octave>(keypoints, i);
    to.orb[at] = get<field::orb>(keypoints, i);
    vec3<float> const seen = stereo_point(in, b, c, i);
    if constexpr (Rig::rectified) {
      to.point[at] = in.rig.to_body(c, seen.template cast<strict_float>()).template cast<float>();
    } else {
      to.point[at] = seen;
    }
    to.camera[at] = c;
    to.x[at] = in.geometry.column(get<field::x>(keypoints, i), octave);
    to.y[at] = in.geometry.row(get<field::y>(keypoints, i), octave);
    float const right = right_column<Rig>(in.frame, b, c, i);
    to.right_x[at] = Rig::rectified && right >= 0 ? in.geometry.column(right, octave) : -1.0f;
    to.inv_sigma2[at] = in.geometry.inv_sigma2[octave];
  }
};

/// Item: a keypoint of the only camera. The map point that it holds, in the camera's frame.
struct place_held_point {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int i, int const* holder,
                                 map_points_view const& points, rigid<double> const* T_cw,
                                 float* depth, vec3<float>* point) const {
    depth[i] = -1;
    if (holder[i] < 0) { return; }
    auto const p = T_cw->cast<strict_double>() *
                   get<field::position>(points, holder[i]).template cast<strict_double>();
    point[i] = p.template cast<float>();
    depth[i] = point[i].z;
  }
};

/// Item: a keypoint of the only camera.
struct place_ahead {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int i, float* depth, vec3<float>* point) const {
    depth[i] = 1;
    point[i] = {0, 0, 1};
  }
};

}  // namespace detail

/// Gives all keypoints of one camera's frame a point that says nothing, so that they are kept.
/// Asynchronous on `exec`; allocates nothing; one launch.
/// @param depth, point [count] executor memory
template <typename Exec>
void place_all_ahead(Exec const& exec, int count, float* depth, vec3<float>* point) {
  for_each_item<per_thread>(exec, count, detail::place_ahead{}, depth, point);
}

/// The map points that the keypoints of one camera's frame hold, instead of depths that it does not
/// see. Asynchronous on `exec`; allocates nothing; one launch.
/// @param in batch of one @param points of the map that its T_cw and `holder` are of
/// @param depth [capacity] executor memory, -1 = holds none @param point likewise, where it has a
///   depth, in the camera's frame
template <typename Exec, typename Rig>
void place_held_points(Exec const& exec, keyframe_input<Rig> const& in,
                       map_points_view const& points, float* depth, vec3<float>* point) {
  for_each_item<per_thread>(exec, in.frame.capacity(), detail::place_held_point{},
                            static_cast<int const*>(in.frame.holder), points, in.T_cw, depth,
                            point);
}

/// Keeps the keypoints of a frame that have a depth, of the left camera or of each of a multi_rig,
/// at most loop_archive_view::points of them, spread evenly over their order. Asynchronous on
/// `exec`; allocates nothing; one launch.
/// @param in `order`, `T_cw` and `time_ns` are not read @param b batch entry @param row of `to`
template <typename Exec, typename Rig>
void keep_keyframe(Exec const& exec, keyframe_input<Rig> const& in, int b, int row,
                   loop_archive_view const& to) {
  detail::require_range("row of a kept keyframe", row, 0, to.rows - 1);
  for_each_item<per_block<256>>(exec, 1, detail::keep_loop_keyframe<Rig>{}, in, b, row, to);
}

}  // namespace FT_ABI
}  // namespace ft
