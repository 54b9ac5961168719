// SPDX-License-Identifier: Apache-2.0
/// @file Stage: greedy assignment of keypoints to map points, and the search in given windows.
/// Source: specification sections 9 and 10.
#pragma once

#include <type_traits>

#include "ft/containers/frame.hpp"
#include "ft/containers/map_points.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/kernels/search/detail/assignment_context.hpp"
#include "ft/kernels/search/detail/candidate_list.hpp"
#include "ft/kernels/search/detail/candidates.hpp"
#include "ft/kernels/search/detail/choose.hpp"
#include "ft/kernels/search/detail/proposals.hpp"
#include "ft/kernels/search/detail/turns.hpp"
#include "ft/kernels/search/workspace.hpp"

namespace ft {
inline namespace FT_ABI {

// The greedy assignment as a loop over the points, by one thread.

namespace detail {

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
