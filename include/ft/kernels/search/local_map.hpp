// SPDX-License-Identifier: Apache-2.0
/// @file Stage: search in the local map. Source: specification sections 8 and 9.
#pragma once

#include <cstddef>

#include "ft/cameras/stereo_rig.hpp"
#include "ft/containers/frame.hpp"
#include "ft/containers/image_pyramid.hpp"
#include "ft/containers/map_points.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/kernels/search/assignment.hpp"
#include "ft/kernels/search/candidates.hpp"
#include "ft/kernels/search/frustum.hpp"
#include "ft/kernels/search/windows.hpp"
#include "ft/kernels/search/workspace.hpp"

namespace ft {
inline namespace FT_ABI {

namespace detail {

/// Item: an entry of the local map. Computes its visibility and windows, and lists the candidates.
template <typename Rig>
struct list_local_point {
  using scratch = list_candidates::scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int item, local_search<Rig> const& search,
                                 frame_view const& frame, map_points_view const& map,
                                 pyramid_geometry const& geometry, search_params const& params,
                                 search_windows_view const& windows,
                                 search_workspace const& work) const {
    int const b = item / windows.capacity;
    int const i = item % windows.capacity;
    bool const keep = g.rank() == 0;
    if (i == 0 && keep) { windows.count[b] = search.slot_count[b]; }
    if (i >= search.slot_count[b]) { return; }
    // All threads compute the same windows, which is faster than a broadcast.
    window_pair const pair = frustum_point<Rig>::test(b, i, search, map, geometry, keep, windows);
    list_candidates::list(g, s, b, i, pair, frame, map, params, work);
  }
};

/// The same, concurrently with the assignment of a search from the last frame. The prologue lists
/// without holders and stamps; the operator removes what that search matched.
template <typename Rig>
struct list_local_point_early {
  struct scratch : list_candidates::scratch {
    int slot;
  };

  template <typename Group>
  FT_HOST_DEVICE bool prologue(Group g, scratch& s, int item, local_search<Rig> search,
                               frame_view const& frame, map_points_view const& map,
                               pyramid_geometry const& geometry, search_params params,
                               search_windows_view const& windows,
                               search_workspace const& work) const {
    search.stamps = {};
    params.holders_later = true;
    list_local_point<Rig>{}(g, s, item, search, frame, map, geometry, params, windows, work);
    if (item % windows.capacity >= search.slot_count[item / windows.capacity]) { return false; }
    if (g.rank() == 0) { s.slot = search.slots[item]; }
    g.sync();
    return true;
  }

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int item, local_search<Rig> const& search,
                                 frame_view const& frame, map_points_view const& map,
                                 pyramid_geometry const&, search_params const& params,
                                 search_windows_view const& windows,
                                 search_workspace const& work) const {
    int const b = item / windows.capacity;
    int const i = item % windows.capacity;
    bool const known = s.slot >= 0 && s.slot < map.capacity;
    // The stamp and the holders of all candidates are loaded together.
    bool const stamped = known && search.stamps.stamped(b, map.capacity, s.slot);
    unsigned const held = list_candidates::held(g, s, b, frame, map, params);
    if (stamped) {
      constexpr int cameras = Rig::rectified ? 1 : 2;
      for (int c = g.rank(); c < cameras; c += g.size()) { hide(c, b, i, search, windows, work); }
    } else {
      list_candidates::leave_out(g, s, b, i, held, frame, params, work);
    }
  }

private:
  FT_HOST_DEVICE static void hide(int c, int b, int i, local_search<Rig> const& search,
                                  search_windows_view const& windows,
                                  search_workspace const& work) {
    windows.at(c, b, i) = search_window::none();
    work.list_count[work.window(c, b, i)] = 0;
    work.match[work.window(c, b, i)] = -1;
    if (search.seen == nullptr) { return; }
    std::ptrdiff_t const at =
        (static_cast<std::ptrdiff_t>(c) * windows.batch + b) * windows.capacity + i;
    search.seen[at] = visibility{0, 0, 0, 0, 0, -1};
  }
};

}  // namespace detail

/// The first half of search_local_map(): which points are in view, their windows and candidates.
/// Asynchronous on `exec`; allocates nothing; one launch.
template <typename Exec, typename Rig>
void list_local_map(Exec const& exec, local_search<Rig> const& search, frame_view const& frame,
                    map_points_view const& map, pyramid_geometry const& geometry,
                    search_params const& params, search_windows_view const& windows,
                    search_workspace const& work) {
  for_each_item<per_warp>(exec, windows.batch * windows.capacity, detail::list_local_point<Rig>{},
                          search, frame, map, geometry, params, windows, work);
}

template <typename Exec, typename Rig>
void list_local_map_early(Exec const& exec, local_search<Rig> const& search,
                          frame_view const& frame, map_points_view const& map,
                          pyramid_geometry const& geometry, search_params const& params,
                          search_windows_view const& windows, search_workspace const& work) {
  for_each_item<per_warp>(exec, windows.batch * windows.capacity,
                          detail::list_local_point_early<Rig>{}, search, frame, map, geometry,
                          params, windows, work);
}
template <typename Exec, typename Rig>
void search_local_map(Exec const& exec, local_search<Rig> const& search, frame_view const& frame,
                      map_points_view const& map, pyramid_geometry const& geometry,
                      search_params const& params, search_windows_view const& windows,
                      search_workspace const& work) {
  list_local_map(exec, search, frame, map, geometry, params, windows, work);
  assign_candidates(exec, frame, map, windows, params, work);
}

}  // namespace FT_ABI
}  // namespace ft
