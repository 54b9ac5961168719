// SPDX-License-Identifier: Apache-2.0
/// @file Records of the keypoints that points wrote in a turn: two forms with one interface.
#pragma once

#include <cstdint>

#include "ft/core/config.hpp"
#include "ft/core/group.hpp"
#include "ft/kernels/search/detail/assignment_context.hpp"

namespace ft {
inline namespace FT_ABI {

// Open points: the map points that have candidates, and their choices.

namespace detail {

/// The points that have candidates, renumbered in search order.
///
/// A point writes the keypoints it takes, each followed by its stereo partner. The writes of point
/// p have the numbers from writes() * p.
template <bool Single>
struct open_points {
  static constexpr int observed_left = 1 << 30;
  static constexpr int observed_right = 1 << 29;
  static constexpr int any_left = 1 << 28;
  static constexpr int any_right = 1 << 27;
  int* list;  ///< index of the point and the bits above
  int count;
  int points;  ///< of the search, open or not
  int cameras_;
  int partners_;

  FT_HOST_DEVICE int cameras() const { return Single ? 1 : cameras_; }
  /// 1 = stereo partners are matched, too; else 0.
  FT_HOST_DEVICE int partners() const { return Single ? 0 : partners_; }

  /// List entry of point i, 0 if it has no candidates.
  /// @param counts of its windows, as in search_workspace::list_count
  /// @param held as in has_candidates()
  FT_HOST_DEVICE static int entry(int i, int const (&counts)[2], bool held) {
    bool const left = has_candidates(counts[0], held);
    bool const right = has_candidates(counts[1], held);
    constexpr int observed = search_workspace::observed;
    int flags = left ? any_left : 0;
    flags |= right ? any_right : 0;
    flags |= left && (counts[0] & observed) != 0 ? observed_left : 0;
    flags |= right && (counts[1] & observed) != 0 ? observed_right : 0;
    return flags != 0 ? i | flags : 0;
  }
  /// Whether the point has candidates and is not observed.
  FT_HOST_DEVICE static bool unobserved(int entry) {
    return ((entry & any_left) != 0 && (entry & observed_left) == 0) ||
           ((entry & any_right) != 0 && (entry & observed_right) == 0);
  }
  /// Numbers reserved for the writes of a point: 1, 2 or 4.
  FT_HOST_DEVICE int writes() const { return cameras() << partners(); }
  FT_HOST_DEVICE int index(int p) const { return list[p] & (any_right - 1); }
  FT_HOST_DEVICE bool any(int p, int camera) const {
    return (list[p] & (camera == 0 ? any_left : any_right)) != 0;
  }
  FT_HOST_DEVICE bool observed(int p, int camera) const {
    return (list[p] & (camera == 0 ? observed_left : observed_right)) != 0;
  }
  /// Whether the point of a write is observed.
  FT_HOST_DEVICE bool observed(int write) const {
    return observed(write >> (cameras() - 1 + partners()), (write >> partners()) & (cameras() - 1));
  }
};

/// Keypoints that a point takes in each camera, -1 = none.
struct point_choice {
  int k[2] = {-1, -1};
};

/// The stored choice of open point p.
template <bool Single>
FT_HOST_DEVICE point_choice last_choice(assignment_context<Single> const& ctx,
                                        open_points<Single> const& open, int p) {
  point_choice made;
  FT_UNROLL
  for (int c = 0; c < 2; ++c) {
    if (c < open.cameras() && open.any(p, c)) { made.k[c] = ctx.match(c, open.index(p)); }
  }
  return made;
}

/// Calls visit(camera, number of the keypoint, number of the write) for each write of point p.
template <bool Single, typename Visit>
FT_HOST_DEVICE void each_write(assignment_context<Single> const& ctx,
                               open_points<Single> const& open, int p, point_choice const& made,
                               Visit const& visit) {
  FT_UNROLL
  for (int c = 0; c < 2; ++c) {
    if (made.k[c] < 0) { continue; }
    int const number = ctx.number(c, made.k[c]);
    int const at = p * open.writes() + (c << open.partners());
    visit(c, number, at);
    int const partner = ctx.partner_of(number);
    if (partner >= 0) { visit(c, partner, at + 1); }
  }
}

/// Lists the open points in order, and calls visit(p, stored choice) for each.
/// @param held as in has_candidates()
template <typename Group, bool Single, typename Visit>
FT_HOST_DEVICE void list_open(Group g, assign_scratch& s, assignment_context<Single> const& ctx,
                              open_points<Single>& open, bool held, Visit const& visit) {
  // Neighbouring threads read neighbouring points. Each reads several at a time, so that their
  // loads overlap and one scan serves all of them.
  constexpr int steps = 4;
  auto const part = g.part();
  int const n = open.points;
  open.count = 0;
  for (int first = 0; first < n; first += steps * g.size()) {
    int const begin = first + steps * part.size() * g.part_index() + part.rank();
    int counts[steps][2];
    point_choice made[steps];
    FT_UNROLL
    for (int t = 0; t < steps; ++t) {
      int const i = begin + t * part.size();
      FT_UNROLL
      for (int c = 0; c < 2; ++c) {
        bool const there = i < n && c < open.cameras();
        counts[t][c] = there ? ctx.list_count(c, i) : 0;
        made[t].k[c] = there ? ctx.match(c, i) : -1;
      }
    }
    int entry[steps];
    int mine = 0;
    FT_UNROLL
    for (int t = 0; t < steps; ++t) {
      entry[t] = open_points<Single>::entry(begin + t * part.size(), counts[t], held);
      mine += static_cast<int>(entry[t] != 0);
    }
    int found = 0;
    int place = open.count + part.shuffle(g.exclusive_scan(mine, found), 0);
    FT_UNROLL
    for (int t = 0; t < steps; ++t) {
      int here = 0;
      int const before = part.exclusive_count(entry[t] != 0, here);
      if (entry[t] != 0) {
        open.list[place + before] = entry[t];
        if (open_points<Single>::unobserved(entry[t])) { s.any_unobserved = 1; }
        visit(place + before, made[t]);
      }
      place += here;
    }
    open.count += found;
  }
}

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
