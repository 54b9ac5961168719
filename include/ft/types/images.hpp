// SPDX-License-Identifier: Apache-2.0
/// @file Images in memory, and those of a frame by the kind of its rig.
#pragma once

#include <cstddef>
#include <cstdint>
#include <type_traits>

#include "ft/core/config.hpp"

namespace ft {
inline namespace v0 {

/// A row-major image. `stride` is the distance between rows, in elements.
template <typename T>
struct image_view {
  T* data = nullptr;
  int width = 0;
  int height = 0;
  int stride = 0;

  FT_HOST_DEVICE FT_INLINE T* row(int y) const {
    return data + static_cast<std::ptrdiff_t>(y) * static_cast<std::ptrdiff_t>(stride);
  }
  FT_HOST_DEVICE FT_INLINE T& operator()(int x, int y) const { return row(y)[x]; }
  /// Conversion to a read-only view.
  template <typename U, typename = std::enable_if_t<std::is_same<U, T const>::value &&
                                                    !std::is_const<T>::value>>
  FT_HOST_DEVICE FT_INLINE operator image_view<U>() const {  // NOLINT(google-explicit-constructor)
    return {data, width, height, stride};
  }
};

using gray_view = image_view<std::uint8_t const>;
static_assert(std::is_trivially_copyable<image_view<std::uint8_t>>::value, "passed to kernels");

/// A depth image of 16-bit integers or floats, registered to a grey one.
struct depth_view {
  void const* data = nullptr;
  int width = 0;
  int height = 0;
  std::ptrdiff_t pitch = 0;  ///< bytes from row to row
  bool is_float = false;

  depth_view() = default;
  depth_view(image_view<std::uint16_t const> const& of)  // NOLINT(google-explicit-constructor)
      : depth_view(of, false) {}
  depth_view(image_view<float const> const& of)  // NOLINT(google-explicit-constructor)
      : depth_view(of, true) {}

private:
  template <typename T>
  depth_view(image_view<T const> const& of, bool floats)
      : data(of.data),
        width(of.width),
        height(of.height),
        pitch(static_cast<std::ptrdiff_t>(of.stride) * static_cast<std::ptrdiff_t>(sizeof(T))),
        is_float(floats) {}
};

/// The images of one camera pair: grey, of the size that the odometry was made for, or of the raw
/// images of a distorted_pair. They are read
/// in place if the executor's threads can read them and if address and stride are multiples of 16,
/// and copied otherwise.
struct stereo_images {
  gray_view left;
  gray_view right;

  gray_view const& operator[](int i) const { return i == 0 ? left : right; }
};

/// The same of a multi_rig: image 2 c is that of camera c, image 2 c + 1 the right one of its pair,
/// not read for a single camera. An image whose data is null is missing in this frame; a
/// multi_rig<1> needs both of its pair.
template <int N>
struct rig_images {
  gray_view of[N];

  gray_view const& operator[](int i) const { return of[i]; }
};

/// The same of a mixed_rig: image 2 c + 1 only of a rectified pair, and the depth images of the
/// cameras that have one, as in rgbd_images. An image whose data is null is missing in this frame:
/// tracking::missing_images, missing_depths.
template <int N>
struct mixed_images {
  gray_view of[2 * N];
  depth_view depth[N];
};

/// The images of an rgbd_rig. Both have the size that the odometry was made for. The depth image is
/// registered to the grey one: its pixels are depths along the axis of the same camera, in units of
/// rgbd_rig::depth_scale. A pixel that is 0, negative, infinite or NaN has no depth. The executor
/// reads it in place if it can.
struct rgbd_images {
  gray_view gray;
  depth_view depth;
};

}  // namespace v0
}  // namespace ft
