// SPDX-License-Identifier: Apache-2.0
/// @file Textures of random shapes, at all resolutions.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <vector>

namespace seq::generated {

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
  float bilinear(float x, float y) const {
    x = std::min(std::max(x, 0.0f), static_cast<float>(width - 1));
    y = std::min(std::max(y, 0.0f), static_cast<float>(height - 1));
    int const ix = static_cast<int>(x);
    int const iy = static_cast<int>(y);
    float const fx = x - static_cast<float>(ix);
    float const fy = y - static_cast<float>(iy);
    std::uint8_t const* p = row(iy) + ix;
    std::uint8_t const* q = p + stride;
    float const top = static_cast<float>(p[0]) + fx * static_cast<float>(p[1] - p[0]);
    float const bottom = static_cast<float>(q[0]) + fx * static_cast<float>(q[1] - q[0]);
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
  float sample(float x, float y, footprint const& f) const;

  /// @param ax, ay, bx, by texels moved per pixel to the right, and down
  footprint measure(float ax, float ay, float bx, float by) const;
};

/// Rectangles and triangles from a metre down to two centimetres, the smaller ones on top, so that
/// corners are visible from every distance.
/// @param texels_per_m of the finest level @param brightness factor of the grey levels
texture paint(std::uint64_t seed, double width_m, double height_m, double texels_per_m,
              double brightness);

}  // namespace seq::generated
