// SPDX-License-Identifier: Apache-2.0
#include "examples/common/picture.hpp"

#include <png.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <stdexcept>

namespace demo {

namespace {

int nearest(float v) { return static_cast<int>(std::lround(v)); }

/// A channel of a rainbow: 1 within a third of `centre`, falling to 0 over the next third.
std::uint8_t channel(float hue, float centre) {
  float const value = std::clamp(2 - 6 * std::abs(hue - centre), 0.0f, 1.0f);
  return static_cast<std::uint8_t>(nearest(255 * value));
}

}  // namespace

colour rainbow(float share) {
  float const hue = std::clamp(share, 0.0f, 1.0f) * 2 / 3;  // red 0, green 1/3, blue 2/3
  return {channel(hue, 0), channel(hue, 1.0f / 3), channel(hue, 2.0f / 3)};
}

colour by_depth(float depth, float near, float far) {
  return rainbow((1 / near - 1 / depth) / (1 / near - 1 / far));
}

picture::picture(grey_image const& image) : width_(image.width), height_(image.height) {
  for (std::uint8_t const pixel : image.pixels) {
    auto const grey = static_cast<std::uint8_t>(pixel / 16 * 14);  // few values: a small file
    pixels_.push_back({grey, grey, grey});
  }
}

void picture::put(int x, int y, colour c) {
  if (x < 0 || x >= width_ || y < 0 || y >= height_) { return; }
  pixels_[static_cast<std::size_t>(y) * static_cast<std::size_t>(width_) +
          static_cast<std::size_t>(x)] = c;
}

void picture::line(float x0, float y0, float x1, float y1, colour c) {
  int const steps = 1 + nearest(std::max(std::abs(x1 - x0), std::abs(y1 - y0)));
  for (int i = 0; i <= steps; ++i) {
    float const t = static_cast<float>(i) / static_cast<float>(steps);
    put(nearest(x0 + t * (x1 - x0)), nearest(y0 + t * (y1 - y0)), c);
  }
}

void picture::circle(float x, float y, float radius, colour c) {
  int const steps = 8 + nearest(8 * radius);
  for (int i = 0; i < steps; ++i) {
    float const a = 6.2831853f * static_cast<float>(i) / static_cast<float>(steps);
    put(nearest(x + radius * std::cos(a)), nearest(y + radius * std::sin(a)), c);
  }
}

void picture::disc(float x, float y, float radius, colour c) {
  int const reach = static_cast<int>(std::ceil(radius));
  for (int dy = -reach; dy <= reach; ++dy) {
    for (int dx = -reach; dx <= reach; ++dx) {
      if (static_cast<float>(dx * dx + dy * dy) <= radius * radius) {
        put(nearest(x) + dx, nearest(y) + dy, c);
      }
    }
  }
}

void picture::shade(std::vector<std::uint8_t> const& where, colour c) {
  auto const mix = [](std::uint8_t a, std::uint8_t b) {
    return static_cast<std::uint8_t>((a + b) / 2);
  };
  for (std::size_t i = 0; i < pixels_.size() && i < where.size(); ++i) {
    auto& p = pixels_[i];
    if (where[i] == 0) { p = {mix(p.red, c.red), mix(p.green, c.green), mix(p.blue, c.blue)}; }
  }
}

void picture::write_png(std::string const& path) const {
  png_image header{};
  header.version = PNG_IMAGE_VERSION;
  header.width = static_cast<png_uint_32>(width_);
  header.height = static_cast<png_uint_32>(height_);
  header.format = PNG_FORMAT_RGB;
  if (png_image_write_to_file(&header, path.c_str(), 0, pixels_.data(), 3 * width_, nullptr) == 0) {
    throw std::runtime_error(path + ": " + header.message);
  }
}

}  // namespace demo
