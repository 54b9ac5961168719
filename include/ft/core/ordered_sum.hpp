// SPDX-License-Identifier: Apache-2.0
/// @file Sums with a fixed order of additions: the same bits on every executor and on every run.
#pragma once

#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/group.hpp"

namespace ft {
inline namespace FT_ABI {

/// Number of lanes. Term i goes to lane i mod 512. Each 32 lanes are added in a fixed tree, upper
/// half to lower half; then the 16 sums are added in order. By hand, because CUB does not fix the
/// order.
inline constexpr int sum_lanes = 512;

/// K summands. @tparam T float or double
template <int K, typename T = float>
struct sum_terms {
  static_assert(K >= 1 && K <= 32, "one entry a lane");
  T of[K];
};

/// Scratch of ordered_sum, and its result.
/// @tparam T of the sums of 32 lanes @tparam Total of the sums of these
template <int K, typename T = float, typename Total = T>
struct ordered_sum_scratch {
  sum_terms<K, T> warp[sum_lanes / 32];
  sum_terms<K, Total> total;
};

namespace detail {

/// K sums by one thread. It completes 32 lanes before the next 32, so that they stay in the L1
/// cache.
template <int K, typename T, typename Total, typename Add>
FT_HOST_DEVICE void sum_by_warps(sum_terms<K, Total>& total, int n, Add const& add) {
  auto const into = [](auto& to, sum_terms<K, T> const& from) {
    for (int k = 0; k < K; ++k) { to.of[k] += from.of[k]; }
  };
  total = {};
  for (int first = 0; first < min_of(n, sum_lanes); first += 32) {
    sum_terms<K, T> lanes[32] = {};
    int const used = min_of(n - first, 32);
    for (int lane = 0; lane < used; ++lane) {
      for (int i = first + lane; i < n; i += sum_lanes) { add(i, lanes[lane]); }
    }
    for (int d = 16; d > 0; d /= 2) {
      // Lanes without a term hold zeros: nothing to add.
      for (int lane = 0; lane < d && lane + d < used; ++lane) {
        into(lanes[lane], lanes[lane + d]);
      }
    }
    into(total, lanes[0]);
  }
}

#if defined(__CUDACC__)
/// One step of transposed_warp_sum(): reduces K values to min(K, D). Recursive, because a loop over
/// D that is not unrolled would put the values into local memory.
template <int D, int K, typename T, int Size>
__device__ void halve_values(T (&v)[Size], int lane) {
  bool const upper = (lane & D) != 0;
  FT_UNROLL
  for (int i = 0; i < min_of(D, K); ++i) {
    T give = v[i];
    T keep = v[i];
    // Otherwise the upper lanes get values that are never used.
    if (i + D < K) {
      give = upper ? v[i] : v[i + D];
      keep = upper ? v[i + D] : v[i];
    }
    v[i] = keep + __shfl_xor_sync(0xffffffffu, give, D);
  }
  if constexpr (D > 1) { halve_values<D / 2, min_of(D, K)>(v, lane); }
}

/// Sums K <= 32 values over the lanes of a warp; value k ends in lane k. Each step halves the
/// number of values per lane, so 31 exchanges replace the 160 of 32 butterflies, in the same order.
template <int K, typename T>
__device__ T transposed_warp_sum(T (&v)[K], int lane) {
  halve_values<16, K>(v, lane);
  return v[0];
}
#endif

}  // namespace detail

/// K sums over i in [0, n). The result is `scratch.total`, for every thread, until the next call.
/// Groups have one thread or sum_lanes.
/// @param add add(i, sum_terms<K, T>& acc) adds term i
/// @param then then() is run by the first thread once the sums are known, while the others wait
template <int K, typename T, typename Total, typename Group, typename Add, typename Then>
FT_HOST_DEVICE void ordered_sum(Group g, ordered_sum_scratch<K, T, Total>& scratch, int n,
                                Add const& add, Then const& then) {
  if constexpr (Group::max_threads == 1) {
    static_cast<void>(g);
    detail::sum_by_warps<K, T>(scratch.total, n, add);
    then();
  } else {
    static_assert(Group::max_threads == sum_lanes, "one thread per lane");
#if defined(__CUDACC__)
    int const lane = g.rank() % 32;
    int const warp = g.rank() / 32;
    T mine = 0;
    if (warp * 32 < n) {
      // -0 plus the first term is exactly that term. A -0 that remains at the end disappears in the
      // final sum, which starts with 0.
      sum_terms<K, T> acc;
      FT_UNROLL
      for (int k = 0; k < K; ++k) { acc.of[k] = T(-0.0f); }
      if (g.rank() < n) { add(g.rank(), acc); }
      for (int i = g.rank() + g.size(); i < n; i += g.size()) { add(i, acc); }
      mine = detail::transposed_warp_sum(acc.of, lane);
    }
    if (lane < K) { scratch.warp[warp].of[lane] = mine; }
    g.sync();
    if (warp == 0) {
      if (lane < K) {
        Total sum = 0;
        FT_UNROLL
        for (int w = 0; w < sum_lanes / 32; ++w) { sum += scratch.warp[w].of[lane]; }
        scratch.total.of[lane] = sum;
      }
      g.part().sync();
      if (lane == 0) { then(); }
    }
    g.sync();
#endif
  }
}
template <int K, typename T, typename Total, typename Group, typename Add>
FT_HOST_DEVICE void ordered_sum(Group g, ordered_sum_scratch<K, T, Total>& scratch, int n,
                                Add const& add) {
  ordered_sum(g, scratch, n, add, [] {});
}

}  // namespace FT_ABI
}  // namespace ft
