// SPDX-License-Identifier: Apache-2.0
/// @file The assignment by turns for one camera without stereo partners, if all points are
/// observed.
///
/// The same as turns.hpp with fewer instructions, which matters because later stages wait for this
/// single block.
#pragma once

#include <cstdint>

#include "ft/core/config.hpp"
#include "ft/core/group.hpp"
#include "ft/kernels/search/detail/assignment_context.hpp"
#include "ft/kernels/search/detail/candidate_list.hpp"
#include "ft/kernels/search/detail/choose.hpp"
#include "ft/kernels/search/detail/open_points.hpp"
#include "ft/kernels/search/detail/writes.hpp"

namespace ft {
inline namespace FT_ABI {

namespace detail {

/// An open point in one word: index (12 bits), number of listed candidates (5 bits), whether more
/// exist (1 bit), choice + 1.
struct packed_point {
  static constexpr int some_unlisted = 1 << 17;
  int word;

  static_assert(assign_scratch::size < 1 << 12 && search_workspace::list_size < 1 << 5, "bits");
  FT_HOST_DEVICE static packed_point of(int i, int count, int k) {
    int const listed = count & search_workspace::counted;
    return {i | listed << 12 | ((count & search_workspace::unlisted) != 0 ? some_unlisted : 0) |
            (k + 1) << 18};
  }
  FT_HOST_DEVICE int index() const { return word & 0xfff; }
  FT_HOST_DEVICE int listed() const { return word >> 12 & 0x1f; }
  FT_HOST_DEVICE bool unlisted() const { return (word & some_unlisted) != 0; }
  FT_HOST_DEVICE int choice() const { return (word >> 18) - 1; }
  FT_HOST_DEVICE packed_point with(int k) const { return {(word & 0x3ffff) | (k + 1) << 18}; }
};

/// As choose_keypoint(). Most points decide on the nearest four candidates, which are examined
/// together.
FT_HOST_DEVICE inline int choose_packed(assignment_context<true> const& ctx, packed_point point,
                                        first_writes const& writes) {
  int const i = point.index();
  int const listed = point.listed();
  std::uint32_t best = ~0u;
  std::uint32_t second = ~0u;
  if (listed > 0) {
    candidate_quad const quad = *ctx.list(0, i);
    FT_UNROLL
    for (int e = 3; e >= 0; --e) {
      std::uint32_t const entry = quad.entry[e];
      bool free = e < listed;
      if (free) { free = writes.last[entry_keypoint(entry)] >= writes.base + i; }
      second = free ? best : second;
      best = free ? entry : best;
    }
  }
  // Empty places compare as farther than any candidate.
  bool const near = entry_distance(best) <= ctx.params.max_hamming;
  bool const all = listed <= 4 && !point.unlisted();
  if (second == ~0u && !all && (near || best == ~0u)) {
    bool refused = false;
    return choose_keypoint(
        ctx, 0, i, window_list(ctx, 0, i, true, false), refused,
        [&](int number, bool in_list) { return writes.taken(ctx, number, i, in_list); });
  }
  if (!near || best == ~0u) { return -1; }
  int const k = entry_keypoint(best);
  int const second_k = second == ~0u ? -1 : entry_keypoint(second);
  bool const refused = refuses(ctx.params, ctx.frame.camera(ctx.b, 0), entry_distance(best), k,
                               entry_distance(second), second_k);
  return refused ? -1 : k;
}

/// Packs the points with candidates, in any order, and records their first choices.
/// @param n points, at most assign_scratch::size
template <typename Group>
FT_HOST_DEVICE void list_packed(Group g, assign_scratch& s, assignment_context<true> const& ctx,
                                int n, first_writes const& writes) {
  constexpr int steps = 3;
  auto const part = g.part();
  for (int first = 0; first < n; first += steps * g.size()) {
    int const begin = first + steps * part.size() * g.part_index() + part.rank();
    int counts[steps], made[steps], before[steps];
    FT_UNROLL
    for (int t = 0; t < steps; ++t) {
      int const i = begin + t * part.size();
      counts[t] = i < n ? ctx.list_count(0, i) : 0;
      made[t] = i < n ? ctx.match(0, i) : -1;
    }
    int mine = 0;
    FT_UNROLL
    for (int t = 0; t < steps; ++t) {
      int here = 0;
      before[t] = mine + part.exclusive_count(has_candidates(counts[t], false), here);
      mine += here;
    }
    int place = 0;
    if (part.rank() == 0) { place = atomic_add(&s.open_count, mine); }
    place = part.shuffle(place, 0);
    FT_UNROLL
    for (int t = 0; t < steps; ++t) {
      if (!has_candidates(counts[t], false)) { continue; }
      int const i = begin + t * part.size();
      if ((counts[t] & search_workspace::observed) == 0) { s.any_unobserved = 1; }
      s.open[place + before[t]] = packed_point::of(i, counts[t], made[t]).word;
      if (made[t] >= 0) { writes.add(made[t], i); }
    }
  }
}

/// Takes turns until no choice changes.
template <typename Group>
FT_HOST_DEVICE void run_packed_turns(Group g, assign_scratch& s,
                                     assignment_context<true> const& ctx, int count,
                                     first_writes& writes) {
  // Points below `begin` are final.
  int begin = 0;
  for (int turn = 0;; turn = (turn + 1) % 3) {
    if (g.rank() == 0) { s.first_changed[(turn + 1) % 3] = unset; }
    for (int p = g.rank(); p < count; p += g.size()) {
      packed_point const point{s.open[p]};
      int const i = point.index();
      int k = point.choice();
      if (i >= begin) {
        int const chosen = choose_packed(ctx, point, writes);
        if (chosen != k) {
          k = chosen;
          s.open[p] = point.with(k).word;
          atomic_min(s.first_changed + turn, i);
        }
      }
      if (k >= 0) { writes.add(k, i); }
    }
    g.sync();
    int const changed = s.first_changed[turn];
    if (changed == unset) { break; }
    begin = changed + 1;
    writes.next_turn(g);
  }
}

/// Writes matches and holders.
template <typename Group>
FT_HOST_DEVICE void write_packed(Group g, assign_scratch& s, assignment_context<true> const& ctx,
                                 int count, first_writes const& writes) {
  int taken = 0;
  for (int p = g.rank(); p < count; p += g.size()) {
    packed_point const point{s.open[p]};
    int const slot = ctx.slot(0, point.index());
    int const k = point.choice();
    ctx.match(0, point.index()) = k;
    if (k < 0) { continue; }
    ctx.holder[k] = slot;
    ++taken;
  }
  for (int k = g.rank(); ctx.params.from_empty && k < ctx.numbers(); k += g.size()) {
    if (!writes.written(k)) { ctx.holder[k] = -1; }
  }
  auto const part = g.part();
  taken = part.reduce(taken, sum_op{});
  if (part.rank() == 0) { atomic_add(ctx.work.matches + ctx.b, taken); }
}

/// The turns if all points are observed. The number of a write is the index of its point, so the
/// points may be listed in any order.
/// @param n points, at most assign_scratch::size, as are the keypoints
/// @return false, with nothing written, if a point is not observed
template <typename Group>
FT_HOST_DEVICE bool take_packed_turns(Group g, assign_scratch& s,
                                      assignment_context<true> const& ctx, int n) {
  // Not owner_table(): the compiler must know that these tables are in shared memory.
  first_writes writes(s.writer, s.before, ctx.numbers(), n);
  list_packed(g, s, ctx, n, writes);
  g.sync();
  int const count = s.open_count;
  bool const unobserved = s.any_unobserved != 0;
  g.sync();
  if (unobserved) { return false; }
  writes.next_turn(g);
  run_packed_turns(g, s, ctx, count, writes);
  write_packed(g, s, ctx, count, writes);
  return true;
}

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
