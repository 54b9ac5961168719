// SPDX-License-Identifier: Apache-2.0
/// @file Sums whose order of additions is fixed: the same bits for any executor and on every run.
#pragma once

#include "ft/core/config.hpp"
#include "ft/core/group.hpp"

namespace ft {
inline namespace FT_ABI {

/// Terms are dealt to this many lanes (i to lane i mod 512); in each 32 lanes the upper half of
/// what is left is added to the lower one; then the 16 sums are added in order.
inline constexpr int sum_lanes = 512;

/// K numbers to add up.
template <int K>
struct sum_terms {
  static_assert(K >= 1 && K <= 32, "one entry a lane");
  float of[K];
};

/// Block scratch of ordered_sum, and its result.
template <int K>
struct ordered_sum_scratch {
  sum_terms<K> warp[sum_lanes / 32];
  sum_terms<K> total;
};

#if defined(__CUDACC__)
namespace detail {

/// One step of transposed_warp_sum: 2 D values become D. Recursive, as a loop over D may stay a
/// loop and put the values into memory.
template <int D>
__device__ void halve_values(float (&v)[32], int lane) {
  bool const upper = (lane & D) != 0;
  FT_UNROLL
  for (int i = 0; i < D; ++i) {
    float const give = upper ? v[i] : v[i + D];
    float const keep = upper ? v[i + D] : v[i];
    v[i] = keep + __shfl_xor_sync(0xffffffffu, give, D);
  }
  if constexpr (D > 1) { halve_values<D / 2>(v, lane); }
}

/// Adds 32 values over the lanes of a warp, value k ending in lane k: each step halves the values
/// that a lane keeps, so that 31 exchanges do what 32 butterflies do with 160, in the same order.
__device__ inline float transposed_warp_sum(float (&v)[32], int lane) {
  halve_values<16>(v, lane);
  return v[0];
}

}  // namespace detail
#endif

/// K sums over i in [0, n): `add(i, sum_terms<K>& acc)` adds term i. The result is
/// `scratch.total`, for every thread, until the next call. Groups of one thread or of sum_lanes.
template <int K, typename Group, typename Add>
FT_HOST_DEVICE void ordered_sum(Group g, ordered_sum_scratch<K>& scratch, int n, Add const& add) {
  if constexpr (Group::max_threads == 1) {
    static_cast<void>(g);
    sum_terms<K> acc[sum_lanes] = {};
    for (int i = 0; i < n; ++i) { add(i, acc[i % sum_lanes]); }
    auto const into = [](sum_terms<K>& to, sum_terms<K> const& from) {
      for (int k = 0; k < K; ++k) { to.of[k] += from.of[k]; }
    };
    for (int w = 0; w < sum_lanes; w += 32) {
      for (int d = 16; d > 0; d /= 2) {
        // Lanes without a term hold zeros: nothing to add.
        for (int lane = 0; lane < d && w + lane + d < n; ++lane) {
          into(acc[w + lane], acc[w + lane + d]);
        }
      }
    }
    scratch.total = acc[0];
    for (int w = 32; w < sum_lanes; w += 32) { into(scratch.total, acc[w]); }
  } else {
    static_assert(Group::max_threads == sum_lanes, "one thread per lane");
#if defined(__CUDACC__)
    sum_terms<K> acc{};
    for (int i = g.rank(); i < n; i += g.size()) { add(i, acc); }
    float terms[32];
    FT_UNROLL
    for (int k = 0; k < 32; ++k) { terms[k] = k < K ? acc.of[k] : 0.0f; }
    int const lane = g.rank() % 32;
    int const warp = g.rank() / 32;
    float const mine = detail::transposed_warp_sum(terms, lane);
    if (lane < K) { scratch.warp[warp].of[lane] = mine; }
    g.sync();
    if (g.rank() < K) {
      float sum = scratch.warp[0].of[g.rank()];
      FT_UNROLL
      for (int w = 1; w < sum_lanes / 32; ++w) { sum += scratch.warp[w].of[g.rank()]; }
      scratch.total.of[g.rank()] = sum;
    }
    g.sync();
#endif
  }
}

}  // namespace FT_ABI
}  // namespace ft
