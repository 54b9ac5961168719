// SPDX-License-Identifier: Apache-2.0
/// @file Stage: drops corners that lie on an edge, along which they can be anywhere: of a straight
/// edge the pixels make corners that wander along it as the camera moves. Sources: the structure
/// tensor of Harris and Stephens, "A combined corner and edge detector", 1988; the test by trace
/// and determinant of Lowe, "Distinctive image features from scale-invariant keypoints", IJCV 2004,
/// section 4.1.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>

#include "ft/containers/corners.hpp"
#include "ft/containers/image_pyramid.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/core/execution.hpp"
#include "ft/kernels/detail/packed_pixels.hpp"
#include "ft/kernels/distribution/layout.hpp"
#include "ft/types/images.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// Sums of the products of grey value differences over a square around a pixel.
struct structure_tensor {
  static constexpr int radius = 3;  ///< of the square: that of the corner test's circle
  int xx = 0, xy = 0, yy = 0;

  /// @pre (x, y) is more than radius + 3 pixels from the border of the image
  FT_HOST_DEVICE static structure_tensor at(gray_view image, int x, int y) {
    structure_tensor t;
    row_of_pixels above(image, x, y - radius - 1), row(image, x, y - radius);
    FT_UNROLL
    for (int j = -radius; j <= radius; ++j) {
      row_of_pixels const below(image, x, y + j + 1);
      FT_UNROLL
      for (int i = -radius; i <= radius; ++i) {
        int const gx = row[i + 1] - row[i - 1];
        int const gy = below[i] - above[i];
        t.xx += gx * gx;
        t.xy += gx * gy;
        t.yy += gy * gy;
      }
      above = row;
      row = below;
    }
    return t;
  }
  /// Whether the smaller eigenvalue is at least r times the larger one, by the limit r / (1 + r)^2
  /// of determinant by squared trace. All numbers but the limit are exact.
  FT_HOST_DEVICE bool is_corner(double limit) const {
    std::int64_t const trace = std::int64_t{xx} + yy;
    std::int64_t const determinant = std::int64_t{xx} * yy - std::int64_t{xy} * xy;
    return static_cast<double>(determinant) >= limit * static_cast<double>(trace * trace);
  }

private:
  /// Nine pixels around column x of a row, by words where a device can.
  class row_of_pixels {
  public:
    FT_HOST_DEVICE row_of_pixels(gray_view image, int x, int y) {
      std::uint8_t const* const first = image.row(y) + x - radius - 1;
#if defined(__CUDA_ARCH__)
      auto const skew = static_cast<int>(reinterpret_cast<std::uintptr_t>(first) & 3u);
      std::uint32_t const a = load_word(first - skew), b = load_word(first - skew + 4),
                          c = load_word(first - skew + 8);
      words_[0] = bytes_from(a, b, skew);
      words_[1] = bytes_from(b, c, skew);
      words_[2] = bytes_from(c, c, skew);
#else
      std::memcpy(words_, first, 2 * radius + 3);
#endif
    }
    /// @param i -radius - 1 to radius + 1
    FT_HOST_DEVICE int operator[](int i) const {
      int const at = i + radius + 1;
      return static_cast<int>(words_[at / 4] >> at % 4 * 8 & 0xffu);
    }

  private:
    std::uint32_t words_[3] = {};
  };
};

/// Item: a level of an image. Compacts its list.
struct drop_edges_of_level {
  using scratch = no_scratch;
  double limit;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int item, image_pyramid_view const& pyramid,
                                 distribution_view const& v) const {
    int const image = item / v.layout.levels;
    int const l = item % v.layout.levels;
    corner* const list =
        v.kept + static_cast<std::ptrdiff_t>(image) * v.layout.total + v.layout.first[l];
    gray_view const level = pyramid.level(image, l);
    int const kept = keep_corners(g, list, v.kept_count[item], [&](corner const& c) {
      return structure_tensor::at(level, c.x + corner_border, c.y + corner_border).is_corner(limit);
    });
    if (g.rank() == 0) { v.kept_count[item] = kept; }
  }
};

}  // namespace detail

/// Drops from the kept corners those whose structure tensor, over 7 x 7 pixels of their level, has
/// eigenvalues of a smaller ratio than `ratio`: along the edge on which such a corner lies its
/// position is 1 / sqrt(ratio) times as uncertain as across it, or more. A weak corner within 4
/// pixels of a much stronger edge is dropped as well. The others stay in their order. Asynchronous
/// on `exec`; allocates nothing; one launch.
/// @param ratio [0, 1]; 0 keeps all
/// @pre the corners' layout is that of the pyramid
/// @throws bad_argument for another ratio or another number of images
template <typename Exec>
void drop_edges(Exec const& exec, image_pyramid_view const& pyramid, float ratio,
                distribution_view const& kept) {
  detail::require_range("ratio of a corner", ratio, 0.0f, 1.0f);
  detail::require(kept.batch == pyramid.batch, "the corners are those of other images");
  double const r = ratio;
  for_each_item<per_block<512>>(exec, kept.batch * kept.layout.levels,
                                detail::drop_edges_of_level{r / ((1 + r) * (1 + r))}, pyramid,
                                kept);
}

}  // namespace FT_ABI
}  // namespace ft
