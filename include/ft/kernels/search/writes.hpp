// SPDX-License-Identifier: Apache-2.0
/// @file What the points of a search wrote in a turn.
#pragma once

#include <cstdint>

#include "ft/core/config.hpp"
#include "ft/core/group.hpp"
#include "ft/kernels/search/assignment_context.hpp"
#include "ft/kernels/search/open_points.hpp"

namespace ft {
inline namespace FT_ABI {

namespace detail {

/// What the points wrote in a turn, where all that is looked for is observed: a keypoint is taken
/// from its first write on, and that is all that is kept of the writes to it.
///
/// One table has those of the turn before, the other gets those of this turn. Every turn adds a
/// lower base to its writes' numbers than the turns before: nothing need be cleared in between.
struct first_writes {
  static constexpr bool kept_at_once = true;
  int* last;  ///< of a keypoint: base + its first write; more, where it has none
  int* now;   ///< the same of this turn
  int numbers;
  int writes;  ///< in a turn, at most
  int base;
  int base_now;

  /// @param a,b emptied
  FT_HOST_DEVICE first_writes(int* a, int* b, int keypoints, int most)
      : last(a),
        now(b),
        numbers(keypoints),
        writes(most),
        base(nobody - most),
        base_now(nobody - most) {}

  /// The turn before is the one that just ended, for all threads.
  template <typename Group, bool Single>
  FT_HOST_DEVICE void next_turn(Group g, assignment_context<Single> const&,
                                open_points<Single> const&) {
    int* const other = last;
    int const other_base = base;
    last = now;
    base = base_now;
    now = other;
    base_now = other_base - writes;
    if (base_now >= 0) { return; }
    for (int k = g.rank(); k < numbers; k += g.size()) { now[k] = nobody; }
    base_now = nobody - writes;
    g.sync();
  }
  FT_HOST_DEVICE void add(int number, int write) const {
    atomic_min(now + number, base_now + write);
  }
  FT_HOST_DEVICE bool written(int number) const { return last[number] < base + writes; }
  /// Whether a keypoint is taken before the write `end`. @param listed it is in a list
  template <bool Single>
  FT_HOST_DEVICE bool taken(assignment_context<Single> const& ctx, open_points<Single> const&,
                            int number, int end, bool listed) const {
    return last[number] < base + end || (!listed && ctx.held(number));
  }
  /// When the turns are over: finds the last write to each keypoint.
  template <typename Group, bool Single>
  FT_HOST_DEVICE void find_last(Group g, assignment_context<Single> const& ctx,
                                open_points<Single> const& open) const {
    if (open.partners() == 0) { return; }  // there is one
    for (int p = g.rank(); p < open.count; p += g.size()) {
      each_write(ctx, open, p, last_choice(ctx, open, p),
                 [&](int, int number, int w) { atomic_min(now + number, -1 - w); });
    }
    g.sync();
  }
  template <bool Single>
  FT_HOST_DEVICE bool is_last(open_points<Single> const& open, int number, int write) const {
    return open.partners() == 0 || now[number] == -1 - write;
  }
};

/// The same where some of what is looked for is not observed: all writes to a keypoint, in a
/// chain.
struct write_chains {
  static constexpr bool kept_at_once = false;
  int* first;          ///< of a keypoint: first in the chain, -1 = nothing writes it
  int* next;           ///< of a write: next in the chain, -1 = none
  std::uint8_t* held;  ///< of a keypoint: 1 = taken before the search
  int numbers;

  template <typename Group>
  FT_HOST_DEVICE void clear(Group g) const {
    for (int k = g.rank(); k < numbers; k += g.size()) { first[k] = -1; }
  }
  template <typename Group, bool Single>
  FT_HOST_DEVICE void next_turn(Group g, assignment_context<Single> const& ctx,
                                open_points<Single> const& open) const {
    clear(g);
    g.sync();
    for (int p = g.rank(); p < open.count; p += g.size()) {
      each_write(ctx, open, p, last_choice(ctx, open, p),
                 [&](int, int number, int w) { add(number, w); });
    }
    g.sync();
  }
  FT_HOST_DEVICE void add(int number, int write) const {
    next[write] = atomic_exchange(first + number, write);
  }
  FT_HOST_DEVICE bool written(int number) const { return first[number] >= 0; }
  template <bool Single>
  FT_HOST_DEVICE bool taken(assignment_context<Single> const&, open_points<Single> const& open,
                            int number, int end, bool) const {
    int const write = last_write(number, end);
    return write < 0 ? held[number] != 0 : open.observed(write);
  }
  template <typename Group, bool Single>
  FT_HOST_DEVICE void find_last(Group, assignment_context<Single> const&,
                                open_points<Single> const&) const {}
  template <bool Single>
  FT_HOST_DEVICE bool is_last(open_points<Single> const&, int number, int write) const {
    return last_write(number, nobody) == write;
  }

private:
  /// The last write to a keypoint below `end`, -1 = none.
  FT_HOST_DEVICE int last_write(int number, int end) const {
    int last = -1;
    for (int w = first[number]; w >= 0; w = next[w]) {
      if (w < end) { last = max_of(last, w); }
    }
    return last;
  }
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
