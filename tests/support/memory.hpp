// SPDX-License-Identifier: Apache-2.0
/// @file Copies to and from an executor's memory, and their comparison.
#pragma once

#include <cstddef>
#include <cstring>
#include <vector>

#include "ft/containers/keypoints.hpp"
#include "ft/containers/soa.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"

namespace test {

/// A copy of `values` in an executor's memory.
template <typename T, typename Exec>
ft::buffer<T, Exec::space> to_exec(Exec const& exec, std::vector<T> const& values) {
  ft::buffer<T, Exec::space> memory(values.size());
  ft::copy(exec, memory.data(), values.data(), values.size());
  exec.wait();
  return memory;
}

template <typename T, typename Exec>
std::vector<T> from_exec(Exec const& exec, T const* data, std::size_t count) {
  std::vector<T> values(count);
  ft::copy(exec, values.data(), data, count);
  exec.wait();
  return values;
}

/// All of it.
template <typename T, ft::memory_space Space, typename Exec>
std::vector<T> from_exec(Exec const& exec, ft::buffer<T, Space> const& memory) {
  return from_exec(exec, memory.data(), memory.size());
}

template <typename T>
bool same_bits(std::vector<T> const& a, std::vector<T> const& b) {
  return a.size() == b.size() &&
         (a.empty() || std::memcmp(a.data(), b.data(), a.size() * sizeof(T)) == 0);
}

/// Waits, then reads one column of a container: all batch entries, capacity each.
template <typename Field, typename Exec, typename View>
std::vector<typename Field::type> column(Exec const& exec, View const& view) {
  return from_exec(exec, static_cast<typename Field::type const*>(ft::array_of<Field>(view)),
                   static_cast<std::size_t>(view.capacity) * static_cast<std::size_t>(view.batch));
}

/// Columns [batch][capacity] and counts into a container of pixels.
template <typename Exec, typename View>
void set_pixels(Exec const& exec, View const& view, std::vector<float> const& x,
                std::vector<float> const& y, std::vector<int> const& count) {
  ft::copy(exec, ft::array_of<ft::field::x>(view), x.data(), x.size());
  ft::copy(exec, ft::array_of<ft::field::y>(view), y.data(), y.size());
  ft::copy(exec, view.count, count.data(), count.size());
  exec.wait();
}

}  // namespace test
