// SPDX-License-Identifier: Apache-2.0
/// @file The choice of one window: the best keypoint that is not taken.
#pragma once

#include <cstddef>

#include "ft/containers/frame.hpp"
#include "ft/containers/map_points.hpp"
#include "ft/core/config.hpp"
#include "ft/core/group.hpp"
#include "ft/kernels/search/detail/assignment_context.hpp"
#include "ft/kernels/search/detail/candidate_list.hpp"
#include "ft/kernels/search/windows.hpp"

namespace ft {
inline namespace FT_ABI {

namespace detail {

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
  int best = 256;
  int second = 256;
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
