// SPDX-License-Identifier: Apache-2.0
/// @file Non-owning views, trivially copyable, passed to kernels by value.
#pragma once

#include <cstddef>
#include <type_traits>

#include "ft/core/config.hpp"
#include "ft/types/images.hpp"

namespace ft {
inline namespace FT_ABI {

/// `size` consecutive elements.
template <typename T>
struct span {
  T* data = nullptr;
  int size = 0;

  FT_HOST_DEVICE T& operator[](int i) const { return data[i]; }
  FT_HOST_DEVICE T* begin() const { return data; }
  FT_HOST_DEVICE T* end() const { return data + size; }
};

/// Rows of bytes whose starts are `pitch` bytes apart. @tparam T void or void const
template <typename T>
struct pitched_rows {
  T* data;
  std::size_t pitch;
};

static_assert(std::is_trivially_copyable<span<int>>::value, "passed to kernels");

}  // namespace FT_ABI
}  // namespace ft
