// SPDX-License-Identifier: Apache-2.0
/// @file Coloured pictures: a grey image, darkened to 16 levels, with circles and lines drawn on
/// it, written as PNG.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "examples/common/scene.hpp"

namespace demo {

struct colour {
  std::uint8_t red, green, blue;
};

/// From red (0) through yellow, green and cyan to blue (1).
colour rainbow(float share);
/// Near is red, far is blue. Linear in the inverse of the depth, as disparities are.
colour by_depth(float depth, float near, float far);

class picture {
public:
  explicit picture(grey_image const& image);

  void line(float x0, float y0, float x1, float y1, colour c);
  void circle(float x, float y, float radius, colour c);
  void disc(float x, float y, float radius, colour c);
  /// Mixes the pixels for which `where` is 0 with a colour. @param where one value per pixel
  void shade(std::vector<std::uint8_t> const& where, colour c);
  /// @throws std::runtime_error naming the file
  void write_png(std::string const& path) const;

private:
  void put(int x, int y, colour c);

  int width_;
  int height_;
  std::vector<colour> pixels_;
};

}  // namespace demo
