// SPDX-License-Identifier: Apache-2.0
/// @file Sums whose order of additions is fixed: the same bits for any executor and on every run.
#pragma once

#include "ft/core/config.hpp"
#include "ft/core/group.hpp"

namespace ft {
inline namespace FT_ABI {

/// Terms are dealt to this many lanes (i to lane i mod 128), lanes are added in a fixed tree.
inline constexpr int sum_lanes = 128;

/// Block scratch of ordered_sum.
template <int K>
struct ordered_sum_scratch {
  double warp[sum_lanes / 32][K];
};

/// K sums over i in [0, n): `add(i, acc)` adds term i to `double acc[K]`. Every thread gets the
/// result. Groups of one thread or of 128.
template <int K, typename Group, typename Add>
FT_HOST_DEVICE void ordered_sum(Group g, ordered_sum_scratch<K>& scratch, int n, Add const& add,
                                double (&result)[K]) {
  if constexpr (Group::max_threads == 1) {
    static_cast<void>(g);
    static_cast<void>(scratch);
    double acc[sum_lanes][K] = {};
    for (int i = 0; i < n; ++i) { add(i, acc[i % sum_lanes]); }
    for (int w = 0; w < sum_lanes; w += 32) {
      for (int d = 16; d > 0; d /= 2) {
        for (int lane = 0; lane < d; ++lane) {
          for (int k = 0; k < K; ++k) { acc[w + lane][k] += acc[w + lane + d][k]; }
        }
      }
    }
    for (int k = 0; k < K; ++k) {
      result[k] = acc[0][k];
      for (int w = 32; w < sum_lanes; w += 32) { result[k] += acc[w][k]; }
    }
  } else {
    static_assert(Group::max_threads == sum_lanes, "one thread per lane");
    double acc[K];
    FT_UNROLL
    for (int k = 0; k < K; ++k) { acc[k] = 0; }
    for (int i = g.rank(); i < n; i += g.size()) { add(i, acc); }
#if defined(__CUDACC__)
    FT_UNROLL
    for (int k = 0; k < K; ++k) { acc[k] = detail::warp_reduce(acc[k], sum_op{}); }
#endif
    if (g.rank() % 32 == 0) {
      FT_UNROLL
      for (int k = 0; k < K; ++k) { scratch.warp[g.rank() / 32][k] = acc[k]; }
    }
    g.sync();
    FT_UNROLL
    for (int k = 0; k < K; ++k) {
      result[k] = scratch.warp[0][k];
      for (int w = 1; w < sum_lanes / 32; ++w) { result[k] += scratch.warp[w][k]; }
    }
    g.sync();
  }
}

}  // namespace FT_ABI
}  // namespace ft
