// SPDX-License-Identifier: Apache-2.0
/// @file The assignment as a plain loop.
#pragma once

#include "ft/core/config.hpp"
#include "ft/kernels/search/assignment_context.hpp"
#include "ft/kernels/search/choose.hpp"

namespace ft {
inline namespace FT_ABI {

namespace detail {

template <bool Single>
FT_HOST_DEVICE void one_after_another(assignment_context<Single> const& ctx) {
  int const numbers = ctx.numbers();
  for (int k = 0; ctx.params.from_empty && k < numbers; ++k) { ctx.holder[k] = -1; }
  int taken = 0;
  bool guests = false;  // what was taken may not be any more
  for (int i = 0; i < ctx.windows.count[ctx.b]; ++i) {
    bool refused = false;
    for (int c = 0; c < ctx.cameras(); ++c) {
      bool const any = has_candidates(ctx.list_count(c, i), guests);
      int const k = choose(ctx, c, i, window_list(ctx, c, i, any, guests), refused,
                           [&](int number, bool) { return ctx.observed(ctx.holder[number]); });
      ctx.match(c, i) = k;
      if (k < 0) { continue; }
      guests = guests || !ctx.observed(ctx.slot(c, i));
      int const partner = ctx.partner_of(ctx.number(c, k));
      ctx.holder[ctx.number(c, k)] = ctx.slot(c, i);
      if (partner >= 0) { ctx.holder[partner] = ctx.slot(c, i); }
      taken += partner >= 0 ? 2 : 1;
    }
  }
  ctx.work.matches[ctx.b] = taken;
}

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
