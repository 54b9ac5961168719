// SPDX-License-Identifier: Apache-2.0
/// @file Views of batches of equally sized images.
#pragma once

#include <cstddef>
#include <cstdint>
#include <type_traits>

#include "ft/containers/image_pyramid.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/core/views.hpp"

namespace ft {
inline namespace FT_ABI {

/// Equally sized images at equal distances, measured in elements.
template <typename T>
struct image_batch_view {
  T* data = nullptr;
  int width = 0;
  int height = 0;
  int stride = 0;           ///< from row to row
  std::ptrdiff_t step = 0;  ///< from image to image
  int batch = 0;

  FT_HOST_DEVICE image_view<T> operator[](int image) const {
    return {data + image * step, width, height, stride};
  }
  /// Conversion to a read-only view.
  template <typename U, typename = std::enable_if_t<std::is_same<U, T const>::value &&
                                                    !std::is_const<T>::value>>
  FT_HOST_DEVICE operator image_batch_view<U>() const {  // NOLINT(google-explicit-constructor)
    return {data, width, height, stride, step, batch};
  }
};
static_assert(std::is_trivially_copyable<image_batch_view<std::uint8_t>>::value,
              "passed to kernels");

/// One level of every image of a pyramid. Rectification writes level 0 for extraction. A pyramid of
/// one level owns a batch of images.
inline image_batch_view<std::uint8_t> level_images(image_pyramid_view const& pyramid, int level) {
  detail::require_range("pyramid level", level, 0, pyramid.geometry.levels - 1);
  auto const first = pyramid.level(0, level);
  return {first.data,   first.width, first.height, first.stride, pyramid.geometry.bytes,
          pyramid.batch};
}

}  // namespace FT_ABI
}  // namespace ft
