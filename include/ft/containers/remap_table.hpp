// SPDX-License-Identifier: Apache-2.0
/// @file Fixed-point maps from target to source pixels, for rectification.
#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <type_traits>
#include <utility>

#include "ft/containers/image_pyramid.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/core/memory.hpp"

namespace ft {
inline namespace FT_ABI {

/// Upper left source pixel of a target pixel. The four neighbours may lie outside the source.
struct remap_position {
  std::int16_t x, y;
};

/// Source position in units of 1/32 of a pixel. `fraction` is 32 * (y part) + (x part), 0 to 1023.
struct remap_entry {
  remap_position position;
  std::uint16_t fraction;

  /// A target pixel without a source. It lies outside every image, so it gets the border value.
  FT_HOST_DEVICE static constexpr remap_entry none() { return {{-32768, -32768}, 0}; }
};

namespace detail {

/// Rounds to 1/32, halves to even, and returns the number of 32nds. NaN and out of range give the
/// lowest int, as OpenCV's cvRound does on x86. Independent of the rounding mode.
FT_HOST_DEVICE inline int to_32nds(double v) {
  double const scaled = v * 32.0;  // exact
  if (!(scaled >= -2147483648.0 && scaled < 2147483647.5)) { return -2147483647 - 1; }
  double const below = ::floor(scaled);
  double const rest = scaled - below;  // exact
  int const i = static_cast<int>(below);
  return rest > 0.5 || (rest == 0.5 && (i & 1) != 0) ? i + 1 : i;
}

FT_HOST_DEVICE inline std::int16_t to_int16(int v) {
  return static_cast<std::int16_t>(clamp(v, -32768, 32767));
}

}  // namespace detail

/// Converts a source position in pixels to fixed point, as cv::convertMaps(CV_16SC2) does. (0, 0)
/// is the centre of the first pixel. NaN, infinity and other values out of range become -32768.
FT_HOST_DEVICE inline remap_entry make_remap_entry(double x, double y) {
  int const ix = detail::to_32nds(x);
  int const iy = detail::to_32nds(y);
  // A division that rounds down, without shifts of negative numbers.
  int const fx = ix & 31;
  int const fy = iy & 31;
  return {{detail::to_int16((ix - fx) / 32), detail::to_int16((iy - fy) / 32)},
          static_cast<std::uint16_t>(32 * fy + fx)};
}

/// Sizes of the images that a table maps between, pixels; each 1 to 16384.
struct remap_sizes {
  int width = 0;   ///< of the target
  int height = 0;  ///< of the target
  int source_width = 0;
  int source_height = 0;

  /// @throws bad_argument naming the value and the limit
  void check() const {
    detail::require_range("remap width", width, 1, max_image_side);
    detail::require_range("remap height", height, 1, max_image_side);
    detail::require_range("remap source width", source_width, 1, max_image_side);
    detail::require_range("remap source height", source_height, 1, max_image_side);
  }
};

/// Source position of every target pixel, row-major, one map per batch entry. Image i of a batch
/// uses map `i % batch`, so two maps serve any number of alternating left and right images.
struct remap_table_view {
  remap_sizes sizes;
  int batch = 0;
  remap_position* position = nullptr;  ///< [batch][height][width]
  std::uint16_t* fraction = nullptr;   ///< [batch][height][width]

  FT_HOST_DEVICE std::ptrdiff_t pixels() const {
    return static_cast<std::ptrdiff_t>(sizes.width) * sizes.height;
  }
  /// Batch entry b.
  FT_HOST_DEVICE remap_table_view slice(int b) const {
    return {sizes, 1, position + b * pixels(), fraction + b * pixels()};
  }
};
static_assert(std::is_trivially_copyable<remap_table_view>::value, "passed to kernels");

inline constexpr int max_remap_batch = 4096;

namespace detail {

inline void require_table(remap_table_view const& table) {
  require(table.position != nullptr && table.fraction != nullptr, "the remap table is null");
  table.sizes.check();
  require_range("remap table's batch", table.batch, 1, max_remap_batch);
}

}  // namespace detail

/// Places a table into an arena. @throws bad_argument for sizes or a batch out of range
inline void carve(carver& c, remap_table_view& v, remap_sizes const& sizes, int batch) {
  sizes.check();
  detail::require_range("remap table's batch", batch, 1, max_remap_batch);
  v.sizes = sizes;
  v.batch = batch;
  c.place({batch, v.pixels()}, v.position, v.fraction);
}

/// Owner of a table; move-only. Entries are not initialised.
template <memory_space Space>
class remap_table : public owner<remap_table_view, Space> {
public:
  remap_table() = default;
  /// @param batch maps, 1 to 4096 @throws bad_argument, std::bad_alloc, cuda_error
  explicit remap_table(remap_sizes const& sizes, int batch = 1)
      : owner<remap_table_view, Space>(
            [&](carver& c, remap_table_view& v) { carve(c, v, sizes, batch); }) {}
};

}  // namespace FT_ABI
}  // namespace ft
