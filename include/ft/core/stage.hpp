// SPDX-License-Identifier: Apache-2.0
/// @file Stages: what a functor must and may have, and the shapes it is launched in.
///
/// A stage's body is a functor `op(group, scratch, item, args...)` with a nested type `scratch`.
/// An executor runs it once per item, with the threads that the shape asks for: `per_thread`,
/// `per_warp` or `per_block<N>` on the device; on the host always one thread per item, items spread
/// over a pool.
#pragma once

#include <cstddef>
#include <type_traits>
#include <utility>

#include "ft/core/config.hpp"

namespace ft {
inline namespace FT_ABI {

/// Device: one thread per item.
struct per_thread {};
/// Device: one warp per item.
struct per_warp {};
/// Device: one block of N threads per item.
template <int N>
struct per_block {};

/// For functors without scratch memory.
struct no_scratch {};

namespace detail {

/// Whether a functor for blocks has a prologue: it says `static constexpr bool prepares = true` and
/// has a member `prepare(group, scratch, item, args...)`. It runs before the block waits for the
/// preceding grid, and must not read what that grid writes.
template <typename Op, typename = void>
inline constexpr bool prepares = false;
template <typename Op>
inline constexpr bool prepares<Op, std::enable_if_t<Op::prepares>> = true;

/// Whether a functor for warps has a prologue: it says `static constexpr bool begins_beside = true`
/// and has a member `bool begin(group, scratch, item, args...)`. In a launch that is concurrent
/// with the preceding grid it runs before the wait for that grid. Returning false ends the item.
template <typename Op, typename = void>
inline constexpr bool begins_beside = false;
template <typename Op>
inline constexpr bool begins_beside<Op, std::enable_if_t<Op::begins_beside>> = true;

/// Runs a functor's prologue, if it has one. Returns whether the item needs the functor itself.
template <typename Op, typename Group, typename... Args>
FT_HOST_DEVICE FT_INLINE bool run_prologue(Op const& op, Group g, typename Op::scratch& scratch,
                                           int item, Args const&... args) {
  if constexpr (prepares<Op>) { op.prepare(g, scratch, item, args...); }
  if constexpr (begins_beside<Op>) { return op.begin(g, scratch, item, args...); }
  return true;
}

/// Stages that say `static constexpr bool wide_on_host = true` run, on the host, in a version for
/// wide vectors where the processor has them.
template <typename Op, typename = void>
inline constexpr bool is_wide_on_host = false;
template <typename Op>
inline constexpr bool is_wide_on_host<Op, std::enable_if_t<Op::wide_on_host>> = true;

/// Functors whose launches overlap say `static constexpr bool shares_multiprocessors = true`: a
/// kernel that needs another split of a multiprocessor's memory into cache and shared memory than
/// the present one would wait until the multiprocessor is idle.
template <typename Op, typename = void>
inline constexpr bool shares_multiprocessors = false;
template <typename Op>
inline constexpr bool shares_multiprocessors<Op, std::enable_if_t<Op::shares_multiprocessors>> =
    true;

/// How many blocks of a functor a multiprocessor should hold at least (`side_by_side`): a limit of
/// registers; 0 without one.
template <typename Op, typename = void>
inline constexpr int blocks_side_by_side = 0;
template <typename Op>
inline constexpr int blocks_side_by_side<Op, std::enable_if_t<(Op::side_by_side > 0)>> =
    int{Op::side_by_side};

/// Dynamic shared memory of a functor for blocks: its extra_bytes(), if it has that.
template <typename Op, typename = void>
struct extra_bytes_of {
  static std::size_t get(Op const&) { return 0; }
};
template <typename Op>
struct extra_bytes_of<Op, decltype(static_cast<void>(std::declval<Op const&>().extra_bytes()))> {
  static std::size_t get(Op const& op) { return op.extra_bytes(); }
};

}  // namespace detail

/// No items of another stage.
struct no_items {
  FT_HOST_DEVICE static int count() { return 0; }
  FT_HOST_DEVICE void operator()(int /*item*/) const {}
};

/// Fuses a small elementwise job into another stage's launch: its groups first do also(i) for all
/// i < also.count(). Saves a launch, and a wait for what would be concurrent.
template <typename Op, typename Also>
struct with_small_items {
  static constexpr bool wide_on_host = detail::is_wide_on_host<Op>;
  using scratch = typename Op::scratch;
  Op op;
  Also also;
  int items;  ///< of the launch

  template <typename Group, typename... Args>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int item, Args const&... args) const {
    for (int i = item * g.size() + g.rank(); i < also.count(); i += items * g.size()) { also(i); }
    op(g, s, item, args...);
  }
};

}  // namespace FT_ABI
}  // namespace ft
