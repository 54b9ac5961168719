// SPDX-License-Identifier: Apache-2.0
/// @file Stage: greedy assignment of keypoints to map points, and the search in given windows.
/// Source: specification sections 9 and 10.
#pragma once

#include <cmath>
#include <cstdint>
#include <type_traits>

#include "ft/containers/frame.hpp"
#include "ft/containers/map_points.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/group.hpp"
#include "ft/kernels/search/detail/assignment_context.hpp"
#include "ft/kernels/search/detail/candidate_list.hpp"
#include "ft/kernels/search/detail/candidates.hpp"
#include "ft/kernels/search/detail/turns.hpp"
#include "ft/kernels/search/workspace.hpp"

namespace ft {
inline namespace FT_ABI {

// The greedy assignment by proposals, for searches without a ratio test.
//
// Every window prefers the nearest keypoint, and every keypoint prefers the lowest window. This is
// a stable matching with one solution, so windows may propose in any order and concurrently (Gale
// and Shapley, "College admissions and the stability of marriage", 1962).

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

// The greedy assignment as a loop over the points, by one thread.

template <bool Single>
FT_HOST_DEVICE void assign_sequentially(assignment_context<Single> const& ctx) {
  int const numbers = ctx.numbers();
  for (int k = 0; ctx.params.from_empty && k < numbers; ++k) { ctx.holder[k] = -1; }
  int taken = 0;
  bool unobserved = false;  // an unobserved point took a keypoint, and may have freed one
  for (int i = 0; i < ctx.windows.count[ctx.b]; ++i) {
    bool refused = false;
    for (int c = 0; c < ctx.cameras(); ++c) {
      bool const any = has_candidates(ctx.list_count(c, i), unobserved);
      int const k =
          choose_keypoint(ctx, c, i, window_list(ctx, c, i, any, unobserved), refused,
                          [&](int number, bool) { return ctx.observed(ctx.holder[number]); });
      ctx.match(c, i) = k;
      if (k < 0) { continue; }
      unobserved = unobserved || !ctx.observed(ctx.slot(c, i));
      int const partner = ctx.partner_of(ctx.number(c, k));
      ctx.holder[ctx.number(c, k)] = ctx.slot(c, i);
      if (partner >= 0) { ctx.holder[partner] = ctx.slot(c, i); }
      taken += partner >= 0 ? 2 : 1;
    }
  }
  ctx.work.matches[ctx.b] = taken;
}

/// Threads of the block that assigns the keypoints of a frame.
inline constexpr int assign_threads = 1024;

/// Item: a frame. Assigns its keypoints, by the contract of assignment_context.hpp.
/// @tparam Turns true: the parallel forms; false: the loop, for groups of one thread
/// @tparam Searches see frame_search
/// @tparam Single one camera and no stereo partners; selected by assign()
template <bool Turns, int Searches = 1, bool Single = false>
struct assign_keypoints {
  static constexpr int scratch_size = assign_scratch::size;
  using scratch = std::conditional_t<Turns, assign_scratch, no_scratch>;

  /// Clears the tables in block scratch.
  template <typename Group, typename... Args>
  FT_HOST_DEVICE static void prologue(Group g, scratch& s, int, frame_view const& frame,
                                      Args const&...) {
    if constexpr (Turns) {
      if (in_scratch(frame)) { clear_tables(g, s, s.writer, s.before, frame.numbers()); }
    }
  }

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int b, frame_view const& frame,
                                 map_points_view const& map, search_params const& params,
                                 search_buffers const& buffers) const {
    assign(g, s, {b, frame, map, params, buffers, false, Searches}, true,
           [](auto, int const*) { return false; });
  }

  /// Assigns the keypoints of a frame.
  ///
  /// After proposals that start without holders, if all points are observed, write(single, owners)
  /// may write the result instead of this function. `single` is the constant `Single`. `owners` is
  /// the owner table, in block scratch. The rest of `s` may be overwritten.
  /// @param prepared the tables are cleared
  /// @param write returns whether it wrote the result
  /// @return whether `write` did
  template <typename Group, typename Write>
  FT_HOST_DEVICE static bool assign(Group g, scratch& s, frame_search const& in, bool prepared,
                                    Write const& write) {
    static_assert(Turns || Group::max_threads == 1, "the loop is for one thread");
    frame_view const& frame = in.frame;
    bool const partners = in.partners();
    if constexpr (Turns && !Single) {
      if (frame.cameras == 1 && !partners) {
        return assign_keypoints<Turns, Searches, true>::assign(g, s, in, prepared, write);
      }
    }
    assignment_context<Single> const ctx(in);
    if constexpr (Turns) {
      auto const clear_all = [&] {
        clear_tables(g, s, owner_table(s, ctx), second_table(s, ctx), frame.numbers());
      };
      if (!prepared || !in_scratch(frame)) { clear_all(); }
      g.sync();
      bool const proposes = ctx.params.kind == search_kind::last_frame;
      if (proposes && propose_all(g, s, ctx)) {
        bool const simple = in_scratch(frame) && s.any_unobserved == 0 && ctx.params.from_empty;
        using single = std::integral_constant<bool, Single>;
        if (simple && write(single{}, static_cast<int const*>(s.writer))) { return true; }
        write_proposed(g, s, ctx);
      } else {
        if (proposes) {
          clear_all();
          g.sync();
        }
        take_turns(g, s, ctx);
      }
    } else {
      assign_sequentially(ctx);
    }
    return false;
  }
};

}  // namespace detail

/// Assigns keypoints from candidates that are listed in `work`. The result equals that of a loop
/// over the points, for any input. Writes `frame.holder`, `work.match` and `work.matches`.
/// Asynchronous on `exec`; allocates nothing; one launch.
/// @tparam Searches of a rig, whose batch entries share a map
template <int Searches = 1, typename Exec>
void assign_candidates(Exec const& exec, frame_view const& frame, map_points_view const& map,
                       search_params const& params, search_buffers const& buffers) {
  for_each_item<per_block<detail::assign_threads>>(
      exec, buffers.windows.batch, detail::assign_keypoints<Exec::asynchronous, Searches>{}, frame,
      map, params, buffers);
}

/// Search in given windows: lists candidates and assigns keypoints. The result equals that of a
/// loop over the points, for any input. Writes `frame.holder`, `work.match` and `work.matches`.
/// Asynchronous on `exec`; allocates nothing; two launches, of which only the first is concurrent
/// with its predecessor if `exec` says so.
template <typename Exec>
void search_by_projection(Exec const& exec, frame_view const& frame, map_points_view const& map,
                          search_params const& params, search_buffers const& buffers) {
  for_each_item<per_warp>(exec, buffers.windows.batch * buffers.windows.capacity,
                          detail::list_candidates{}, frame, map, params, buffers);
  assign_candidates(detail::with_order(exec, detail::launch_order::serial), frame, map, params,
                    buffers);
}

}  // namespace FT_ABI
}  // namespace ft
