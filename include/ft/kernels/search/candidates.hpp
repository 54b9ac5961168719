// SPDX-License-Identifier: Apache-2.0
/// @file Stage: lists the candidates in the windows of a map point.
#pragma once

#include <cstddef>

#include "ft/containers/frame.hpp"
#include "ft/containers/map_points.hpp"
#include "ft/core/config.hpp"
#include "ft/kernels/search/candidate_list.hpp"
#include "ft/kernels/search/windows.hpp"
#include "ft/kernels/search/workspace.hpp"

namespace ft {
inline namespace FT_ABI {

namespace detail {

/// Item: a window. Lists the nearest keypoints in the windows of a map point.
struct list_candidates {
  static constexpr int quads = search_workspace::list_size / 4;
  struct scratch {
    candidate_quad list[2][quads];
    // Kept for leave_out():
    int found[2];
    bool observed[2];  ///< of the map point
  };

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int item, frame_view const& frame,
                                 map_points_view const& map, search_windows_view const& windows,
                                 search_params const& params, search_workspace const& work) const {
    int const b = item / windows.capacity;
    int const i = item % windows.capacity;
    if (i >= windows.count[b]) { return; }
    window_pair pair;
    pair.of[0] = windows.at(0, b, i);
    if (frame.cameras == 2) { pair.of[1] = windows.at(1, b, i); }
    list(g, s, b, i, pair, frame, map, params, work);
  }

  /// Lists the candidates of point i of batch entry b.
  template <typename Group>
  FT_HOST_DEVICE static void list(Group g, scratch& s, int b, int i, window_pair const& windows,
                                  frame_view const& frame, map_points_view const& map,
                                  search_params const& params, search_workspace const& work) {
    map_points_view const points = map.slice(b);
    int const limit = listed_distance(params);
    int const* const holder = holders(b, frame, params);
    float const* const right_x =
        frame.right_x == nullptr || params.right_later
            ? nullptr
            : frame.right_x + static_cast<std::ptrdiff_t>(b) * frame.capacity();
    bool left_empty = false;
    bool refused = false;
    for (int c = 0; c < frame.cameras; ++c) {
      bool left_out = false;
      search_window const w = windows.camera(c);
      candidate_list<Group> list(s.list[c]);
      bool in_window = false;
      if (w.slot >= 0 && !left_empty) {
        keypoints_view const kp = frame.camera(b, c);
        descriptor const wanted = get<field::orb>(points, w.slot);
        visit_cells(g, w, frame.grids.slice(frame.cameras * b + c), [&](int k) {
          int distance = -1;
          if (k >= 0) {
            int const held = holder == nullptr ? -1 : holder[c * frame.capacity() + k];
            distance = candidate_distance(w, kp, c == 0 ? right_x : nullptr, wanted, k, limit);
            if (distance >= 0 && keeps(points, held)) {
              distance = -1;
              left_out = true;
            }
            in_window = in_window || inside(w, kp, k);
          }
          list.add(g, distance, k);
        });
      }
      bool const observed = w.slot >= 0 && keeps(points, w.slot);
      if (!params.holders_later) {
        write(g, s, b, i, c, observed, list, left_out, refused, frame, params, work);
      } else if (g.rank() == 0) {
        s.found[c] = list.found();
        s.observed[c] = observed;
      }
      if (params.kind == search_kind::last_frame && frame.cameras == 2) {
        left_empty = g.ballot(in_window) == 0;
      }
    }
    g.sync();
  }

  /// Which listed candidates are held by observed points: bit 16 * camera + place. The warp looks
  /// all of them up at once.
  template <typename Group>
  FT_HOST_DEVICE static unsigned held(Group g, scratch const& s, int b, frame_view const& frame,
                                      map_points_view const& map, search_params params) {
    constexpr int size = search_workspace::list_size;
    static_assert(size == 16 && (Group::max_threads == 1 || Group::max_threads == 32), "bits");
    params.holders_later = false;
    int const* const holder = holders(b, frame, params);
    unsigned bits = 0;
    for (int base = 0; base < size * frame.cameras; base += g.size()) {
      int const c = (base + g.rank()) / size;
      int const place = (base + g.rank()) % size;
      bool const listed = c < frame.cameras && place < s.found[c];
      int const k = listed ? entry_keypoint(s.list[c][place / 4].entry[place % 4]) : 0;
      int const slot = listed && holder != nullptr ? holder[c * frame.capacity() + k] : -1;
      bits |= g.ballot(keeps(map.slice(b), slot)) << base;
    }
    return bits;
  }

  /// Completes list() once the holders are valid: removes held candidates and writes the lists.
  /// @param taken_bits result of held()
  template <typename Group>
  FT_HOST_DEVICE static void leave_out(Group g, scratch& s, int b, int i, unsigned taken_bits,
                                       frame_view const& frame, search_params const& params,
                                       search_workspace const& work) {
    bool refused = false;
    for (int c = 0; c < frame.cameras; ++c) {
      candidate_list<Group> list(s.list[c], s.found[c]);
      int const taken = list.take_out(g, taken_bits >> (search_workspace::list_size * c));
      write(g, s, b, i, c, s.observed[c], list, taken > 0, refused, frame, params, work);
    }
  }

private:
  /// Null if no keypoint counts as held.
  FT_HOST_DEVICE static int const* holders(int b, frame_view const& frame,
                                           search_params const& params) {
    bool const none = params.from_empty || params.holders_later;
    return none ? nullptr : frame.holder + static_cast<std::ptrdiff_t>(b) * frame.numbers();
  }
  /// Whether the point in a slot, -1 = none, is observed and so keeps its keypoints. The exception
  /// is a keypoint that an unobserved point takes over as a stereo partner.
  FT_HOST_DEVICE static bool keeps(map_points_view const& points, int slot) {
    return slot >= 0 && get<field::observations>(points, slot) > 0;
  }

  /// Writes the list of window i of camera c.
  /// @param observed whether the map point is
  /// @param left_out whether this thread omitted a held candidate
  /// @param refused as in choose_keypoint()
  template <typename Group>
  FT_HOST_DEVICE static void write(Group g, scratch& s, int b, int i, int c, bool observed,
                                   candidate_list<Group>& list, bool left_out, bool& refused,
                                   frame_view const& frame, search_params const& params,
                                   search_workspace const& work) {
    std::ptrdiff_t const at = work.window(c, b, i);
    int found = list.finish(g, params.max_distance);
    int const listed = found & search_workspace::counted;
    int first = -1;
    if (params.kind == search_kind::local_map && listed > 0 && !refused) {
      bool const alike = list.refused(params, frame.camera(b, c), listed);
      first = alike ? -1 : list.nearest();
      refused = alike && c == 0;
    }
    g.sync();
    for (int q = g.rank(); 4 * q < listed; q += g.size()) {
      work.list[at * quads + q] = s.list[c][q];
    }
    if (frame.cameras == 2 && g.ballot(left_out) != 0) { found |= search_workspace::left_out; }
    if (found != 0 && observed) { found |= search_workspace::observed; }
    if (g.rank() == 0) {
      work.list_count[at] = found;
      work.match[at] = first;
    }
    g.sync();
  }
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
