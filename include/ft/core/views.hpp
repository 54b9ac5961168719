// SPDX-License-Identifier: Apache-2.0
/// @file Non-owning views, trivially copyable, passed to kernels by value.
#pragma once

#include <cstddef>
#include <cstdint>
#include <type_traits>

#include "ft/core/config.hpp"

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

/// A row-major image. `stride` is the distance between rows, in elements.
template <typename T>
struct image_view {
  T* data = nullptr;
  int width = 0;
  int height = 0;
  int stride = 0;

  FT_HOST_DEVICE T* row(int y) const {
    return data + static_cast<std::ptrdiff_t>(y) * static_cast<std::ptrdiff_t>(stride);
  }
  FT_HOST_DEVICE T& operator()(int x, int y) const { return row(y)[x]; }
  /// Conversion to a read-only view.
  template <typename U, typename = std::enable_if_t<std::is_same<U, T const>::value &&
                                                    !std::is_const<T>::value>>
  FT_HOST_DEVICE operator image_view<U>() const {  // NOLINT(google-explicit-constructor)
    return {data, width, height, stride};
  }
};

using gray_view = image_view<std::uint8_t const>;

static_assert(std::is_trivially_copyable<image_view<std::uint8_t>>::value, "passed to kernels");
static_assert(std::is_trivially_copyable<span<int>>::value, "passed to kernels");

}  // namespace FT_ABI
}  // namespace ft
