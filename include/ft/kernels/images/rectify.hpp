// SPDX-License-Identifier: Apache-2.0
/// @file Stage: rectification by bilinear lookup through a fixed-point map. Gives the pixels of
/// cv::remap(CV_16SC2 + CV_16UC1, INTER_LINEAR, BORDER_CONSTANT) on 8-bit images.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>
#include <limits>
#include <string>

#include "ft/containers/image_pyramid.hpp"
#include "ft/containers/remap_table.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/views.hpp"

namespace ft {
inline namespace FT_ABI {

namespace detail {

template <typename T>
void require_images(char const* name, image_batch_view<T> const& images, int width, int height) {
  if (images.data == nullptr) {
    throw bad_argument(std::string("ft: the ") + name + " images are null");
  }
  if (images.width != width || images.height != height) {
    throw bad_argument(std::string("ft: the ") + name + " images are " +
                       std::to_string(images.width) + "x" + std::to_string(images.height) +
                       ", the remap table is for " + std::to_string(width) + "x" +
                       std::to_string(height));
  }
  require_range("batch of images", images.batch, 1, max_remap_batch);
  require_range("image stride", images.stride, width, std::numeric_limits<int>::max());
  require(images.step >= 0, "the distance of two images is negative");
}

/// Item: a row of a target image.
struct rectify_row {
  static constexpr bool wide_on_host = true;
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int item,
                                 image_batch_view<std::uint8_t const> const& source,
                                 remap_table_view const& table,
                                 image_batch_view<std::uint8_t> const& target,
                                 std::uint8_t border) const {
    int const image = item / target.height;
    int const y = item % target.height;
    auto const from = source[image];
    std::uint8_t* const out = target[image].row(y);
    remap_table_view const map = table.slice(image % table.batch);
    std::ptrdiff_t const first = static_cast<std::ptrdiff_t>(y) * target.width;
    int x = g.rank();
    if constexpr (Group::max_threads == 1) {
      for (; x + run <= target.width; x += run) {
        remap_position const* const positions = map.position + first + x;
        std::uint16_t const* const fractions = map.fraction + first + x;
        if (is_inner_run(positions, from)) {
          inner_run(from, positions, fractions, out + x);
        } else {
          for (int k = 0; k < run; ++k) {
            out[x + k] = pixel(from, positions[k], fractions[k], border);
          }
        }
      }
    }
    for (; x < target.width; x += g.size()) {
      out[x] = pixel(from, map.position[first + x], map.fraction[first + x], border);
    }
  }

private:
  static constexpr int run = 32;  ///< pixels per vectorised loop on the host

  FT_HOST_DEVICE static std::uint8_t pixel(gray_view from, remap_position p, int fraction,
                                           std::uint8_t border) {
    int const fx = fraction & 31;
    int const fy = fraction >> 5 & 31;
    int p00 = border;
    int p10 = border;
    int p01 = border;
    int p11 = border;
    bool const left = p.x >= 0 && p.x < from.width;
    bool const right = p.x >= -1 && p.x + 1 < from.width;
    if (p.y >= 0 && p.y < from.height) {
      std::uint8_t const* const row = from.row(p.y);
      if (left) { p00 = row[p.x]; }
      if (right) { p10 = row[p.x + 1]; }
    }
    if (p.y >= -1 && p.y + 1 < from.height) {
      std::uint8_t const* const row = from.row(p.y + 1);
      if (left) { p01 = row[p.x]; }
      if (right) { p11 = row[p.x + 1]; }
    }
    return mixed(p00, p10, p01, p11, fx, fy);
  }

  /// Bilinear interpolation with weights that sum to 1024. OpenCV's weights are these times 32,
  /// except that one of them is smaller by 1 at whole pixels; this never changes the rounded
  /// result.
  FT_HOST_DEVICE FT_INLINE static std::uint8_t mixed(int p00, int p10, int p01, int p11, int fx,
                                                     int fy) {
    int const upper = p00 * (32 - fx) + p10 * fx;
    int const lower = p01 * (32 - fx) + p11 * fx;
    return static_cast<std::uint8_t>((upper * (32 - fy) + lower * fy + 512) >> 10);
  }

  /// Whether all four neighbours of all pixels of a run lie in the image.
  FT_HOST_DEVICE FT_INLINE static bool is_inner_run(remap_position const* positions,
                                                    gray_view from) {
    int outside = 0;
    for (int k = 0; k < run; ++k) {
      int const x = positions[k].x;
      int const y = positions[k].y;
      outside |= x | y | (from.width - 2 - x) | (from.height - 2 - y);  // negative if any is
    }
    return outside >= 0 && from.stride <= 1 << 16;  // offsets fit into an int
  }

  /// The pixels of an inner run. Everything but the loads vectorises.
  FT_HOST_DEVICE FT_INLINE static void inner_run(gray_view from, remap_position const* positions,
                                                 std::uint16_t const* fractions,
                                                 std::uint8_t* out) {
    std::int32_t at[run];
    for (int k = 0; k < run; ++k) { at[k] = positions[k].y * from.stride + positions[k].x; }
    std::uint16_t upper[run];  // two neighbours each
    std::uint16_t lower[run];
    for (int k = 0; k < run; ++k) {
      std::memcpy(upper + k, from.data + at[k], 2);
      std::memcpy(lower + k, from.data + from.stride + at[k], 2);
    }
    for (int k = 0; k < run; ++k) {
      out[k] = mixed(upper[k] & 255, upper[k] >> 8, lower[k] & 255, lower[k] >> 8,
                     fractions[k] & 31, fractions[k] >> 5 & 31);
    }
  }
};

}  // namespace detail

/// Rectifies every image of `source` into `target` through its map, bilinear: the pixels of
/// cv::remap with INTER_LINEAR and BORDER_CONSTANT. A neighbour outside the source counts as
/// `border`, so image edges blend into it. Padding between the target's rows is not written.
/// Asynchronous on `exec`; allocates nothing; one launch for the batch.
/// @param source,target equally many images in executor memory, which must not overlap
/// @param table image i goes through map i % table.batch
/// @throws bad_argument for null views, sizes that are not the table's, strides below the width,
///   batches that differ or are not a multiple of the table's
template <typename Exec>
void rectify(Exec const& exec, image_batch_view<std::uint8_t const> const& source,
             remap_table_view const& table, image_batch_view<std::uint8_t> const& target,
             std::uint8_t border = 0) {
  detail::require_table(table);
  detail::require_images("source", source, table.sizes.source_width, table.sizes.source_height);
  detail::require_images("target", target, table.sizes.width, table.sizes.height);
  if (source.batch != target.batch || source.batch % table.batch != 0) {
    throw bad_argument("ft: " + std::to_string(source.batch) + " source and " +
                       std::to_string(target.batch) + " target images for " +
                       std::to_string(table.batch) +
                       " maps, must be as many and a multiple of the maps");
  }
  detail::require(target.batch == 1 || target.step >= static_cast<std::ptrdiff_t>(target.stride) *
                                                              (target.height - 1) +
                                                          target.width,
                  "the target images overlap: their distance is below an image's size");
  for_each_item<per_block<128>>(exec, target.batch * target.height, detail::rectify_row{}, source,
                                table, target, border);
}

}  // namespace FT_ABI
}  // namespace ft
