// SPDX-License-Identifier: Apache-2.0
/// @file What follows from a view's list of its arrays: their places, values, slices and copies.
///
/// A view is a structure of pointers. Its member columns() calls a visitor with the extent and the
/// arrays that have it, in the order in which they lie in memory:
///
///     template <typename Visit>
///     void columns(Visit&& each) {
///       each({batch}, made, count);
///       each({batch, positions}, T_cw, time_ns);
///     }
///
/// The first axis is the same in all of them. A view of views calls their columns().
#pragma once

#include <cstddef>

#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// Calls visit(array, extent) for each array of a view.
template <typename View, typename Visit>
void each_column(View& v, Visit const& visit) {
  v.columns([&](extent const& e, auto*&... arrays) { (visit(arrays, e), ...); });
}

/// Places all arrays into an arena. @param v its sizes are set
template <typename View>
void place_columns(carver& c, View& v) {
  v.columns([&](extent const& e, auto*&... arrays) { c.place(e, arrays...); });
}

/// Sets all bytes of all arrays. Asynchronous if the executor is; allocates nothing.
template <typename Exec, typename View>
void fill_columns(Exec const& exec, View v, int value) {
  each_column(v, [&](auto* array, extent const& e) {
    fill_bytes(exec, array, value, e.size() * sizeof *array);
  });
}

/// The view without its first entries. Its sizes are those of before.
template <typename View>
View skip_entries(View v, int entries) {
  each_column(v, [&](auto*& array, extent const& e) {
    if (array != nullptr) { array += static_cast<std::size_t>(entries) * e.each; }
  });
  return v;
}

/// Entries `first` to first + count - 1 of a view.
template <typename View>
View entries_of(View const& v, int first, int count) {
  View part = skip_entries(v, first);
  part.batch = count;
  return part;
}

/// Copies all arrays of a view to those of another one with the same sizes, in any spaces.
/// Asynchronous if the executor is; allocates nothing.
template <typename Exec, typename View>
void copy_columns(Exec const& exec, View to, View from) {
  int at = 0;
  each_column(to, [&](auto* array, extent const& e) {
    void const* source = nullptr;
    int next = 0;
    each_column(from, [&](auto* other, extent const&) {
      if (next++ == at) { source = other; }
    });
    copy_bytes(exec, array, source, e.size() * sizeof *array);
    ++at;
  });
}

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
