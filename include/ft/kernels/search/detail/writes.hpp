// SPDX-License-Identifier: Apache-2.0
/// @file Records of the keypoints that points wrote in a turn: two forms with one interface.
#pragma once

#include <cstdint>

#include "ft/core/config.hpp"
#include "ft/core/group.hpp"
#include "ft/kernels/search/detail/assignment_context.hpp"
#include "ft/kernels/search/detail/open_points.hpp"

namespace ft {
inline namespace FT_ABI {

namespace detail {

/// The writes of the previous turn, if all open points are observed. A keypoint is taken from its
/// first write on, so only the first write is kept.
///
/// `last` holds the writes of the previous turn and `now` collects those of the current one. Each
/// turn's keys are smaller than all earlier ones, so stale entries lose every minimum and no
/// clearing is needed.
struct first_writes {
  /// add() is called while points choose, not afterwards.
  static constexpr bool kept_at_once = true;
  int* last;  ///< per keypoint: base + first write of the previous turn; larger = none
  int* now;   ///< per keypoint: base_now + first write of the current turn
  int numbers;
  int writes;  ///< upper limit of write numbers
  int base;
  int base_now;

  /// @param a,b cleared tables
  FT_HOST_DEVICE first_writes(int* a, int* b, int keypoints, int most)
      : last(a),
        now(b),
        numbers(keypoints),
        writes(most),
        base(unset - most),
        base_now(unset - most) {}

  /// Makes the current turn the previous one. Called by all threads.
  template <typename Group>
  FT_HOST_DEVICE void next_turn(Group g) {
    int* const other = last;
    int const other_base = base;
    last = now;
    base = base_now;
    now = other;
    base_now = other_base - writes;
    if (base_now >= 0) { return; }
    for (int k = g.rank(); k < numbers; k += g.size()) { now[k] = unset; }
    base_now = unset - writes;
    g.sync();
  }
  template <typename Group, bool Single>
  FT_HOST_DEVICE void next_turn(Group g, assignment_context<Single> const&,
                                open_points<Single> const&) {
    next_turn(g);
  }
  FT_HOST_DEVICE void add(int number, int write) const {
    atomic_min(now + number, base_now + write);
  }
  FT_HOST_DEVICE bool written(int number) const { return last[number] < base + writes; }
  /// Whether a keypoint is taken before the write `end`.
  /// @param listed whether it is in a candidate list, so that its holder was checked
  template <bool Single>
  FT_HOST_DEVICE bool taken(assignment_context<Single> const& ctx, int number, int end,
                            bool listed) const {
    return last[number] < base + end || (!listed && ctx.held(number));
  }
  template <bool Single>
  FT_HOST_DEVICE bool taken(assignment_context<Single> const& ctx, open_points<Single> const&,
                            int number, int end, bool listed) const {
    return taken(ctx, number, end, listed);
  }
  /// After the last turn: finds the last write to each keypoint.
  template <typename Group, bool Single>
  FT_HOST_DEVICE void find_last(Group g, assignment_context<Single> const& ctx,
                                open_points<Single> const& open) const {
    if (open.partners() == 0) { return; }  // the first write is the only one
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

/// The same if some open points are not observed: all writes to each keypoint, as linked lists.
struct write_chains {
  static constexpr bool kept_at_once = false;
  int* first;          ///< per keypoint: first write of its chain, -1 = none
  int* next;           ///< per write: next one of the chain, -1 = none
  std::uint8_t* held;  ///< per keypoint: 1 = held by an observed point since before the search
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
    return last_write(number, unset) == write;
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
