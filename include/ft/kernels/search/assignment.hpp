// SPDX-License-Identifier: Apache-2.0
/// @file Stage: who takes which keypoint.
#pragma once

#include <cstddef>
#include <type_traits>

#include "ft/containers/frame.hpp"
#include "ft/containers/map_points.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/kernels/search/assignment_context.hpp"
#include "ft/kernels/search/candidates.hpp"
#include "ft/kernels/search/proposals.hpp"
#include "ft/kernels/search/sequential.hpp"
#include "ft/kernels/search/turns.hpp"
#include "ft/kernels/search/windows.hpp"
#include "ft/kernels/search/workspace.hpp"

namespace ft {
inline namespace FT_ABI {

namespace detail {

/// Threads of a block that assigns the keypoints of a frame.
inline constexpr int assign_threads = 1024;

/// All windows of one frame: who takes which keypoint.
/// @tparam Turns true: all points choose at once, until nothing changes; false: the plain loop, for
///   groups of one thread
template <bool Turns, bool Single = false>
struct assign_keypoints {
  /// Frames of up to so many keypoints, and searches of so many points with candidates, keep their
  /// state in block scratch, others in the workspace.
  static constexpr int scratch_size = assign_scratch::size;
  using scratch = std::conditional_t<Turns, assign_scratch, no_scratch>;

  static constexpr bool prepares = true;
  /// Empties the tables.
  template <typename Group, typename... Args>
  FT_HOST_DEVICE static void prepare(Group g, scratch& s, int, frame_view const& frame,
                                     Args const&...) {
    if constexpr (Turns) {
      if (in_scratch(frame)) { empty(g, s, s.writer, s.before, frame.numbers()); }
    }
  }

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int b, frame_view const& frame,
                                 map_points_view const& map, search_windows_view const& windows,
                                 search_params const& params, search_workspace const& work) const {
    assign(g, s, b, frame, map, windows, params, work, true,
           [](auto, int const*) { return false; });
  }

  /// The same. Where every window has one keypoint at most, and every keypoint one owner or nobody,
  /// calls write(single, owners) first, with a constant `Single` and, for each keypoint, list_size
  /// times a window and more, or nobody. Returns true, and writes nothing, if that did. `s` but for
  /// what `owners` points to is free then.
  /// @param prepared prepare() was called, and nothing else since
  template <typename Group, typename Write>
  FT_HOST_DEVICE static bool assign(Group g, scratch& s, int b, frame_view const& frame,
                                    map_points_view const& map, search_windows_view const& windows,
                                    search_params const& params, search_workspace const& work,
                                    bool prepared, Write const& write) {
    bool const partners = frame.partner != nullptr && params.kind == search_kind::local_map;
    if constexpr (Turns && !Single) {
      if (frame.cameras == 1 && !partners) {
        return assign_keypoints<Turns, true>::assign(g, s, b, frame, map, windows, params, work,
                                                     prepared, write);
      }
    }
    assignment_context<Single> const ctx{
        b,
        frame,
        map.slice(b),
        windows,
        params,
        work,
        frame.holder + static_cast<std::ptrdiff_t>(b) * frame.numbers(),
        partners && !Single ? frame.partner + static_cast<std::ptrdiff_t>(b) * frame.numbers()
                            : nullptr,
        frame.right_x == nullptr || !params.right_later
            ? nullptr
            : frame.right_x + static_cast<std::ptrdiff_t>(b) * frame.capacity()};
    if constexpr (Turns) {
      auto const empty_all = [&] { empty(g, s, owners(s, ctx), seconds(s, ctx), frame.numbers()); };
      if (!prepared || !in_scratch(frame)) { empty_all(); }
      g.sync();
      bool const proposes = params.kind == search_kind::last_frame;
      if (proposes && let_propose(g, s, ctx)) {
        bool const simple = in_scratch(frame) && s.guests == 0 && params.from_empty;
        using single = std::integral_constant<bool, Single>;
        if (simple && write(single{}, static_cast<int const*>(s.writer))) { return true; }
        write_proposed(g, s, ctx);
      } else {
        if (proposes) {
          empty_all();
          g.sync();
        }
        take_turns(g, s, ctx);
      }
    } else {
      one_after_another(ctx);
    }
    return false;
  }
};

}  // namespace detail

/// Candidates and greedy assignment of a search, equal to the sequential loop for any input: fills
/// `frame.holder`, `work.match` and `work.matches`. Asynchronous on `exec`; allocates nothing; two
/// launches.
template <typename Exec>
void search_by_projection(Exec const& exec, frame_view const& frame, map_points_view const& map,
                          search_windows_view const& windows, search_params const& params,
                          search_workspace const& work) {
  for_each_item<per_warp>(exec, windows.batch * windows.capacity, detail::list_candidates{}, frame,
                          map, windows, params, work);
  for_each_item<per_block<detail::assign_threads>>(exec, windows.batch,
                                                   detail::assign_keypoints<Exec::asynchronous>{},
                                                   frame, map, windows, params, work);
}

}  // namespace FT_ABI
}  // namespace ft
