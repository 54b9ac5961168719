// SPDX-License-Identifier: Apache-2.0
/// @file The greedy assignment as a loop over the points, by one thread.
#pragma once

#include "ft/core/config.hpp"
#include "ft/kernels/search/detail/assignment_context.hpp"
#include "ft/kernels/search/detail/choose.hpp"

namespace ft {
inline namespace FT_ABI {

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

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
