// SPDX-License-Identifier: Apache-2.0
/// @file The bins of the sort by code: clearing, and the prefix sum of their counts.
#pragma once

#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/kernels/distribution/level_tree.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail::quadtree {

template <typename Group>
FT_HOST_DEVICE void clear_bins(Group g, int* bins, int n) {
  for (int i = g.rank(); i < n; i += g.size()) { bins[i] = 0; }
}

/// scan_bins() by one thread.
FT_HOST_DEVICE inline void scan_bins_alone(scratch& s, int* bins, int n) {
  int at = 0;
  for (int i = 0; i < n; ++i) {
    int const count = bins[i];
    if (count > crowded_bin) { s.crowded = 1; }
    bins[i] = at;
    at += count;
  }
}

/// scan_bins() by a block. A thread keeps its counts in registers, in quads that it loads at once;
/// the quads of a warp are consecutive.
/// @tparam Each most quads of a thread
template <int Each, typename Group>
FT_HOST_DEVICE void scan_quads(Group g, scratch& s, int* bins, int n) {
  struct alignas(16) quad {
    int of[4];
  };
  auto* const quads = reinterpret_cast<quad*>(bins);
  auto const part = g.part();
  int const width = part.size();
  int const chunk = ceil_div(n, g.parts());
  int const first = g.part_index() * chunk;
  int const end = min_of(first + chunk, n);
  quad q[Each];
  int sum[Each];
  int all = 0;
  int most = 0;
  FT_UNROLL
  for (int k = 0; k < Each; ++k) {
    int const i = first + k * width + part.rank();
    q[k] = {};
    if (i < end) { q[k] = quads[i]; }
    sum[k] = q[k].of[0] + q[k].of[1] + q[k].of[2] + q[k].of[3];
    all += sum[k];
    most = max_of(max_of(most, max_of(q[k].of[0], q[k].of[1])), max_of(q[k].of[2], q[k].of[3]));
  }
  if (most > crowded_bin) { s.crowded = 1; }
  int total = 0;
  int at = g.exclusive_scan(all, total);
  if constexpr (Each > 1) {
    int warp_at = part.shuffle(at, 0);
    FT_UNROLL
    for (int k = 0; k < Each; ++k) {
      sum[k] = part.exclusive_scan(sum[k], total) + warp_at;
      warp_at += total;
    }
  } else {
    sum[0] = at;
  }
  FT_UNROLL
  for (int k = 0; k < Each; ++k) {
    int const i = first + k * width + part.rank();
    at = sum[k];
    FT_UNROLL
    for (int& count : q[k].of) {
      int const here = count;
      count = at;
      at += here;
    }
    if (i < end) { quads[i] = q[k]; }
  }
}

/// Replaces the counts of n bins by the sums of the lower ones, and sets `s.crowded` if a bin has
/// more than `crowded_bin` points. @param bins up to the next multiple of 4
template <typename Group>
FT_HOST_DEVICE void scan_bins(Group g, scratch& s, int* bins, int n) {
  int const quads = ceil_div(n, 4);
  if constexpr (Group::max_threads == 1) {
    scan_bins_alone(s, bins, 4 * quads);
  } else {
    constexpr int most_quads = more_bins / 4 / Group::max_threads;
    static_assert(4 * most_quads * Group::max_threads == more_bins, "whole quads");
    if (quads > g.size()) {
      scan_quads<most_quads>(g, s, bins, quads);
    } else {
      scan_quads<1>(g, s, bins, quads);
    }
  }
}

}  // namespace detail::quadtree
}  // namespace FT_ABI
}  // namespace ft
