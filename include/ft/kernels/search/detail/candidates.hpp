// SPDX-License-Identifier: Apache-2.0
/// @file Stage: lists the candidates in the windows of a map point.
#pragma once

#include <cstddef>

#include "ft/containers/frame.hpp"
#include "ft/containers/map_points.hpp"
#include "ft/core/config.hpp"
#include "ft/kernels/search/detail/candidate_list.hpp"
#include "ft/kernels/search/workspace.hpp"

namespace ft {
inline namespace FT_ABI {

namespace detail {

/// Item: a map point. Lists the nearest keypoints in each of its windows.
struct list_candidates {
  static constexpr int quads = search_workspace::list_size / 4;
  struct scratch {
    candidate_quad list[2][quads];
    // Written by list_all() for write_free():
    int found[2];
    bool observed[2];  ///< of the map point
  };

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int item, frame_view const& frame,
                                 map_points_view const& map, search_params const& params,
                                 search_buffers const& buffers) const {
    search_windows_view const& windows = buffers.windows;
    int const b = item / windows.capacity;
    int const i = item % windows.capacity;
    if (i >= windows.count[b]) { return; }
    list(g, s, {b, frame, map, params, buffers, true}, i, windows.pair(b, i));
  }

  /// Lists the candidates of point i that no observed point holds.
  template <typename Group>
  FT_HOST_DEVICE static void list(Group g, scratch& s, frame_search const& in, int i,
                                  window_pair const& windows) {
    bool refused = false;
    each_camera(g, s, in, windows, holders(in),
                [&](int c, candidate_list<Group>& list, listing const& found) {
                  write(g, s, {in, c, i}, list, found, refused);
                });
  }

  /// Lists all candidates of a point in scratch, before the held keypoints are known.
  template <typename Group>
  FT_HOST_DEVICE static void list_all(Group g, scratch& s, frame_search const& in,
                                      window_pair const& windows) {
    each_camera(g, s, in, windows, nullptr,
                [&](int c, candidate_list<Group> const& list, listing const& found) {
                  if (g.rank() != 0) { return; }
                  s.found[c] = list.found();
                  s.observed[c] = found.observed;
                });
  }

  /// The candidates of list_all() that observed points hold: bit 16 * camera + place. The lanes of
  /// a warp look them up in parallel.
  template <typename Group>
  FT_HOST_DEVICE static unsigned held(Group g, scratch const& s, frame_search const& in) {
    constexpr int size = search_workspace::list_size;
    static_assert(size == 16 && (Group::max_threads == 1 || Group::max_threads == 32), "bits");
    frame_view const& frame = in.frame;
    int const* const holder = holders(in);
    unsigned bits = 0;
    for (int base = 0; base < size * frame.cameras; base += g.size()) {
      int const c = (base + g.rank()) / size;
      int const place = (base + g.rank()) % size;
      bool const listed = c < frame.cameras && place < s.found[c];
      int const k = listed ? entry_keypoint(s.list[c][place / 4].entry[place % 4]) : 0;
      int const slot = listed && holder != nullptr ? holder[c * frame.capacity() + k] : -1;
      bits |= g.ballot(keeps(in, in.points(), slot)) << base;
    }
    return bits;
  }

  /// Writes the lists of list_all() without the held candidates.
  /// @param taken_bits result of held()
  template <typename Group>
  FT_HOST_DEVICE static void write_free(Group g, scratch& s, frame_search const& in, int i,
                                        unsigned taken_bits) {
    bool refused = false;
    for (int c = 0; c < in.frame.cameras; ++c) {
      candidate_list<Group> list(s.list[c], s.found[c]);
      int const taken = list.take_out(g, taken_bits >> (search_workspace::list_size * c));
      write(g, s, {in, c, i}, list, {s.observed[c], taken > 0, false}, refused);
    }
  }

private:
  /// A thread's results in a window.
  struct listing {
    bool observed = false;   ///< the window's map point is observed
    bool left_out = false;   ///< this thread omitted a held candidate
    bool in_window = false;  ///< this thread saw a keypoint inside
  };
  /// Window i of camera c.
  struct window_number {
    frame_search const& in;
    int c, i;
  };

  /// Null if no keypoint counts as held.
  FT_HOST_DEVICE static int const* holders(frame_search const& in) {
    return in.params.from_empty ? nullptr : in.holder();
  }
  /// Whether the point in a slot, -1 = none, is observed and so keeps its keypoints. Exception: a
  /// keypoint that an unobserved point takes over as a stereo partner.
  FT_HOST_DEVICE static bool keeps(frame_search const& in, map_points_view const& points,
                                   int slot) {
    return slot >= 0 && (in.params.all_observed || points.observations(slot) > 0);
  }

  /// Lists the candidates of a point in each camera and calls use(camera, list, listing).
  /// @param holder of the frame; null = nothing is held
  template <typename Group, typename Use>
  FT_HOST_DEVICE static void each_camera(Group g, scratch& s, frame_search const& in,
                                         window_pair const& windows, int const* holder,
                                         Use const& use) {
    frame_view const& frame = in.frame;
    map_points_view const points = in.points();
    int const limit = listed_distance(in.params);
    float const* const right_x = in.right_x();
    bool left_empty = false;
    for (int c = 0; c < frame.cameras; ++c) {
      search_window const w = windows.camera(c);
      candidate_list<Group> list(s.list[c]);
      listing found;
      if (w.slot >= 0 && !left_empty) {
        keypoints_view const kp = frame.camera(in.b, c);
        descriptor const wanted = points.orb(w.slot);
        visit_cells(g, w, frame.grids.slice(frame.cameras * in.b + c), [&](int k) {
          int distance = -1;
          if (k >= 0) {
            int const held = holder == nullptr ? -1 : holder[c * frame.capacity() + k];
            distance = candidate_distance(w, kp, c == 0 ? right_x : nullptr, wanted, k, limit);
            if (distance >= 0 && keeps(in, points, held)) {
              distance = -1;
              found.left_out = true;
            }
            found.in_window = found.in_window || inside(w, kp, k);
          }
          list.add(g, distance, k);
        });
      }
      found.observed = w.slot >= 0 && keeps(in, points, w.slot);
      use(c, list, found);
      if (in.params.kind == search_kind::last_frame && frame.cameras == 2) {
        left_empty = g.ballot(found.in_window) == 0;
      }
    }
    g.sync();
  }

  /// Writes the list of a window.
  /// @param refused as in choose_keypoint()
  template <typename Group>
  FT_HOST_DEVICE static void write(Group g, scratch& s, window_number const& window,
                                   candidate_list<Group>& list, listing const& found,
                                   bool& refused) {
    frame_search const& in = window.in;
    search_workspace const& work = in.buffers.work;
    int const c = window.c;
    std::ptrdiff_t const at = work.window(c, in.b, window.i);
    int count = list.finish(g, in.params.max_hamming);
    int const listed = count & search_workspace::counted;
    int first = -1;
    if (in.params.kind == search_kind::local_map && listed > 0 && !refused) {
      bool const alike = list.refused(in.params, in.frame.camera(in.b, c), listed);
      first = alike ? -1 : list.nearest();
      refused = alike && c == 0;
    }
    g.sync();
    for (int q = g.rank(); 4 * q < listed; q += g.size()) {
      work.list[at * quads + q] = s.list[c][q];
    }
    if (in.frame.cameras == 2 && g.ballot(found.left_out) != 0) {
      count |= search_workspace::left_out;
    }
    if (count != 0 && found.observed) { count |= search_workspace::observed; }
    if (g.rank() == 0) {
      work.list_count[at] = count;
      work.match[at] = first;
    }
    g.sync();
  }
};

/// Item: a point of a search. Computes its windows and lists their candidates.
/// @tparam Windows last_frame_windows or local_map_windows: gives the number of points of a frame,
///   and the windows of a point
template <typename Windows>
struct list_point {
  using scratch = list_candidates::scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int item,
                                 typename Windows::search const& search, frame_view const& frame,
                                 map_points_view const& map, search_buffers const& buffers) const {
    int const b = item / buffers.windows.capacity;
    int const i = item % buffers.windows.capacity;
    window_pair windows;
    if (!find_windows<Windows>(g, item, search, map, buffers.windows, windows)) { return; }
    search_params const params = search.matching();
    frame_search const in{
        b, frame, map, params, buffers, Windows::lists_by_column, Windows::searches};
    list_candidates::list(g, s, in, i, windows);
  }
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
