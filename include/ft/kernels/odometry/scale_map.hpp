// SPDX-License-Identifier: Apache-2.0
/// @file Stage: gives the map of one camera its scale, once that is known.
#pragma once

#include <cstddef>

#include "ft/containers/odometry_map.hpp"
#include "ft/containers/point_patches.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/kernels/odometry/state.hpp"
#include "ft/types/poses.hpp"
#include "ft/types/tracking.hpp"

namespace ft {
inline namespace FT_ABI {

/// A change of the unit of a map: x becomes about + factor (x - about).
struct map_scaling {
  double factor;       ///< above 0; 1 = nothing changes
  vec3<double> about;  ///< world, in the old unit
};

namespace detail {

/// Item: some slots of a map; the first item of a map also has its keyframes and its camera.
struct scale_map_part {
  using scratch = no_scratch;
  using real = strict_double;
  static constexpr int own_slots = 1024;

  FT_HOST_DEVICE static int items(odometry_map_view const& map) {
    return ceil_div(map.records.slots, own_slots);
  }

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int item, map_scaling const* scalings,
                                 odometry_map_view const& map, odometry_state_view const& state,
                                 rigid<double>* correction,
                                 point_patches_view const& patches) const {
    int const b = item / items(map);
    int const part = item % items(map);
    map_scaling const s = scalings[b];
    if (!(s.factor > 0) || s.factor == 1) { return; }
    int const end = min_of(map.records.used[b], own_slots * (part + 1));
    for (int slot = own_slots * part + g.rank(); slot < end; slot += g.size()) {
      if (!map.records.holds_point(b, slot)) { continue; }
      scale_point(map.points.slice(b), slot, s);
      if (patches.number == nullptr) { continue; }
      point_patch& patch = patches.patch[patches.at(b, slot)];
      patch.across = scaled(patch.across, static_cast<float>(s.factor));
      patch.down = scaled(patch.down, static_cast<float>(s.factor));
    }
    if (part != 0) { return; }
    keyframes_view const& kf = map.keyframes;
    for (int number = kf.oldest(b) + g.rank(); number <= kf.made[b]; number += g.size()) {
      scale_pose(kf.T_cw[kf.at(b, kf.position(number))], s);
    }
    if (g.rank() != 0) { return; }
    camera_track& t = state.tracks[b];
    scale_pose(state.T_cw[b], s);
    scale_pose(t.keyframe, s);
    scale_motion(correction[b], s);
    t.velocity.motion.t = scaled(t.velocity.motion.t.cast<real>(), real(s.factor)).cast<double>();
  }

private:
  FT_HOST_DEVICE static void scale_point(map_points_view const& points, int slot,
                                         map_scaling const& s) {
    auto const times = [&](float v) {
      return static_cast<float>((real(static_cast<double>(v)) * real(s.factor)).value);
    };
    auto& position = get<field::position>(points, slot);
    vec3<real> const about = s.about.cast<real>();
    vec3<real> const p = position.template cast<real>();
    position = (about + scaled(p - about, real(s.factor))).template cast<float>();
    auto& least = get<field::min_distance>(points, slot);
    auto& most = get<field::max_distance>(points, slot);
    least = times(least);
    most = times(most);
  }
  /// A motion of points of the world.
  FT_HOST_DEVICE static void scale_motion(rigid<double>& T, map_scaling const& s) {
    auto const C = T.cast<real>();
    vec3<real> const about = s.about.cast<real>();
    vec3<real> const away = C.R * about + C.t - about;
    T.t = (about - C.R * about + scaled(away, real(s.factor))).cast<double>();
  }
  /// The camera's centre moves as a point; t = -R centre.
  FT_HOST_DEVICE static void scale_pose(rigid<double>& T_cw, map_scaling const& s) {
    auto const T = T_cw.cast<real>();
    vec3<real> const lever = T.R * s.about.cast<real>();
    T_cw.t = (scaled(T.t + lever, real(s.factor)) - lever).cast<double>();
  }
};

}  // namespace detail

/// Changes the unit of maps: of points with their limits of distance and their patches, of
/// keyframes, and of the camera's last pose and motion. Rotations and normals stay. No adjustment
/// of such a map may be in flight. Asynchronous on `exec`; allocates nothing; one launch.
/// @param scalings [batch] executor memory @param correction [batch] of apply_window(); in and out
/// @param patches of the maps' points; none without a number
template <typename Exec>
void scale_maps(Exec const& exec, map_scaling const* scalings, odometry_map_view const& map,
                odometry_state_view const& state, rigid<double>* correction,
                point_patches_view const& patches = {}) {
  int const items = state.batch * detail::scale_map_part::items(map);
  for_each_item<per_block<256>>(exec, items, detail::scale_map_part{}, scalings, map, state,
                                correction, patches);
}

}  // namespace FT_ABI
}  // namespace ft
