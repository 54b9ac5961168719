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
#include "ft/kernels/search/detail/choose.hpp"
#include "ft/kernels/search/detail/open_points.hpp"
#include "ft/kernels/search/detail/turns_single.hpp"
#include "ft/kernels/search/detail/writes.hpp"

namespace ft {
inline namespace FT_ABI {

namespace detail {

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
