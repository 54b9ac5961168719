// SPDX-License-Identifier: Apache-2.0
/// @file Stage: search in the local map. Source: specification sections 8 and 9.
#pragma once

#include <cstddef>

#include "ft/cameras/stereo_rig.hpp"
#include "ft/containers/frame.hpp"
#include "ft/containers/map_points.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/kernels/search/assignment.hpp"
#include "ft/kernels/search/detail/candidate_list.hpp"
#include "ft/kernels/search/detail/candidates.hpp"
#include "ft/kernels/search/frustum.hpp"
#include "ft/kernels/search/workspace.hpp"

namespace ft {
inline namespace FT_ABI {

namespace detail {

/// Item: an entry of the local map. The prologue lists candidates without holders and stamps,
/// concurrently with the search that writes them. The operator removes what that search matched.
template <typename Rig>
struct list_local_point_early {
  struct scratch : list_candidates::scratch {
    int slot;
  };

  template <typename Group>
  FT_HOST_DEVICE bool prologue(Group g, scratch& s, int item, local_search<Rig> const& search,
                               frame_view const& frame, map_points_view const& map,
                               search_buffers const& buffers) const {
    using windows_of = local_map_windows<Rig, false>;
    window_pair windows;
    if (!find_windows<windows_of>(g, item, search, map, buffers.windows, windows)) { return false; }
    search_params const params = search.matching();
    frame_search const in{
        item / buffers.windows.capacity, frame, map, params, buffers, true, Rig::searches};
    list_candidates::list_all(g, s, in, windows);
    if (g.rank() == 0) { s.slot = windows_of::slot(search, item, buffers.windows); }
    g.sync();
    return true;
  }

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int item, local_search<Rig> const& search,
                                 frame_view const& frame, map_points_view const& map,
                                 search_buffers const& buffers) const {
    int const b = item / buffers.windows.capacity;
    int const i = item % buffers.windows.capacity;
    search_params const params = search.matching();
    frame_search const in{b, frame, map, params, buffers, true, Rig::searches};
    bool const known = s.slot >= 0 && s.slot < map.capacity;
    // The stamp and the holders of all candidates are loaded together.
    bool const stamped = known && search.stamps.stamped(b / Rig::searches, map.capacity, s.slot);
    unsigned const held = list_candidates::held(g, s, in);
    if (stamped) {
      constexpr int cameras = local_map_windows<Rig>::cameras;
      for (int c = g.rank(); c < cameras; c += g.size()) { hide(c, b, i, search, buffers); }
    } else {
      list_candidates::write_free(g, s, in, i, held);
    }
  }

private:
  /// Makes an already matched point invisible to a camera.
  FT_HOST_DEVICE static void hide(int c, int b, int i, local_search<Rig> const& search,
                                  search_buffers const& buffers) {
    search_windows_view const& windows = buffers.windows;
    search_workspace const& work = buffers.work;
    windows.at(c, b, i) = search_window::none();
    work.list_count[work.window(c, b, i)] = 0;
    work.match[work.window(c, b, i)] = -1;
    if (search.seen == nullptr) { return; }
    search.seen[local_map_windows<Rig>::seen_at(c, b, i, windows)] = visibility{0, 0, 0, 0, 0, -1};
  }
};

}  // namespace detail

/// First step of search_local_map(): visible points, their windows and candidates. Asynchronous on
/// `exec`; allocates nothing; one launch.
template <typename Exec, typename Rig>
void list_local_map(Exec const& exec, local_search<Rig> const& search, frame_view const& frame,
                    map_points_view const& map, search_buffers const& buffers) {
  for_each_item<per_warp>(exec, buffers.windows.batch * buffers.windows.capacity,
                          detail::list_point<detail::local_map_windows<Rig>>{}, search, frame, map,
                          buffers);
}

/// The same step after assign_last_frame(), with a prologue that runs concurrently with it. That
/// search must have buffers of its own. Asynchronous on `exec`; allocates nothing; one launch.
template <typename Exec, typename Rig>
void list_local_map_early(Exec const& exec, local_search<Rig> const& search,
                          frame_view const& frame, map_points_view const& map,
                          search_buffers const& buffers) {
  for_each_item<per_warp>(exec, buffers.windows.batch * buffers.windows.capacity,
                          detail::list_local_point_early<Rig>{}, search, frame, map, buffers);
}

/// Search in the local map: list_local_map(), then assign_candidates(). The result equals that of
/// find_visible_points() and search_by_projection(). Asynchronous on `exec`; allocates nothing; two
/// launches, of which only the first is concurrent with its predecessor if `exec` says so.
template <typename Exec, typename Rig>
void search_local_map(Exec const& exec, local_search<Rig> const& search, frame_view const& frame,
                      map_points_view const& map, search_buffers const& buffers) {
  list_local_map(exec, search, frame, map, buffers);
  assign_candidates<Rig::searches>(detail::with_order(exec, detail::launch_order::serial), frame,
                                   map, search.matching(), buffers);
}

}  // namespace FT_ABI
}  // namespace ft
