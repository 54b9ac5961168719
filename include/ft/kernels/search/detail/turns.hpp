// SPDX-License-Identifier: Apache-2.0
/// @file The greedy assignment by turns, for any search.
///
/// In each turn every point chooses as if the choices of all lower points were final, until nothing
/// changes. Point 0 is right at once. If all points below i are right and do not change, i is right
/// after the next turn. So the turns end, and the only state in which they can end is the result of
/// the loop. Four turns were typical on recorded frames; the worst case takes one turn per point.
#pragma once

#include <cstddef>
#include <cstdint>

#include "ft/core/config.hpp"
#include "ft/core/group.hpp"
#include "ft/kernels/search/detail/assignment_context.hpp"
#include "ft/kernels/search/detail/candidate_list.hpp"
#include "ft/kernels/search/detail/writes.hpp"

namespace ft {
inline namespace FT_ABI {

// The assignment by turns for one camera without stereo partners, if all points are
// observed.
//
// The same as turns.hpp with fewer instructions, which matters because later stages wait for this
// single block.

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

/// Lets open point p choose after the writes of the previous turn. @return whether it changed
template <bool Single, typename Writes>
FT_HOST_DEVICE bool choose_anew(assignment_context<Single> const& ctx,
                                open_points<Single> const& open, Writes const& writes, int p,
                                point_choice& made) {
  int const i = open.index(p);
  int const end = p * open.writes();
  window_list const lists[2] = {window_list(ctx, 0, i, open.any(p, 0), !Writes::kept_at_once),
                                window_list(ctx, 1, i, open.any(p, 1), !Writes::kept_at_once)};
  bool changed = false;
  bool refused = false;
  int own = -1;  // stereo partner of the keypoint that the left window takes
  FT_UNROLL
  for (int c = 0; c < 2; ++c) {
    if (c >= open.cameras()) { break; }
    int const k = choose_keypoint(ctx, c, i, lists[c], refused, [&](int number, bool listed) {
      return number == own ? open.observed(p, 0) : writes.taken(ctx, open, number, end, listed);
    });
    if (k >= 0 && c == 0) { own = ctx.partner_of(k); }
    if (k == made.k[c]) { continue; }
    changed = true;
    made.k[c] = k;
    ctx.match(c, i) = k;
  }
  return changed;
}

/// Takes turns until no choice changes, then writes the result.
template <typename Group, bool Single, typename Writes>
FT_HOST_DEVICE void run_turns(Group g, assign_scratch& s, assignment_context<Single> const& ctx,
                              open_points<Single> const& open, Writes writes) {
  // Points below `begin` are final.
  int begin = 0;
  for (int turn = 0;; turn = (turn + 1) % 3) {
    if (g.rank() == 0) { s.first_changed[(turn + 1) % 3] = unset; }
    for (int p = g.rank(); p < open.count; p += g.size()) {
      point_choice made = last_choice(ctx, open, p);
      if (p >= begin && choose_anew(ctx, open, writes, p, made)) {
        atomic_min(s.first_changed + turn, p);
      }
      if constexpr (Writes::kept_at_once) {
        each_write(ctx, open, p, made, [&](int, int number, int w) { writes.add(number, w); });
      }
    }
    g.sync();
    int const changed = s.first_changed[turn];
    if (changed == unset) { break; }
    begin = changed + 1;
    writes.next_turn(g, ctx, open);
  }
  writes.find_last(g, ctx, open);
  int taken = 0;
  for (int p = g.rank(); p < open.count; p += g.size()) {
    int const i = open.index(p);
    each_write(ctx, open, p, last_choice(ctx, open, p), [&](int c, int number, int w) {
      if (writes.is_last(open, number, w)) { ctx.holder[number] = ctx.slot(c, i); }
      ++taken;
    });
  }
  for (int k = g.rank(); ctx.params.from_empty && k < ctx.numbers(); k += g.size()) {
    if (!writes.written(k)) { ctx.holder[k] = -1; }
  }
  taken = g.part().reduce(taken, sum_op{});
  if (g.part().rank() == 0) { atomic_add(ctx.work.matches + ctx.b, taken); }
}

/// Lists the open points, chooses how to record writes, and takes turns.
template <typename Group, bool Single>
FT_HOST_DEVICE void take_turns(Group g, assign_scratch& s, assignment_context<Single> const& ctx) {
  int const numbers = ctx.numbers();
  int const n = ctx.windows.count[ctx.b];
  std::ptrdiff_t const at = ctx.b;
  open_points<Single> open{
      n <= assign_scratch::size ? s.open : ctx.work.open + at * ctx.work.capacity, 0, n,
      ctx.cameras(), ctx.partners() ? 1 : 0};
  int* const writer = owner_table(s, ctx);
  first_writes firsts(writer, second_table(s, ctx), numbers, n * open.writes());
  if (g.rank() == 0) { ctx.work.matches[ctx.b] = 0; }
  bool const packed = Single && in_scratch(ctx.frame) && n <= assign_scratch::size &&
                      ctx.params.kind == search_kind::local_map;
  if (packed) {
    if constexpr (Single) {
      if (take_packed_turns(g, s, ctx, n)) { return; }
    }
    list_open(g, s, ctx, open, false, [](int, point_choice const&) {});
  } else {
    list_open(g, s, ctx, open, false, [&](int p, point_choice const& first) {
      each_write(ctx, open, p, first, [&](int, int number, int w) { firsts.add(number, w); });
    });
  }
  g.sync();
  if (s.any_unobserved == 0) {
    firsts.next_turn(g, ctx, open);
    run_turns(g, s, ctx, open, firsts);
  } else {
    if (open.cameras() == 2) {
      list_open(g, s, ctx, open, true, [](int, point_choice const&) {});
    }
    write_chains const chains{
        writer,
        open.count * open.writes() <= assign_scratch::size ? s.before
                                                           : ctx.work.before + at * ctx.work.links,
        in_scratch(ctx.frame) ? s.held : ctx.work.held + at * numbers, numbers};
    for (int k = g.rank(); k < numbers; k += g.size()) {
      chains.held[k] = static_cast<std::uint8_t>(ctx.held(k));
    }
    chains.next_turn(g, ctx, open);
    run_turns(g, s, ctx, open, chains);
  }
}

}  // namespace detail

}  // namespace FT_ABI
}  // namespace ft
