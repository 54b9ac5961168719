// SPDX-License-Identifier: Apache-2.0
/// @file Stages: what a functor must have, what it may have, and how it is launched.
///
/// A stage's body is a functor with a nested type `scratch` and
///
///     void operator()(group, scratch&, int item, args...) const
///
/// An executor runs it once per item, with the threads that the shape asks for: `per_thread`,
/// `per_warp` or `per_block<N>` on the device; on the host always one thread per item, items spread
/// over a pool. `scratch` is shared memory of a warp or a block, otherwise a local variable.
/// Optional members, the hooks of stage_traits:
///
/// | member                                  | effect                                             |
/// |-----------------------------------------|----------------------------------------------------|
/// | `prologue(group, scratch&, item, args)` | work that needs nothing of the preceding grid      |
/// | `std::size_t extra_bytes() const`       | dynamic shared memory of a block: `group.extra()`, |
/// |                                         | at most extra_scratch(); the host has none         |
/// | `static constexpr bool wide_on_host`    | also compiled for AVX2, chosen at run time         |
/// | `static constexpr int resident_blocks`  | that many blocks on a multiprocessor at least: a   |
/// |                                         | limit of registers. 0: no limit                    |
/// | `static constexpr bool prefers_shared`  | the largest share of shared memory. For launches   |
/// |                                         | that overlap: one that needs another split of a    |
/// |                                         | multiprocessor's memory waits until it is idle     |
///
/// The launch protocol. A launch of a recording may be resident while the preceding grid runs
/// (launch_order, above). Each group does, in this order:
/// 1. the prologue. It must not read what the preceding grid writes, or a grid that runs
///    concurrently with that. A prologue that returns void prepares its scratch from its arguments,
///    and may reset counters that only this launch and concurrent ones after it use. One that
///    returns bool may read memory that was complete before the preceding grid started;
///    false ends the item. The latter is for warps.
/// 2. the wait for the preceding grid, unless the launch is concurrent with it;
/// 3. the operator.
/// On the host, and outside recordings, the preceding work is complete before step 1.
#pragma once

#include <cstddef>
#include <type_traits>
#include <utility>

#include "ft/core/config.hpp"

namespace ft {
inline namespace FT_ABI {

// How a launch is ordered with respect to the preceding grid.

namespace detail {

/// An executor launches in the order that with_order(exec, order) gave it, serial by default. On
/// the host, and outside recordings, all three are stream order.
enum class launch_order {
  /// Waits for the preceding grid before it touches memory. In a recording the kernel is set up
  /// while that grid still runs (programmatic dependent launch), which saves about a microsecond.
  serial,
  /// Uses no output of the preceding grid except by signals, and runs concurrently with it: only
  /// grids that the preceding one waited for are complete. All blocks of that grid have started, so
  /// a concurrent launch may also wait for parts of its output (containers/frame_arrivals.hpp). It
  /// does not complete before that grid has, so a launch that waits for it waits for both. A
  /// side_branch does the same for more than one launch, but a launch that joins one was measured
  /// to start two microseconds late.
  concurrent,
  /// Starts when the preceding grid has completed. For grids of one full wave, whose blocks an
  /// early
  /// launch would spread unevenly over the multiprocessors, and where it was measured to be faster.
  full_wave,
};

}  // namespace detail

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

/// names_NAME<Op>: whether Op has a member of that name, of any kind: if it has, the name is
/// ambiguous in a type that also inherits another one.
#define FT_NAMES_MEMBER(NAME)                \
  struct has_##NAME {                        \
    int NAME;                                \
  };                                         \
  template <typename Op, typename = void>    \
  inline constexpr bool names_##NAME = true; \
  template <typename Op>                     \
  inline constexpr bool                      \
      names_##NAME<Op, std::void_t<decltype(&inherits_both<Op, has_##NAME>::NAME)>> = false;

template <typename Op, typename Other>
struct inherits_both : Op, Other {};

FT_NAMES_MEMBER(prologue)
FT_NAMES_MEMBER(extra_bytes)
FT_NAMES_MEMBER(wide_on_host)
FT_NAMES_MEMBER(resident_blocks)
FT_NAMES_MEMBER(prefers_shared)
// Names that are probably misspelt hooks.
FT_NAMES_MEMBER(prolog)
FT_NAMES_MEMBER(prepares)
FT_NAMES_MEMBER(begins_beside)
FT_NAMES_MEMBER(extra_byte)
FT_NAMES_MEMBER(shared_bytes)
FT_NAMES_MEMBER(side_by_side)
FT_NAMES_MEMBER(shares_multiprocessors)
#undef FT_NAMES_MEMBER

template <typename Op, typename = void>
inline constexpr bool has_scratch = false;
template <typename Op>
inline constexpr bool has_scratch<Op, std::void_t<typename Op::scratch>> = true;

template <typename Op, typename Group, typename... Args>
using stage_result =
    decltype(std::declval<Op const&>()(std::declval<Group>(), std::declval<typename Op::scratch&>(),
                                       int{}, std::declval<Args const&>()...));
template <typename Op, typename Group, typename Enable, typename... Args>
inline constexpr bool takes_item = false;
template <typename Op, typename Group, typename... Args>
inline constexpr bool
    takes_item<Op, Group, std::void_t<stage_result<Op, Group, Args...>>, Args...> = true;

/// Whether a functor can be run with these arguments; the compiler says what is missing.
template <typename Op, typename Group, typename... Args>
constexpr bool is_stage() {
  static_assert(has_scratch<Op>,
                "a stage's functor needs a public nested type scratch: "
                "using scratch = ft::no_scratch; see ft/core/stage.hpp");
  static_assert(!has_scratch<Op> || takes_item<Op, Group, void, Args...>,
                "a stage's functor needs void operator()(group, scratch&, int item, args...) "
                "const, public, with the arguments that for_each_item() was given after it; see "
                "ft/core/stage.hpp");
  return has_scratch<Op> && takes_item<Op, Group, void, Args...>;
}

/// The hooks of a functor. A hook of another type or signature does not compile.
template <typename Op>
struct stage_traits {
  static_assert(!std::is_final<Op>::value, "a stage's functor must not be final");
  static_assert(!names_prolog<Op> && !names_prepares<Op> && !names_begins_beside<Op>,
                "the hook of a stage for early work is called prologue");
  static_assert(!names_extra_byte<Op> && !names_shared_bytes<Op>,
                "the hook of a stage for dynamic shared memory is called extra_bytes");
  static_assert(!names_side_by_side<Op>,
                "the hook of a stage for its blocks per multiprocessor is called resident_blocks");
  static_assert(!names_shares_multiprocessors<Op>,
                "the hook of a stage for shared memory is called prefers_shared");

  static constexpr bool has_prologue = names_prologue<Op>;

  static constexpr bool wide_on_host = [] {
    if constexpr (names_wide_on_host<Op>) {
      static_assert(std::is_same<decltype(Op::wide_on_host), bool const>::value,
                    "wide_on_host is a static constexpr bool");
      return Op::wide_on_host;
    } else {
      return false;
    }
  }();
  static constexpr bool prefers_shared = [] {
    if constexpr (names_prefers_shared<Op>) {
      static_assert(std::is_same<decltype(Op::prefers_shared), bool const>::value,
                    "prefers_shared is a static constexpr bool");
      return Op::prefers_shared;
    } else {
      return false;
    }
  }();
  static constexpr int resident_blocks = [] {
    if constexpr (names_resident_blocks<Op>) {
      static_assert(std::is_same<decltype(Op::resident_blocks), int const>::value,
                    "resident_blocks is a static constexpr int");
      static_assert(Op::resident_blocks >= 0, "resident_blocks is a number of blocks, 0 for any");
      return Op::resident_blocks;
    } else {
      return 0;
    }
  }();

  static std::size_t extra_bytes(Op const& op) {
    if constexpr (names_extra_bytes<Op>) {
      static_assert(std::is_same<decltype(op.extra_bytes()), std::size_t>::value,
                    "extra_bytes() returns a std::size_t");
      return op.extra_bytes();
    } else {
      static_cast<void>(op);
      return 0;
    }
  }
};

template <typename Op, typename Group, typename... Args>
using prologue_result = decltype(std::declval<Op const&>().prologue(
    std::declval<Group>(), std::declval<typename Op::scratch&>(), int{},
    std::declval<Args const&>()...));

template <typename Op, typename Group, typename Enable, typename... Args>
inline constexpr bool takes_prologue = false;
template <typename Op, typename Group, typename... Args>
inline constexpr bool
    takes_prologue<Op, Group, std::void_t<prologue_result<Op, Group, Args...>>, Args...> = true;

/// Whether the prologue decides about the item.
template <typename Op, typename Group, typename... Args>
FT_HOST_DEVICE constexpr bool prologue_decides() {
  if constexpr (stage_traits<Op>::has_prologue) {
    static_assert(takes_prologue<Op, Group, void, Args...>,
                  "prologue must take what the operator takes: (group, scratch&, int, args...)");
    using result = prologue_result<Op, Group, Args...>;
    static_assert(std::is_same<result, void>::value || std::is_same<result, bool>::value,
                  "prologue returns void or bool");
    return std::is_same<result, bool>::value;
  } else {
    return false;
  }
}

/// Runs a functor's prologue, if it has one. Returns whether the item needs the operator.
template <typename Op, typename Group, typename... Args>
FT_HOST_DEVICE FT_INLINE bool run_prologue(Op const& op, Group g, typename Op::scratch& scratch,
                                           int item, Args const&... args) {
  if constexpr (prologue_decides<Op, Group, Args...>()) {
    return op.prologue(g, scratch, item, args...);
  } else if constexpr (stage_traits<Op>::has_prologue) {
    op.prologue(g, scratch, item, args...);
  }
  return true;
}

}  // namespace detail

}  // namespace FT_ABI
}  // namespace ft
