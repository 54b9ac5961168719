// SPDX-License-Identifier: Apache-2.0
/// @file The contract of the greedy assignment: what each of its forms reads and writes.
///
/// Map points are processed in order. Each takes the best keypoint of its window that no earlier
/// point has taken. Three forms compute exactly that result:
/// - assignment.hpp: the loop itself, by one thread;
/// - there, too: stable matching, for searches without a ratio test;
/// - turns.hpp: all points choose again until nothing changes, for any search, with a compact form
///   for one camera in turns.hpp, too.
///
/// All read the lists that list_candidates wrote. They write the match of every window that has
/// candidates, the holders of the frame and the number of matched keypoints.
#pragma once

#include <cstddef>
#include <cstdint>

#include "ft/containers/frame.hpp"
#include "ft/containers/map_points.hpp"
#include "ft/core/config.hpp"
#include "ft/core/group.hpp"
#include "ft/kernels/search/detail/candidate_list.hpp"
#include "ft/kernels/search/workspace.hpp"

namespace ft {
inline namespace FT_ABI {

namespace detail {

/// State of the assignment of one frame in block scratch.
struct assign_scratch {
  /// Keypoints, and points with candidates, whose state fits. Larger searches use the workspace.
  static constexpr int size = 3072;
  int open[size];           ///< open points, as in open_points or packed_point
  int writer[size];         ///< owner_table()
  int before[size];         ///< second_table(), or links of write_chains
  std::uint8_t held[size];  ///< as in write_chains
  int first_changed[3];  ///< first point that changed in this turn, the previous and the next one
  int open_count;        ///< points in `open`, for the form that lists them in any order
  int list_exhausted;    ///< 1 = a window may need a candidate that is not listed
  int any_unobserved;    ///< 1 = a window with candidates has a point that is not observed
};

/// An unset table entry. It loses every minimum.
inline constexpr int unset = 0x7fffffff;

/// One frame of a search, as the assignment uses it.
/// @tparam Single one camera and no stereo partners, which is known at compile time
template <bool Single>
struct assignment_context {
  int b;  ///< batch entry
  frame_view const& frame;
  map_points_view points;
  search_windows_view const& windows;
  search_params const& params;
  search_workspace const& work;
  int* holder;           ///< of this frame
  int const* partner;    ///< of this frame; null if partners are not matched
  float const* right_x;  ///< of this frame; null if they are not compared

  FT_HOST_DEVICE explicit assignment_context(frame_search const& search)
      : b(search.b),
        frame(search.frame),
        points(search.points()),
        windows(search.buffers.windows),
        params(search.params),
        work(search.buffers.work),
        holder(search.holder()),
        partner(!Single && search.partners()
                    ? search.frame.partner +
                          static_cast<std::ptrdiff_t>(search.b) * search.frame.numbers()
                    : nullptr),
        right_x(search.right_x()) {}

  FT_HOST_DEVICE int cameras() const { return Single ? 1 : frame.cameras; }
  FT_HOST_DEVICE int numbers() const { return cameras() * frame.capacity(); }
  FT_HOST_DEVICE bool partners() const { return !Single && partner != nullptr; }
  FT_HOST_DEVICE int camera_of(int number) const {
    return Single || number < frame.capacity() ? 0 : 1;
  }
  FT_HOST_DEVICE int number(int camera, int k) const {
    return Single ? k : camera * frame.capacity() + k;
  }
  FT_HOST_DEVICE int slot(int camera, int i) const { return windows.at(camera, b, i).slot; }
  FT_HOST_DEVICE bool observed(int slot) const {
    return slot >= 0 && (params.all_observed || points.observations(slot) > 0);
  }
  /// Whether an observed point has held a keypoint since before the search. Such keypoints are not
  /// listed.
  FT_HOST_DEVICE bool held(int number) const {
    return !params.from_empty && observed(holder[number]);
  }
  /// Number and bits, as in search_workspace.
  FT_HOST_DEVICE int list_count(int camera, int i) const {
    return work.list_count[work.window(camera, b, i)];
  }
  FT_HOST_DEVICE candidate_quad const* list(int camera, int i) const {
    return work.list + work.window(camera, b, i) * (search_workspace::list_size / 4);
  }
  FT_HOST_DEVICE int& match(int camera, int i) const {
    return work.match[work.window(camera, b, i)];
  }
  /// Whether the column in the right image excludes keypoint k from window i.
  FT_HOST_DEVICE bool misses_right(int camera, int i, int k) const {
    return right_x != nullptr && camera == 0 &&
           detail::misses_right(windows.at(0, b, i), right_x[k]);
  }
  /// Number of a keypoint's stereo partner, -1 = none.
  FT_HOST_DEVICE int partner_of(int number) const { return partners() ? partner[number] : -1; }
};

/// Whether a window has candidates.
/// @param count as in search_workspace::list_count
/// @param held whether candidates omitted because they are held count, too
FT_HOST_DEVICE inline bool has_candidates(int count, bool held) {
  constexpr int some = search_workspace::counted | search_workspace::unlisted;
  return (count & (some | (held ? search_workspace::left_out : 0))) != 0;
}

/// Whether a table of keypoints fits in block scratch.
FT_HOST_DEVICE inline bool in_scratch(frame_view const& frame) {
  return frame.numbers() <= assign_scratch::size;
}
/// Table of owners, per keypoint: list_size times the window that owns it, plus its place in the
/// window's list.
template <bool Single>
FT_HOST_DEVICE int* owner_table(assign_scratch& s, assignment_context<Single> const& ctx) {
  return in_scratch(ctx.frame)
             ? s.writer
             : ctx.work.writer + static_cast<std::ptrdiff_t>(ctx.b) * ctx.numbers();
}
/// Another table of keypoints.
template <bool Single>
FT_HOST_DEVICE int* second_table(assign_scratch& s, assignment_context<Single> const& ctx) {
  return in_scratch(ctx.frame)
             ? s.before
             : ctx.work.before + static_cast<std::ptrdiff_t>(ctx.b) * ctx.work.links;
}
/// Clears both tables and the counters.
template <typename Group>
FT_HOST_DEVICE void clear_tables(Group g, assign_scratch& s, int* writer, int* before,
                                 int numbers) {
  for (int k = g.rank(); k < numbers; k += g.size()) { writer[k] = before[k] = unset; }
  if (g.rank() == 0) {
    s.open_count = 0;
    s.list_exhausted = 0;
    s.any_unobserved = 0;
    s.first_changed[0] = unset;
  }
}

// The choice of one window: the best keypoint that is not taken.

/// Candidates of a window: their number and the nearest four, loaded together.
struct window_list {
  int n = 0;
  bool complete = true;   ///< no omitted candidate can be chosen
  bool unlisted = false;  ///< more candidates exist than the list holds
  candidate_quad nearest{};

  /// @param any whether the window has candidates
  /// @param held_may_be_free whether a keypoint held before the search may have become free
  template <bool Single>
  FT_HOST_DEVICE window_list(assignment_context<Single> const& ctx, int c, int i, bool any,
                             bool held_may_be_free) {
    if (!any) { return; }
    int const count = ctx.list_count(c, i);
    n = count & search_workspace::counted;
    unlisted = (count & search_workspace::unlisted) != 0;
    complete = !held_may_be_free || (count & search_workspace::left_out) == 0;
    if (!held_may_be_free || n > 0) { nearest = *ctx.list(c, i); }
  }
};

/// The two nearest keypoints of a window that are not taken.
struct nearest_two {
  int best = descriptor_scale::most;
  int second = descriptor_scale::most;
  int best_k = -1;
  int second_k = -1;

  FT_HOST_DEVICE void add(int k, int distance) {
    if (distance < best) {
      second = best;
      second_k = best_k;
      best = distance;
      best_k = k;
    } else if (distance < second) {
      second = distance;
      second_k = k;
    }
  }
};

/// Chooses from the listed candidates. @return false if the list is exhausted and incomplete
template <bool Single, typename Taken>
FT_HOST_DEVICE bool choose_from_list(assignment_context<Single> const& ctx, int c, int i,
                                     window_list const& list, Taken const& taken,
                                     nearest_two& found) {
  bool const with_ratio = ctx.params.kind == search_kind::local_map;
  int const n = list.n;
  if (!list.complete) { return false; }
  candidate_quad quad = list.nearest;
  FT_NO_UNROLL
  for (int q = 0; 4 * q < n; ++q) {
    if (q > 0) { quad = ctx.list(c, i)[q]; }
    FT_UNROLL
    for (int e = 0; e < 4; ++e) {
      int const distance = entry_distance(quad.entry[e]);
      int const k = entry_keypoint(quad.entry[e]);
      if (4 * q + e >= n) { return !list.unlisted; }
      if (found.best_k < 0 && distance > ctx.params.max_hamming) { return true; }
      if (taken(ctx.number(c, k), true) || ctx.misses_right(c, i, k)) { continue; }
      found.add(k, distance);
      if (!with_ratio || found.second_k >= 0) { return true; }
    }
  }
  return !list.unlisted;
}

/// Chooses from all keypoints of the window.
template <bool Single, typename Taken>
FT_HOST_DEVICE void choose_from_grid(assignment_context<Single> const& ctx, int c, int i,
                                     Taken const& taken, nearest_two& found) {
  search_window const w = ctx.windows.at(c, ctx.b, i);
  keypoints_view const kp = ctx.frame.camera(ctx.b, c);
  descriptor const wanted = ctx.points.orb(w.slot);
  int const limit = listed_distance(ctx.params);
  float const* const right_x =
      ctx.frame.right_x == nullptr || c != 0
          ? nullptr
          : ctx.frame.right_x + static_cast<std::ptrdiff_t>(ctx.b) * ctx.frame.capacity();
  visit_cells(single_group{}, w, ctx.frame.grids.slice(ctx.cameras() * ctx.b + c), [&](int k) {
    int const distance = candidate_distance(w, kp, right_x, wanted, k, limit);
    if (distance >= 0 && distance < found.second && !taken(ctx.number(c, k), false)) {
      found.add(k, distance);
    }
  });
}

/// The keypoint that window i of camera c takes, -1 = none.
/// @param refused set if the left window fails the ratio test; the point then takes no keypoint
/// @param taken taken(number, listed): whether an earlier point has the keypoint
template <bool Single, typename Taken>
FT_HOST_DEVICE int choose_keypoint(assignment_context<Single> const& ctx, int c, int i,
                                   window_list const& list, bool& refused, Taken const& taken) {
  if (refused) { return -1; }
  nearest_two found;
  if (!choose_from_list(ctx, c, i, list, taken, found)) {
    found = {};
    choose_from_grid(ctx, c, i, taken, found);
  }
  if (found.best_k < 0 || found.best > ctx.params.max_hamming) { return -1; }
  if (refuses(ctx.params, ctx.frame.camera(ctx.b, c), found.best, found.best_k, found.second,
              found.second_k)) {
    refused = c == 0;
    return -1;
  }
  return found.best_k;
}

}  // namespace detail

}  // namespace FT_ABI
}  // namespace ft
