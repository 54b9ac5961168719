// SPDX-License-Identifier: Apache-2.0
/// @file Stage: images and other inputs from host memory into an executor's, by its threads.
///
/// A copy engine is no faster for a pair of images, takes one copy after the other, and copies from
/// where it was told when a graph was recorded; threads read where the images lie now.
#pragma once

#include <cstddef>
#include <cstdint>

#include "ft/containers/image_pyramid.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/views.hpp"

namespace ft {
inline namespace FT_ABI {

/// An image in host memory that the executor's threads can read.
struct alignas(16) image_source {
  std::uint8_t const* data = nullptr;  ///< a multiple of 16, rows of `stride` readable bytes
  int stride = 0;                      ///< a multiple of 16, at least the width
};

/// Host memory that moves as it is.
struct block_source {
  void* to = nullptr;
  void const* from = nullptr;  ///< host memory that the executor's threads can read
  int quads = 0;               ///< of 16 bytes, as both addresses are multiples of
};

/// A part of a frame's input: so many times 16 bytes of an image, or of what comes besides.
struct receive_part {
  static constexpr int quads = 256;
  struct alignas(16) quad {
    std::uint32_t words[4];
  };
  struct scratch {
    image_source source;
  };
  FT_HOST_DEVICE static int parts_of(pyramid_geometry const& g) {
    return ceil_div(ceil_div(g.width[0], 16) * g.height[0], quads);
  }

  /// @param sources [batch of pyramids], host memory
  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int item, image_pyramid_view const& to,
                                 image_source const* sources, block_source const& first,
                                 block_source const& second) const {
    int const parts = parts_of(to.geometry);
    int const image = item / parts;
    if (image < to.batch) {
      if (g.rank() == 0) { s.source = sources[image]; }
      g.sync();
      receive_image(g, to.level(image, 0), s.source, (item - image * parts) * quads);
      return;
    }
    int const begin = (item - to.batch * parts) * quads;
    for (int i = begin + g.rank(); i < begin + quads; i += g.size()) {
      if (i < first.quads) {
        copy(first, i);
      } else if (i - first.quads < second.quads) {
        copy(second, i - first.quads);
      }
    }
  }

private:
  template <typename Group>
  FT_HOST_DEVICE static void receive_image(Group g, image_view<std::uint8_t> to,
                                           image_source const& from, int begin) {
    int const of_row = ceil_div(to.width, 16);
    int const end = min_of(begin + quads, of_row * to.height);
    for (int i = begin + g.rank(); i < end; i += g.size()) {
      int const y = i / of_row;
      int const x = 16 * (i - y * of_row);
      *reinterpret_cast<quad*>(to.data + static_cast<std::ptrdiff_t>(y) * to.stride + x) =
          *reinterpret_cast<quad const*>(from.data + static_cast<std::ptrdiff_t>(y) * from.stride +
                                         x);
    }
  }
  FT_HOST_DEVICE static void copy(block_source const& block, int i) {
    static_cast<quad*>(block.to)[i] = static_cast<quad const*>(block.from)[i];
  }
};

/// Fetches level 0 of all images of a batch, and two blocks. Asynchronous on `exec`: what is read
/// must stay as it is until it is done; allocates nothing; one launch.
/// @param sources [to.batch], in host memory that the executor's threads can read, looked at when
/// the launch runs
/// @param to has a geometry also where its batch is 0
template <typename Exec>
void receive_images(Exec const& exec, image_source const* sources, image_pyramid_view const& to,
                    block_source const& first = {}, block_source const& second = {}) {
  for_each_item<per_block<receive_part::quads>>(
      exec,
      to.batch * receive_part::parts_of(to.geometry) +
          ceil_div(first.quads + second.quads, receive_part::quads),
      receive_part{}, to, sources, first, second);
}

}  // namespace FT_ABI
}  // namespace ft
