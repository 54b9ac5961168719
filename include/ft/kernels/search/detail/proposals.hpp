// SPDX-License-Identifier: Apache-2.0
/// @file The greedy assignment by proposals, for searches without a ratio test.
///
/// Every window prefers the nearest keypoint, and every keypoint prefers the lowest window. This is
/// a stable matching with one solution, so windows may propose in any order and concurrently (Gale
/// and Shapley, "College admissions and the stability of marriage", 1962).
#pragma once

#include <cmath>
#include <cstdint>

#include "ft/core/config.hpp"
#include "ft/core/group.hpp"
#include "ft/kernels/search/detail/assignment_context.hpp"
#include "ft/kernels/search/detail/candidate_list.hpp"
#include "ft/kernels/search/detail/choose.hpp"

namespace ft {
inline namespace FT_ABI {

namespace detail {

/// The data with which a window proposes to one candidate, loaded together.
struct proposal {
  int count;            ///< as in search_workspace
  std::uint32_t entry;  ///< packed candidate
  bool check_right;     ///< as in search_window
  float right_x, radius;

  template <bool Single>
  FT_HOST_DEVICE static proposal from(assignment_context<Single> const& ctx, int c, int i,
                                      int place) {
    proposal p{};
    p.count = ctx.list_count(c, i);
    p.entry = ctx.list(c, i)[place / 4].entry[place % 4];
    if (ctx.right_x != nullptr && c == 0) {
      search_window const& w = ctx.windows.at(0, ctx.b, i);
      p.check_right = w.check_right;
      p.right_x = w.right_x;
      p.radius = w.radius;
    }
    return p;
  }
  template <bool Single>
  FT_HOST_DEVICE bool misses_right(assignment_context<Single> const& ctx, int k) const {
    if (!check_right) { return false; }
    float const r = ctx.right_x[k];
    return r > 0 && ::fabsf(right_x - r) > radius;
  }
};

/// Proposes for window i until it has a keypoint. When it displaces a window, the thread continues
/// with that one.
template <bool Single>
FT_HOST_DEVICE void propose(assign_scratch& s, assignment_context<Single> const& ctx, int c, int i,
                            proposal now, int* owner) {
  int place = 0;
  for (;;) {
    if (place >= (now.count & search_workspace::counted)) {
      if ((now.count & search_workspace::unlisted) != 0) { s.list_exhausted = 1; }
      return;
    }
    if (entry_distance(now.entry) > ctx.params.max_hamming) { return; }
    int const k = entry_keypoint(now.entry);
    int const mine = i * search_workspace::list_size + place;
    int before = -1;
    if (!now.misses_right(ctx, k)) { before = atomic_min(owner + ctx.number(c, k), mine); }
    if (before == unset) { return; }
    if (before > mine) {
      i = before / search_workspace::list_size;
      place = before % search_workspace::list_size;
    }
    ++place;
    now = proposal::from(ctx, c, i, min_of(place, search_workspace::list_size - 1));
  }
}

/// Calls use(i, load(i)) for all i < n. Each thread has `Ahead` loads in flight.
template <int Ahead, typename Group, typename Load, typename Use>
FT_HOST_DEVICE void load_ahead(Group g, int n, Load const& load, Use const& use) {
  for (int first = g.rank(); first < n; first += Ahead * g.size()) {
    decltype(load(0)) loaded[Ahead];
    FT_UNROLL
    for (int t = 0; t < Ahead; ++t) { loaded[t] = load(min_of(first + t * g.size(), n - 1)); }
    FT_UNROLL
    for (int t = 0; t < Ahead; ++t) {
      int const i = first + t * g.size();
      if (i < n) { use(i, loaded[t]); }
    }
  }
}

/// Lets all windows of observed points propose.
template <typename Group, bool Single>
FT_HOST_DEVICE void propose_all(Group g, assign_scratch& s, assignment_context<Single> const& ctx,
                                int* owner) {
  int const n = ctx.windows.count[ctx.b];
  auto const camera = [n](int w) { return Single || w < n ? 0 : 1; };
  load_ahead<2>(
      g, ctx.cameras() * n,
      [&](int w) { return proposal::from(ctx, camera(w), w - camera(w) * n, 0); },
      [&](int w, proposal const& first) {
        if ((first.count & search_workspace::observed) != 0) {
          propose(s, ctx, camera(w), w - camera(w) * n, first, owner);
        } else if (has_candidates(first.count, false)) {
          s.any_unobserved = 1;
        }
      });
}

/// Fills the owner table. @return false if a list was exhausted; the table is then invalid
template <typename Group, bool Single>
FT_HOST_DEVICE bool propose_all(Group g, assign_scratch& s, assignment_context<Single> const& ctx) {
  // Two calls, so that the compiler knows that the table of one of them is in shared memory.
  if (in_scratch(ctx.frame)) {
    propose_all(g, s, ctx, s.writer);
  } else {
    propose_all(g, s, ctx, owner_table(s, ctx));
  }
  g.sync();
  if (s.list_exhausted == 0) { return true; }
  g.sync();
  return false;
}

/// Writes the result of the proposals. Windows of unobserved points choose here, since they keep no
/// keypoint from others.
template <typename Group, bool Single>
FT_HOST_DEVICE void write_proposed(Group g, assign_scratch& s,
                                   assignment_context<Single> const& ctx) {
  int const numbers = ctx.numbers();
  int const n = ctx.windows.count[ctx.b];
  int const* const owner = owner_table(s, ctx);
  // The last unobserved window that took a keypoint.
  int* const last_unobserved = second_table(s, ctx);
  int taken = 0;
  bool const unobserved = s.any_unobserved != 0;
  if (unobserved) {
    for (int k = g.rank(); k < numbers; k += g.size()) { last_unobserved[k] = -1; }
    g.sync();
    for (int c = 0; c < ctx.cameras(); ++c) {
      for (int i = g.rank(); i < n; i += g.size()) {
        // Without partners no held keypoint becomes free, so omitted candidates do not matter.
        int const count = ctx.list_count(c, i);
        if (!has_candidates(count, false) || (count & search_workspace::observed) != 0) {
          continue;
        }
        bool refused = false;
        int const k = choose_keypoint(ctx, c, i, window_list(ctx, c, i, true, false), refused,
                                      [&](int number, bool listed) {
                                        return owner[number] / search_workspace::list_size < i ||
                                               (!listed && ctx.held(number));
                                      });
        ctx.match(c, i) = k;
        if (k < 0) { continue; }
        atomic_max(last_unobserved + ctx.number(c, k), i);
        ++taken;
      }
    }
    g.sync();
  }
  for (int number = g.rank(); number < numbers; number += g.size()) {
    int const c = ctx.camera_of(number);
    if (owner[number] != unset) {
      int const i = owner[number] / search_workspace::list_size;
      ctx.match(c, i) = number - c * ctx.frame.capacity();
      ctx.holder[number] = ctx.slot(c, i);
      ++taken;
    } else if (unobserved && last_unobserved[number] >= 0) {
      ctx.holder[number] = ctx.slot(c, last_unobserved[number]);
    } else if (ctx.params.from_empty) {
      ctx.holder[number] = -1;
    }
  }
  taken = g.reduce(taken, sum_op{});
  if (g.rank() == 0) { ctx.work.matches[ctx.b] = taken; }
}

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
