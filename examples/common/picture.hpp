// SPDX-License-Identifier: Apache-2.0
/// @file Coloured pictures: a darkened grey image with circles and lines drawn on it, written as
/// PNG.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <fstream>
#include <stdexcept>
#include <string>
#include <vector>

#include "examples/common/scene.hpp"

namespace demo {

/// A binary PGM file of 8 bits, as `ffmpeg -i photo.jpg photo.pgm` or `convert` makes it. @throws
/// std::runtime_error naming the file
inline grey_image read_pgm(std::string const& path) {
  std::ifstream in(path, std::ios::binary);
  std::string word;
  std::array<int, 3> sizes{};  // width, height, largest value
  in >> word;
  bool const binary = word == "P5";
  for (int& size : sizes) {
    while (in >> std::ws && in.peek() == '#') { std::getline(in, word); }
    in >> size;
  }
  in.get();  // one blank
  constexpr int most = 1 << 15;
  if (!in || !binary || sizes[0] < 1 || sizes[1] < 1 || sizes[0] > most || sizes[1] > most ||
      sizes[2] != 255) {
    throw std::runtime_error(path + ": is no binary PGM file of 8 bits");
  }
  grey_image image{sizes[0], sizes[1],
                   std::vector<std::uint8_t>(static_cast<std::size_t>(sizes[0]) *
                                             static_cast<std::size_t>(sizes[1]))};
  in.read(reinterpret_cast<char*>(image.pixels.data()),
          static_cast<std::streamsize>(image.pixels.size()));
  if (!in) { throw std::runtime_error(path + ": ends early"); }
  return image;
}

struct colour {
  std::uint8_t red, green, blue;
};

/// From red (0) through yellow, green and cyan to blue (1).
inline colour rainbow(float share) {
  float const hue = std::clamp(share, 0.0f, 1.0f) * 2 / 3;  // red 0, green 1/3, blue 2/3
  // 1 within a third of `centre`, falling to 0 over the next third
  auto const channel = [hue](float centre) {
    return static_cast<std::uint8_t>(
        std::lround(255 * std::clamp(2 - 6 * std::abs(hue - centre), 0.0f, 1.0f)));
  };
  return {channel(0), channel(1.0f / 3), channel(2.0f / 3)};
}

/// Near is red, far is blue. Linear in the inverse of the depth, as disparities are.
inline colour by_depth(float depth, float near, float far) {
  return rainbow((1 / near - 1 / depth) / (1 / near - 1 / far));
}

/// Bytes as PNG: RGB, not compressed (RFC 2083; stored blocks of RFC 1950 and 1951). At most 21844
/// pixels wide.
class png_bytes {
public:
  png_bytes(int width, int height, std::vector<colour> const& pixels)
      : bytes_{0x89, 'P', 'N', 'G', '\r', '\n', 0x1A, '\n'} {
    if (width > 21844) { throw std::runtime_error("png_bytes: wider than 21844 pixels"); }
    std::vector<std::uint8_t> head;
    number(head, static_cast<std::uint32_t>(width));
    number(head, static_cast<std::uint32_t>(height));
    head.insert(head.end(), {8, 2, 0, 0, 0});  // bits, RGB, deflate, filters, no interlace
    chunk("IHDR", head);

    std::vector<std::uint8_t> data{0x78, 0x01};
    std::uint32_t a = 1, b = 0;  // Adler's sums
    for (int y = 0; y < height; ++y) {
      std::vector<std::uint8_t> row{0};  // no filter
      for (int x = 0; x < width; ++x) {
        colour const c = pixels[static_cast<std::size_t>(y) * static_cast<std::size_t>(width) +
                                static_cast<std::size_t>(x)];
        row.insert(row.end(), {c.red, c.green, c.blue});
      }
      auto const length = static_cast<std::uint32_t>(row.size());
      data.push_back(y + 1 == height ? 1 : 0);  // a block is a row; the last one is marked
      for (std::uint32_t const n : {length, ~length}) {
        data.insert(data.end(),
                    {static_cast<std::uint8_t>(n & 255), static_cast<std::uint8_t>(n >> 8 & 255)});
      }
      data.insert(data.end(), row.begin(), row.end());
      for (std::uint8_t const byte : row) {
        a = (a + byte) % 65521;
        b = (b + a) % 65521;
      }
    }
    number(data, b << 16 | a);
    chunk("IDAT", data);
    chunk("IEND", {});
  }
  std::vector<std::uint8_t> const& get() const { return bytes_; }

private:
  static void number(std::vector<std::uint8_t>& to, std::uint32_t n) {
    for (int shift = 24; shift >= 0; shift -= 8) {
      to.push_back(static_cast<std::uint8_t>(n >> shift & 255));
    }
  }
  void chunk(char const* name, std::vector<std::uint8_t> const& data) {
    std::vector<std::uint8_t> all;
    number(all, static_cast<std::uint32_t>(data.size()));
    all.insert(all.end(), name, name + 4);
    all.insert(all.end(), data.begin(), data.end());
    std::uint32_t sum = ~0u;  // CRC-32
    for (std::size_t i = 4; i < all.size(); ++i) {
      sum ^= all[i];
      for (int bit = 0; bit < 8; ++bit) {
        sum = (sum & 1) != 0 ? sum >> 1 ^ 0xEDB88320u : sum >> 1;
      }
    }
    number(all, ~sum);
    bytes_.insert(bytes_.end(), all.begin(), all.end());
  }

  std::vector<std::uint8_t> bytes_;
};

class picture {
public:
  explicit picture(grey_image const& image) : width_(image.width), height_(image.height) {
    for (std::uint8_t const pixel : image.pixels) {
      auto const grey = static_cast<std::uint8_t>(pixel / 16 * 14);
      pixels_.push_back({grey, grey, grey});
    }
  }

  void line(float x0, float y0, float x1, float y1, colour c) {
    int const steps = 1 + nearest(std::max(std::abs(x1 - x0), std::abs(y1 - y0)));
    for (int i = 0; i <= steps; ++i) {
      float const t = static_cast<float>(i) / static_cast<float>(steps);
      put(nearest(x0 + t * (x1 - x0)), nearest(y0 + t * (y1 - y0)), c);
    }
  }

  void circle(float x, float y, float radius, colour c) {
    int const steps = 8 + nearest(8 * radius);
    for (int i = 0; i < steps; ++i) {
      float const a = 6.2831853f * static_cast<float>(i) / static_cast<float>(steps);
      put(nearest(x + radius * std::cos(a)), nearest(y + radius * std::sin(a)), c);
    }
  }

  void disc(float x, float y, float radius, colour c) {
    int const reach = static_cast<int>(std::ceil(radius));
    for (int dy = -reach; dy <= reach; ++dy) {
      for (int dx = -reach; dx <= reach; ++dx) {
        if (static_cast<float>(dx * dx + dy * dy) <= radius * radius) {
          put(nearest(x) + dx, nearest(y) + dy, c);
        }
      }
    }
  }

  /// Mixes the pixels for which `where` is 0 with a colour. @param where one value per pixel
  void shade(std::vector<std::uint8_t> const& where, colour c) {
    auto const mix = [](std::uint8_t a, std::uint8_t b) {
      return static_cast<std::uint8_t>((a + b) / 2);
    };
    for (std::size_t i = 0; i < pixels_.size() && i < where.size(); ++i) {
      auto& p = pixels_[i];
      if (where[i] == 0) { p = {mix(p.red, c.red), mix(p.green, c.green), mix(p.blue, c.blue)}; }
    }
  }
  /// @throws std::runtime_error naming the file
  void write_png(std::string const& path) const {
    std::ofstream out(path, std::ios::binary);
    png_bytes const png(width_, height_, pixels_);
    out.write(reinterpret_cast<char const*>(png.get().data()),
              static_cast<std::streamsize>(png.get().size()));
    if (!out.flush()) { throw std::runtime_error(path + ": cannot be written"); }
  }

private:
  static int nearest(float v) { return static_cast<int>(std::lround(v)); }
  void put(int x, int y, colour c) {
    if (x < 0 || x >= width_ || y < 0 || y >= height_) { return; }
    pixels_[static_cast<std::size_t>(y) * static_cast<std::size_t>(width_) +
            static_cast<std::size_t>(x)] = c;
  }

  int width_;
  int height_;
  std::vector<colour> pixels_;
};

}  // namespace demo
