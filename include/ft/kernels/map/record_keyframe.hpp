// SPDX-License-Identifier: Apache-2.0
/// @file Writes the keypoints of a new keyframe, and what its points learn from them.
#pragma once

#include <cstddef>

#include "ft/containers/odometry_map.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/geometry.hpp"
#include "ft/kernels/map/describe_point.hpp"
#include "ft/kernels/map/keyframe_input.hpp"
#include "ft/kernels/map/place_keyframe.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// Item: a keypoint number of a batch entry. After place_keyframe.
template <typename Rig>
struct record_keypoint {
  using scratch = no_scratch;
  using input = keyframe_input<Rig>;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int item, input const& in,
                                 odometry_map_view const& map,
                                 keyframe_workspace const& work) const {
    frame_view const& frame = in.frame;
    int const b = item / frame.numbers();
    int const number = item % frame.numbers();
    int const c = number / frame.capacity();
    int const i = number % frame.capacity();
    if (in.order[b] == keyframe_order::none) { return; }
    keypoints_view const keypoints = frame.camera(b, c);
    if (i >= *keypoints.count) { return; }
    keyframes_view const& to = map.keyframes;
    std::ptrdiff_t const at = to.at(b, to.position(to.made[b]), number);
    int const slot = frame.holder[item];
    auto const claim = [&](int camera) {
      return work.claim[work.at(b, camera, slot, frame.cameras, map.records.slots)];
    };
    bool const holds = slot >= 0 && claim(c) == number;
    to.x[at] = get<field::x>(keypoints, i);
    to.y[at] = get<field::y>(keypoints, i);
    to.octave[at] = get<field::octave>(keypoints, i);
    to.right_x[at] = right_column(frame, b, c, i);
    to.holder[at] = holds ? slot : -1;
    to.holder_number[at] = holds ? map.records.number[map.records.at(b, slot)] : 0;
    if (!holds) { return; }
    // Of several cameras the first one's keypoint describes the point.
    for (int before = 0; before < c; ++before) {
      if (claim(before) != unclaimed) { return; }
    }
    if (map.records.described[map.records.at(b, slot)] == 0) {
      place_point(in, map, b, number, slot);
    }
    add_descriptor(map, b, slot, get<field::orb>(keypoints, i));
    get<field::normal>(map.points.slice(b), slot) = mean_direction(map, b, slot);
  }

private:
  FT_HOST_DEVICE static float right_column(frame_view const& frame, int b, int c, int i) {
    if (!Rig::rectified || frame.right_x == nullptr) { return -1.0f; }
    return frame
        .right_x[static_cast<std::ptrdiff_t>(b) * frame.numbers() + c * frame.capacity() + i];
  }

  /// The stereo point of a left keypoint, in its camera's frame.
  FT_HOST_DEVICE static vec3<float> stereo_point(input const& in, int b, int c, int i) {
    if constexpr (Rig::rectified) {
      keypoints_view const keypoints = in.frame.camera(b, c);
      strict_float const x = get<field::x>(keypoints, i);
      strict_float const y = get<field::y>(keypoints, i);
      auto const ray =
          in.rig.pair(c).camera.template cast<strict_float>().unproject({x, y}).direction;
      float const z = in.depth[static_cast<std::ptrdiff_t>(b) * in.frame.numbers() +
                               c * in.frame.capacity() + i];
      return {(ray.x * z).value, (ray.y * z).value, z};
    } else {
      static_cast<void>(c);
      return in.point[static_cast<std::ptrdiff_t>(b) * in.frame.capacity() + i];
    }
  }

  /// Position and distances of a new point, from its first keypoint. Distances are those from the
  /// camera that sees it.
  FT_HOST_DEVICE static void place_point(input const& in, odometry_map_view const& map, int b,
                                         int number, int slot) {
    int const c = Rig::rectified ? number / in.frame.capacity() : 0;
    int const i = number - c * in.frame.capacity();
    map_points_view const points = map.points.slice(b);
    vec3<strict_double> const seen = widened(stereo_point(in, b, c, i));
    vec3<strict_double> in_body = seen;
    if constexpr (Rig::rectified) { in_body = in.rig.to_body(c, seen); }
    auto const T_cw = in.T_cw[b].template cast<strict_double>();
    strict_float const distance = static_cast<float>(scalar::sqrt(dot(seen, seen)).value);
    pyramid_geometry const& levels = in.geometry;
    int const octave = get<field::octave>(in.frame.camera(b, c), i);
    strict_float const most = distance * levels.scale[octave];
    get<field::position>(points, slot) = narrowed(T_cw.inverse() * in_body);
    get<field::max_distance>(points, slot) = most.value;
    get<field::min_distance>(points, slot) = (most / levels.scale[levels.levels - 1]).value;
  }
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
