// SPDX-License-Identifier: Apache-2.0
/// @file Open points: the map points that have candidates, and their choices.
#pragma once

#include "ft/core/config.hpp"
#include "ft/kernels/search/detail/assignment_context.hpp"

namespace ft {
inline namespace FT_ABI {

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

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
