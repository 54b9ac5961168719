// SPDX-License-Identifier: Apache-2.0
/// @file Stage: visibility of map points, and the search windows of the visible ones.
/// Source: specification sections 8 and 9.
#pragma once

#include <cmath>
#include <cstddef>

#include "ft/cameras/stereo_rig.hpp"
#include "ft/containers/frame.hpp"
#include "ft/containers/image_pyramid.hpp"
#include "ft/containers/map_points.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/kernels/search/workspace.hpp"
#include "ft/types/poses.hpp"
#include "ft/types/relocalization.hpp"

namespace ft {
inline namespace FT_ABI {

/// Natural logarithm. Computed in double and rounded once, so that host and device agree. The
/// reference takes logf() of the C library, which may be a float beside; octaves are the same for
/// every ratio of [0.5, 32].
FT_HOST_DEVICE inline float log_rounded(float v) {
  return static_cast<float>(::log(static_cast<double>(v)));
}

/// Pose and centre of a camera.
struct viewpoint {
  pose T_cw;           ///< world to this camera
  vec3<float> centre;  ///< of this camera in the world, metres

  FT_HOST_DEVICE static viewpoint of(pose const& T_cw) {
    auto const c = T_cw.cast<strict_float>().centre();
    return {T_cw, {c.x.value, c.y.value, c.z.value}};
  }
};

namespace detail {

/// Whether a distance, metres, is one from which a map point is expected to be seen. In float, as
/// in the reference: 0.8f and 1.2f, not doubles.
FT_HOST_DEVICE inline bool sees_from(strict_float distance, map_points_view const& map, int slot) {
  return distance >= strict_float(0.8f) * map.min_distance(slot) &&
         distance <= strict_float(1.2f) * map.max_distance(slot);
}
/// The octave in which a map point is expected from that distance. The quotients, the logarithm and
/// the rounding up are in float, as in the reference: near a power of the scale factor double gives
/// another octave.
FT_HOST_DEVICE inline int expected_level(strict_float distance, float max_distance,
                                         frustum_params const& params) {
  strict_float const ratio = strict_float(max_distance) / distance;
  float const level =
      ::ceilf((strict_float(log_rounded(ratio.value)) / params.log_scale_factor).value);
  return static_cast<int>(clamp(level, 0.0f, static_cast<float>(params.levels - 1)));
}

}  // namespace detail

/// Tests one map point against one camera.
/// @param bf baseline times focal length; 0 without a column in a right image
template <typename Camera>
FT_HOST_DEVICE visibility test_visibility(Camera const& camera, viewpoint const& from,
                                          map_points_view const& map, int slot, float bf,
                                          frustum_params const& params) {
  visibility none{0, 0, 0, 0, 0, -1};
  auto const T = from.T_cw.cast<strict_float>();
  vec3<float> const world = map.position(slot);
  vec3<strict_float> const P{world.x, world.y, world.z};
  vec3<strict_float> const Pc = T * P;
  if (!(Pc.z >= 0.0f)) { return none; }
  auto const seen = camera.template cast<strict_float>().project(Pc);
  float const x = seen.pixel.x.value;
  float const y = seen.pixel.y.value;
  if (!seen.valid ||
      !(x >= params.min_x && x <= params.max_x && y >= params.min_y && y <= params.max_y)) {
    return none;
  }
  vec3<strict_float> const view =
      P - vec3<strict_float>{from.centre.x, from.centre.y, from.centre.z};
  strict_float const distance = scalar::sqrt(dot(view, view));
  if (!detail::sees_from(distance, map, slot)) { return none; }
  vec3<float> const n = map.normal(slot);
  strict_float const cosine = dot(view, {n.x, n.y, n.z}) / distance;
  if (!(cosine >= params.min_cosine)) { return none; }
  return {x,
          y,
          (seen.pixel.x - bf * (strict_float(1.0f) / Pc.z)).value,
          cosine.value,
          scalar::sqrt(dot(Pc, Pc)).value,
          detail::expected_level(distance, map.max_distance(slot), params)};
}

struct local_search_params {
  float radius_factor = 1;  ///< of the windows of the left camera
  float max_distance = 0;   ///< points farther away are skipped, metres; 0 = no limit
  int max_hamming = detail::descriptor_scale::limit(100);  ///< see search_params
  float ratio = 0.8f;                                      ///< see search_params
};

/// Search window of a visible map point.
/// @param radius_factor 1 for the right camera of a fisheye pair
/// @param right_column whether to compare columns in the right image
FT_HOST_DEVICE inline search_window window_of(visibility const& v, int slot, float radius_factor,
                                              bool right_column, pyramid_geometry const& geometry) {
  // The reference compares with the double 0.998, which is less than the nearest float.
  strict_float const base = v.cosine >= 0.998f ? 2.5f : 4.0f;
  float const radius = (base * radius_factor * geometry.scale[v.level]).value;
  search_window w{};
  w.x = v.x;
  w.y = v.y;
  w.radius = radius;
  w.right_x = v.right_x;
  w.min_level = v.level - 1;
  w.max_level = v.level;
  w.slot = slot;
  w.check_right = right_column;
  return w;
}

/// Inputs of a search in the local map, apart from the frame and the map.
template <typename Rig>
struct local_search {
  Rig rig;
  pose const* T_cw = nullptr;       ///< [batch] of the left camera, or of a multi_rig's body
  int const* slots = nullptr;       ///< [batch][windows' capacity] in search order, -1 = none
  int const* slot_count = nullptr;  ///< [batch]
  /// Points matched in the current frame are skipped.
  point_stamps stamps;
  frustum_params frustum;
  pyramid_geometry geometry;
  local_search_params params;
  visibility* seen = nullptr;  ///< output, [cameras][batch][windows' capacity]; may be null
  /// [batch][cameras] centres of the cameras in the world, metres; null: from the poses. A system
  /// that stores rotations as quaternions has centres that differ from the matrix's in the last
  /// bit.
  vec3<float> const* centres = nullptr;
  /// [batch] factor on the windows of the left camera, instead of `params.radius_factor`; may be
  /// null
  float const* radius_factor = nullptr;

  FT_HOST_DEVICE search_params matching() const {
    search_params p;
    p.kind = search_kind::local_map;
    p.max_hamming = params.max_hamming;
    p.ratio = params.ratio;
    return p;
  }
};

namespace detail {

/// The windows of a search in the local map; see list_point.
/// @tparam Stamped whether the points matched in the current frame are known, and so skipped
template <typename Rig, bool Stamped = true>
struct local_map_windows {
  using search = local_search<Rig>;
  static constexpr int searches = Rig::searches;
  static constexpr int cameras = Rig::cameras / searches;  ///< of a search
  static constexpr bool lists_by_column = true;            ///< see frame_search

  FT_HOST_DEVICE static int count(search const& in, int b) { return in.slot_count[b / searches]; }
  /// The map point of an item: its search times the windows' capacity, plus its entry.
  FT_HOST_DEVICE static int slot(search const& in, int item, search_windows_view const& to) {
    if constexpr (searches == 1) { return in.slots[item]; }
    std::ptrdiff_t const rig = item / to.capacity / searches;
    return in.slots[rig * to.capacity + item % to.capacity];
  }
  /// Place in `seen` of entry i of search b, camera c of the search.
  FT_HOST_DEVICE static std::ptrdiff_t seen_at(int c, int b, int i, search_windows_view const& to) {
    if constexpr (searches > 1) {
      c = b % searches;
      b /= searches;
    }
    std::ptrdiff_t const rigs = to.batch / searches;
    return (c * rigs + b) * to.capacity + i;
  }

  /// The windows of entry i of search b.
  /// @param writes whether this thread writes visibilities to `in.seen`
  FT_HOST_DEVICE static window_pair find(search const& in, map_points_view const& map, int b, int i,
                                         search_windows_view const& to, bool writes) {
    int const rig = b / searches;
    map_points_view const points = map.slice(rig);
    int const slot = in.slots[static_cast<std::ptrdiff_t>(rig) * to.capacity + i];
    bool const skip = slot < 0 || slot >= points.capacity ||
                      (Stamped && in.stamps.stamped(rig, points.capacity, slot));
    window_pair pair;
    FT_UNROLL
    for (int c = 0; c < cameras; ++c) {
      visibility v{0, 0, 0, 0, 0, -1};
      if (!skip) { v = see(in, rig, points, slot, searches == 1 ? c : b % searches); }
      float const most = in.params.max_distance;
      if (v.level >= 0 && !(most > 0 && v.distance > most)) {
        float const factor = c == 0 ? radius_factor(in, rig) : 1.0f;
        pair.of[c] = window_of(v, slot, factor, Rig::rectified, in.geometry);
      }
      if (writes && in.seen != nullptr) { in.seen[seen_at(c, b, i, to)] = v; }
    }
    return pair;
  }

private:
  FT_HOST_DEVICE static float radius_factor(search const& in, int b) {
    return in.radius_factor != nullptr ? in.radius_factor[b] : in.params.radius_factor;
  }
  FT_HOST_DEVICE static visibility see(search const& in, int b, map_points_view const& points,
                                       int slot, int camera) {
    Rig const& rig = in.rig;
    pose const T_cw = in.T_cw[b];
    if constexpr (Rig::rectified) {
      auto const& pair = rig.pair(camera);
      return test_visibility(pair.camera, from(in, b, camera, rig.to_camera(camera, T_cw)), points,
                             slot, pair.bf(), in.frustum);
    } else {
      if (camera == 0) {
        return test_visibility(rig.left, from(in, b, 0, T_cw), points, slot, 0.0f, in.frustum);
      }
      pose const T_rw = (rig.T_rl.template cast<strict_float>() * T_cw.cast<strict_float>())
                            .template cast<float>();
      return test_visibility(rig.right, from(in, b, 1, T_rw), points, slot, 0.0f, in.frustum);
    }
  }
  /// Camera number `camera` of batch entry b. @param T world to this camera
  FT_HOST_DEVICE static viewpoint from(search const& in, int b, int camera, pose const& T) {
    if (in.centres == nullptr) { return viewpoint::of(T); }
    return {T, in.centres[b * Rig::cameras + camera]};
  }
};

/// Item: an entry of the local map. Computes its visibility and windows.
template <typename Rig>
struct frustum_point {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int item, local_search<Rig> const& search,
                                 map_points_view const& map, search_windows_view const& out) const {
    window_pair pair;
    find_windows<local_map_windows<Rig>>(g, item, search, map, out, pair);
  }
};

}  // namespace detail

/// Visibility and search windows of the points of the local map. Asynchronous on `exec`; allocates
/// nothing; one launch.
template <typename Exec, typename Rig>
void find_visible_points(Exec const& exec, local_search<Rig> const& search,
                         map_points_view const& map, search_windows_view const& out) {
  for_each_item<per_thread>(exec, out.batch * out.capacity, detail::frustum_point<Rig>{}, search,
                            map, out);
}

}  // namespace FT_ABI
}  // namespace ft
