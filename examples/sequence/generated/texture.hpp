// SPDX-License-Identifier: Apache-2.0
/// @file Textures of random shapes, at all resolutions.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <vector>

namespace seq::generated {

/// Of pixels beside each other, which are computed together.
typedef float four __attribute__((vector_size(4 * sizeof(float))));
typedef int four_ints __attribute__((vector_size(4 * sizeof(int))));

inline four between_zero_and(four x, int most) {
  four const limit = four{} + static_cast<float>(most);
  x = x < 0.0f ? four{} : x;
  return limit < x ? limit : x;
}

struct mip_level {
  int width = 0;
  int height = 0;
  std::size_t stride = 0;  ///< width + 1: last column and row are repeated for bilinear reads
  std::vector<std::uint8_t> texels;

  std::uint8_t* row(int y) { return texels.data() + static_cast<std::size_t>(y) * stride; }
  std::uint8_t const* row(int y) const {
    return texels.data() + static_cast<std::size_t>(y) * stride;
  }
  void resize(int w, int h) {
    width = w;
    height = h;
    stride = static_cast<std::size_t>(w) + 1;
    texels.assign(stride * (static_cast<std::size_t>(h) + 1), 0);
  }
  void double_borders() {
    for (int y = 0; y < height; ++y) { row(y)[width] = row(y)[width - 1]; }
    std::memcpy(row(height), row(height - 1), stride);
  }
  /// Inline: in a shared library the compiler may not inline others. @param x, y texel centres are
  /// at integer coordinates
  four bilinear(four x, four y) const {
    x = between_zero_and(x, width - 1);
    y = between_zero_and(y, height - 1);
    four_ints const ix = __builtin_convertvector(x, four_ints);
    four_ints const iy = __builtin_convertvector(y, four_ints);
    four const fx = x - __builtin_convertvector(ix, four);
    four const fy = y - __builtin_convertvector(iy, four);
    four_ints above, below;
    for (int k = 0; k < 4; ++k) {
      std::uint8_t const* const p = row(iy[k]) + ix[k];
      std::uint8_t const* const q = p + stride;
      above[k] = p[0] | p[1] << 8;
      below[k] = q[0] | q[1] << 8;
    }
    four const a = __builtin_convertvector(above & 255, four);
    four const b = __builtin_convertvector(above >> 8, four);
    four const c = __builtin_convertvector(below & 255, four);
    four const d = __builtin_convertvector(below >> 8, four);
    four const top = a + fx * (b - a);
    four const bottom = c + fx * (d - c);
    return top + fy * (bottom - top);
  }
};

/// Position and width of a texture read; computed once for a few neighbouring pixels.
struct footprint {
  int level = 0;
  float blend = 0;  ///< towards level + 1
  int taps = 1;     ///< along the longer axis
  float step_x = 0, step_y = 0;
};

struct texture {
  float texels_per_m = 0;
  std::vector<mip_level> levels;

  /// @param x, y texels of level 0, from the texture's corner
  four sample(four x, four y, footprint const& f) const;

  /// @param ax, ay, bx, by texels moved per pixel to the right, and down
  footprint measure(float ax, float ay, float bx, float by) const;
};

/// Rectangles and triangles from a metre down to two centimetres, the smaller ones on top, so that
/// corners are visible from every distance.
/// @param texels_per_m of the finest level @param brightness factor of the grey levels
texture paint(std::uint64_t seed, double width_m, double height_m, double texels_per_m,
              double brightness);

}  // namespace seq::generated
