// SPDX-License-Identifier: Apache-2.0
/// @file Stage: drops the corners that a mask excludes, before the distribution of the others.
#pragma once

#include <cstddef>
#include <cstdint>
#include <type_traits>

#include "ft/containers/columns.hpp"
#include "ft/containers/corners.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/types/images.hpp"

namespace ft {
inline namespace FT_ABI {

/// One mask per image of a batch. All masks have one size, which may differ from the images': a
/// mask is stretched over its image. 0 excludes corners; any other value allows them.
struct corner_masks_view {
  std::uint8_t* data = nullptr;  ///< [batch][height][width]; null = no masks
  int width = 0;
  int height = 0;
  int batch = 0;

  template <typename Visit>
  void columns(Visit&& each) {
    each({batch, height, width}, data);
  }
  FT_HOST_DEVICE image_view<std::uint8_t> mask(int image) const {
    return {data + static_cast<std::ptrdiff_t>(image) * width * height, width, height, width};
  }
  /// The mask pixel nearest to the centre of pixel (x, y) of a level of w x h pixels. Every level
  /// samples the full mask, so levels agree.
  FT_HOST_DEVICE bool allows(int image, int x, int y, int w, int h) const {
    return mask(image)((2 * x + 1) * width / (2 * w), (2 * y + 1) * height / (2 * h)) != 0;
  }
};
static_assert(std::is_trivially_copyable<corner_masks_view>::value, "passed to kernels");

/// Places the masks into an arena; none if width or height is 0.
inline void carve(carver& c, corner_masks_view& v, int width, int height, int batch) {
  if (width == 0 || height == 0) { return; }
  v.width = width;
  v.height = height;
  v.batch = batch;
  detail::place_columns(c, v);
}

namespace detail {

/// Compacts the list of one level of one image.
struct mask_level {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int item, pyramid_geometry const& geometry,
                                 corner_masks_view const& masks,
                                 corners_view const& corners) const {
    int const image = item / corners.layout.levels;
    int const l = item % corners.layout.levels;
    int const kept = keep_corners(
        g, corners.level_list(image, l), corners.list_count[item], [&](corner const& c) {
          return masks.allows(image, c.x + corner_border, c.y + corner_border, geometry.width[l],
                              geometry.height[l]);
        });
    if (g.rank() == 0) { corners.list_count[item] = kept; }
  }
};

}  // namespace detail

/// Drops the corners that the masks exclude from `corners.list`. A mask changes neither detection
/// nor a cell's choice of threshold: the result is a subset of the corners found without it.
/// Asynchronous on `exec`; allocates nothing; one launch.
template <typename Exec>
void mask_corners(Exec const& exec, pyramid_geometry const& geometry,
                  corner_masks_view const& masks, corners_view const& corners) {
  for_each_item<per_block<256>>(exec, corners.batch * corners.layout.levels, detail::mask_level{},
                                geometry, masks, corners);
}

}  // namespace FT_ABI
}  // namespace ft
