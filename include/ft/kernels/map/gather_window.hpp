// SPDX-License-Identifier: Apache-2.0
/// @file Stage: collects the newest keyframes and their points for an adjustment.
#pragma once

#include <cstddef>

#include "ft/containers/image_pyramid.hpp"
#include "ft/containers/odometry_map.hpp"
#include "ft/containers/point_patches.hpp"
#include "ft/containers/window_problem.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/group.hpp"
#include "ft/core/memory.hpp"
#include "ft/kernels/map/detail/slot_rows.hpp"
#include "ft/kernels/map/point_masks.hpp"
#include "ft/types/odometry_params.hpp"
#include "ft/types/poses.hpp"
#include "ft/types/tracking.hpp"

namespace ft {
inline namespace FT_ABI {

/// Inputs of gather_window, apart from the map.
struct window_input {
  int const* flags = nullptr;  ///< [batch] 1 = gather
  pyramid_geometry geometry;
  window_selection params;
};

/// Where the contents of a window_problem_view come from.
struct window_sources_view {
  int* keyframe = nullptr;       ///< [batch][views] number of a view's keyframe
  int* slot = nullptr;           ///< [batch][points]
  int* number = nullptr;         ///< [batch][points] of the point
  int* keypoint = nullptr;       ///< [batch][points][views][cameras] number of an observation's
                                 ///< keypoint; undefined where the point is not seen
  int* left_out = nullptr;       ///< [batch] points for which there was no room
  int* point_of_slot = nullptr;  ///< [batch][slots] -1 = not in the window
  unsigned* chosen = nullptr;    ///< [batch][ceil(slots / 32)] workspace of gather_window
  rigid<double>* correction = nullptr;  ///< [batch] of apply_window: old to new camera
                                        ///< frame of the window's newest keyframe, inverse
};

/// Places the arrays into an arena.
inline void carve(carver& c, window_sources_view& v, window_capacity const& size, int slots,
                  int batch) {
  c.place({batch, size.views}, v.keyframe);
  c.place({batch, size.points}, v.slot, v.number);
  c.place({batch, size.points, size.views, size.cameras}, v.keypoint);
  c.place({batch}, v.left_out);
  c.place({batch, slots}, v.point_of_slot);
  c.place({batch, ceil_div(slots, 32)}, v.chosen);
  c.place({batch}, v.correction);
}

namespace detail {

/// Item: a batch entry. Chooses keyframes and points.
struct choose_window {
  struct scratch {
    position_set moving;
  };

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int b, window_input const& in,
                                 odometry_map_view const& map, window_problem_view const& problem,
                                 window_sources_view const& sources) const {
    if (in.flags[b] == 0) { return; }
    keyframes_view const& keyframes = map.keyframes;
    int const made = keyframes.made[b];
    int const views = min_of(keyframes.count[b], in.params.moving + in.params.fixed);
    int const fixed = min_of(views, max_of(1, views - in.params.moving));
    for (int v = g.rank(); v < views; v += g.size()) {
      int const number = made - views + 1 + v;
      sources.keyframe[problem.view(b, v)] = number;
      problem.T_cw[problem.view(b, v)] =
          keyframes.T_cw[keyframes.at(b, keyframes.position(number))];
    }
    if (g.rank() == 0) {
      s.moving.assign(keyframes, made - views + fixed + 1, made);
      problem.view_count[b] = views;
      problem.fixed_count[b] = fixed;
    }
    g.sync();
    choose_points(g, s.moving, b, map, problem, sources);
  }

private:
  template <typename Group>
  FT_HOST_DEVICE static void choose_points(Group g, position_set const& moving, int b,
                                           odometry_map_view const& map,
                                           window_problem_view const& problem,
                                           window_sources_view const& sources) {
    point_records_view const& r = map.records;
    int const used = r.used[b];
    int* const point_of_slot = sources.point_of_slot + r.at(b, 0);
    unsigned* const chosen =
        sources.chosen + static_cast<std::ptrdiff_t>(b) * ceil_div(r.slots, 32);
    for (int slot = used + g.rank(); slot < r.slots; slot += g.size()) { point_of_slot[slot] = -1; }
    slot_rows<Group> const rows(g, chosen, used);
    rows.flag([&](int slot) { return position_set::of(r.mask(b, slot), r.words); },
              [&](int slot, position_set const& seen) {
                point_of_slot[slot] = -1;
                return moving.meets(seen);
              });
    int const found = rows.list([&](int slot, int i) {
      if (i >= problem.points) { return; }
      point_of_slot[slot] = i;
      sources.slot[problem.point(b, i)] = slot;
    });
    if (g.rank() == 0) {
      problem.point_count[b] = min_of(found, problem.points);
      sources.left_out[b] = max_of(found - problem.points, 0);
    }
  }
};

/// Item: a camera of a view of a batch entry. Writes its observations, and its share of the points.
/// After choose_window.
struct gather_view {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int item, window_input const& in,
                                 odometry_map_view const& map, window_problem_view const& problem,
                                 window_sources_view const& sources) const {
    int const shares = problem.views * problem.cameras;
    int const c = item % problem.cameras;
    int const v = item / problem.cameras % problem.views;
    int const b = item / shares;
    if (in.flags[b] == 0) { return; }
    int const points = problem.point_count[b];
    for (int p = item % shares * g.size() + g.rank(); p < points; p += shares * g.size()) {
      int const slot = sources.slot[problem.point(b, p)];
      vec3<float> const at = get<field::position>(map.points.slice(b), slot);
      problem.position[problem.point(b, p)] = {static_cast<double>(at.x), static_cast<double>(at.y),
                                               static_cast<double>(at.z)};
      sources.number[problem.point(b, p)] = map.records.number[map.records.at(b, slot)];
    }
    if (v >= problem.view_count[b]) { return; }
    for (int p = g.rank(); p < points; p += g.size()) {
      problem.seen[problem.sighting(b, p, v, c)] = {0, 0, -1, 0};
    }
    g.sync();
    keyframes_view const& keyframes = map.keyframes;
    int const position = keyframes.position(sources.keyframe[problem.view(b, v)]);
    int const n = keyframes.keypoints[keyframes.at(b, position) * keyframes.cameras + c];
    for (int i = g.rank(); i < n; i += g.size()) {
      int const keypoint = c * keyframes.capacity + i;
      std::ptrdiff_t const at = keyframes.at(b, position, keypoint);
      int const slot = keyframes.holder[at];
      if (slot < 0) { continue; }
      std::ptrdiff_t const record = map.records.at(b, slot);
      if (map.records.number[record] != keyframes.holder_number[at]) { continue; }
      int const p = sources.point_of_slot[record];
      if (p < 0) { continue; }
      float const corner = in.geometry.inv_sigma2[keyframes.octave[at]];
      float const weight =
          keyframes.aligned[at] != 0 ? mul(weight_of_aligned * aligned_at_last, corner) : corner;
      std::ptrdiff_t const to = problem.sighting(b, p, v, c);
      problem.seen[to] = {keyframes.x[at], keyframes.y[at], keyframes.right_x[at], weight};
      sources.keypoint[to] = keypoint;
    }
  }
};

}  // namespace detail

/// Fills the problems of the batch entries whose flag is set; those of others are not touched.
///
/// The views are the newest `moving` keyframes and the `fixed` ones before them, oldest first. The
/// latter stay; where there are none the oldest moving keyframe stays, which is the first one of
/// its map or of the ring. The points are those that a keyframe sees that does not stay, in
/// ascending order of slots. Those for which there is no room are left out, the highest slots.
///
/// Asynchronous on `exec`; allocates nothing; two launches.
/// @throws bad_argument for parameters out of range, or for a problem of another shape
template <typename Exec>
void gather_window(Exec const& exec, window_input const& in, odometry_map_view const& map,
                   window_problem_view const& problem, window_sources_view const& sources) {
  detail::require_range("moving keyframes", in.params.moving, 1, problem.views);
  detail::require_range("fixed keyframes", in.params.fixed, 0, problem.views - in.params.moving);
  detail::require(problem.cameras == map.keyframes.cameras && problem.batch == map.keyframes.batch,
                  "the windows have another shape than the map's keyframes");
  for_each_item<per_block<1024>>(exec, problem.batch, detail::choose_window{}, in, map, problem,
                                 sources);
  for_each_item<per_block<512>>(exec, problem.batch * problem.views * problem.cameras,
                                detail::gather_view{}, in, map, problem, sources);
}

}  // namespace FT_ABI
}  // namespace ft
