// SPDX-License-Identifier: Apache-2.0
/// @file Scale pyramids of a batch of equally sized 8-bit images.
#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <string>
#include <type_traits>
#include <utility>

#include "ft/containers/columns.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/core/memory.hpp"
#include "ft/core/views.hpp"

namespace ft {
inline namespace FT_ABI {

inline constexpr int max_levels = 16;
inline constexpr int max_image_side = 16384;

/// Sizes, scales and offsets of the levels; passed to kernels by value.
/// Source: specification section 1.
struct pyramid_geometry {
  int levels = 0;
  float scale_factor = 0;
  int width[max_levels] = {};
  int height[max_levels] = {};
  int stride[max_levels] = {};             ///< bytes from row to row
  std::ptrdiff_t offset[max_levels] = {};  ///< of a level in an image's slab, bytes
  std::ptrdiff_t bytes = 0;                ///< of an image's slab
  float scale[max_levels] = {};            ///< 1, s, s^2, ... in float
  float inv_scale[max_levels] = {};
  float sigma2[max_levels] = {};  ///< scale^2
  float inv_sigma2[max_levels] = {};
  int tap_offset[max_levels] = {};  ///< first resize tap of a level: its columns, then its rows
  int taps = 0;
  /// How the position of a keypoint becomes one in the input image. False: it is one, as in
  /// ORB-SLAM3. True: it is that of the middle of the level's pixel, as build_pyramid() resizes.
  bool exact = false;

  /// Column and row in the input image of a keypoint, whose own are those at the level of its
  /// octave times `scale`. Pixels; 0 is the middle of the first one. Times `scale`, what the level
  /// shows is up to (scale - 1) / 2 pixels too far left and up, and a level's whole number of
  /// pixels changes its scale by up to half a pixel of the level.
  FT_HOST_DEVICE float column(float x, int octave) const {
    return exact ? resized(x, octave, width[0], width[octave]) : x;
  }
  FT_HOST_DEVICE float row(float y, int octave) const {
    return exact ? resized(y, octave, height[0], height[octave]) : y;
  }
  /// The depth that belongs to the disparity of column().
  FT_HOST_DEVICE float depth(float z, int octave) const {
    if (!exact) { return z; }
    strict_float const wide = static_cast<float>(width[octave]);
    return (strict_float(z) * (scale[octave] * wide / static_cast<float>(width[0]))).value;
  }

  /// Inverse of column(), row() and depth(), up to rounding: a place in the input image as that of
  /// a keypoint.
  FT_HOST_DEVICE float level_column(float x, int octave) const {
    return exact ? unresized(x, octave, width[0], width[octave]) : x;
  }
  FT_HOST_DEVICE float level_row(float y, int octave) const {
    return exact ? unresized(y, octave, height[0], height[octave]) : y;
  }
  FT_HOST_DEVICE float level_depth(float z, int octave) const {
    if (!exact) { return z; }
    strict_float const wide = static_cast<float>(width[octave]);
    return (strict_float(z) / (scale[octave] * wide / static_cast<float>(width[0]))).value;
  }

  /// Patch diameter of a keypoint of an octave, pixels of the input image.
  FT_HOST_DEVICE int patch_size(int octave) const {
    return static_cast<int>(detail::mul(31.0f, scale[octave]));
  }

  /// @param w,h input size, pixels, 1 to 16384 @param levels 1 to 16 @param factor 1.01 to 4
  /// @throws bad_argument outside these ranges, or if a level would have no pixel
  static pyramid_geometry make(int w, int h, int levels, float factor) {
    detail::require_range("image width", w, 1, max_image_side);
    detail::require_range("image height", h, 1, max_image_side);
    detail::require_range("pyramid levels", levels, 1, max_levels);
    detail::require_range("scale factor", factor, 1.01f, 4.0f);
    pyramid_geometry g;
    g.levels = levels;
    g.scale_factor = factor;
    for (int i = 0; i < levels; ++i) {
      g.scale[i] = i == 0 ? 1.0f : g.scale[i - 1] * factor;
      g.sigma2[i] = g.scale[i] * g.scale[i];
      g.inv_scale[i] = 1.0f / g.scale[i];
      g.inv_sigma2[i] = 1.0f / g.sigma2[i];
      g.width[i] =
          i == 0 ? w : static_cast<int>(std::lrint(static_cast<float>(w) * g.inv_scale[i]));
      g.height[i] =
          i == 0 ? h : static_cast<int>(std::lrint(static_cast<float>(h) * g.inv_scale[i]));
      if (!(g.width[i] >= 1 && g.height[i] >= 1)) {
        throw bad_argument("ft: levels is " + std::to_string(levels) +
                           ", too many for an image of " + std::to_string(w) + " x " +
                           std::to_string(h) + " pixels and scale_factor " +
                           detail::number_text(factor));
      }
      g.stride[i] = ceil_div(g.width[i], 64) * 64;
      g.offset[i] = g.bytes;
      g.bytes += static_cast<std::ptrdiff_t>(g.stride[i]) * g.height[i];
      g.tap_offset[i] = g.taps;
      if (i > 0) { g.taps += g.width[i] + g.height[i]; }
    }
    return g;
  }

private:
  /// @param from,to pixels of the input image and of the level along the axis
  FT_HOST_DEVICE float resized(float x, int octave, int from, int to) const {
    strict_float const ratio = strict_float(static_cast<float>(from)) / static_cast<float>(to);
    strict_float const middle = strict_float(x) * inv_scale[octave] + 0.5f;
    return (middle * ratio - 0.5f).value;
  }
  FT_HOST_DEVICE float unresized(float x, int octave, int from, int to) const {
    if (octave == 0) { return x; }
    strict_float const ratio = strict_float(static_cast<float>(from)) / static_cast<float>(to);
    return (((strict_float(x) + 0.5f) / ratio - 0.5f) * scale[octave]).value;
  }
};

/// Images of a batch that never come, the same ones in every rig: the right images of single
/// cameras. No stage computes anything of them.
struct absent_images {
  std::uint32_t mask = 0;  ///< bit i: image i of a rig is absent
  int period = 1;          ///< images of a rig, up to 32

  FT_HOST_DEVICE bool has(int image) const {
    return mask != 0 && (mask >> (image % period) & 1u) != 0;
  }
};

/// Levels of a batch of images, without borders.
struct image_pyramid_view {
  pyramid_geometry geometry;
  std::uint8_t* data = nullptr;
  int batch = 0;
  absent_images absent{};  ///< black

  template <typename Visit>
  void columns(Visit&& each) {
    each({batch, geometry.bytes}, data);
  }
  FT_HOST_DEVICE image_view<std::uint8_t> level(int image, int l) const {
    return {data + image * geometry.bytes + geometry.offset[l], geometry.width[l],
            geometry.height[l], geometry.stride[l]};
  }
};
static_assert(std::is_trivially_copyable<image_pyramid_view>::value, "passed to kernels");

/// Places a pyramid into an arena.
inline void carve(carver& c, image_pyramid_view& v, pyramid_geometry const& geometry, int batch) {
  v.geometry = geometry;
  v.batch = batch;
  detail::place_columns(c, v);
}

/// Owner of a pyramid; move-only.
template <memory_space Space>
class image_pyramid : public owner<image_pyramid_view, Space> {
public:
  image_pyramid() = default;
  /// @throws bad_argument for a batch below 1
  explicit image_pyramid(pyramid_geometry const& geometry, int batch = 1)
      : owner<image_pyramid_view, Space>([&](carver& c, image_pyramid_view& v) {
          detail::require(batch >= 1, "a pyramid needs a batch of 1 or more");
          carve(c, v, geometry, batch);
        }) {}
};

// Views of batches of equally sized images.

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
