// SPDX-License-Identifier: Apache-2.0
/// @file Random inputs, the same for the same seed.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <random>
#include <vector>

#include "ft/containers/keypoints.hpp"

namespace test {

/// An index of a vector.
inline std::size_t at(std::ptrdiff_t i) { return static_cast<std::size_t>(i); }

/// Random numbers of several kinds.
class generator {
public:
  explicit generator(unsigned seed) : random_(seed) {}
  int below(int n) { return static_cast<int>(random_() % static_cast<unsigned>(std::max(n, 1))); }
  int from_to(int low, int high) { return low + below(high - low + 1); }
  bool chance(int percent) { return below(100) < percent; }
  float real(float low, float high) {
    return low + (high - low) * static_cast<float>(random_() >> 8) * (1.0f / 16777216.0f);
  }
  ft::descriptor descriptor() {
    ft::descriptor d;
    for (auto& w : d.words) { w = static_cast<std::uint32_t>(random_()); }
    return d;
  }
  /// d with up to `bits` bits changed.
  ft::descriptor flipped(ft::descriptor d, int bits) {
    for (int i = 0; i < bits; ++i) {
      int const bit = below(256);
      d.words[bit / 32] ^= 1u << (bit % 32);
    }
    return d;
  }

private:
  std::mt19937 random_;
};

/// Pixels that do not depend on each other.
inline std::vector<std::uint8_t> noise(std::size_t pixels, unsigned seed) {
  std::mt19937 random(seed);
  std::vector<std::uint8_t> image(pixels);
  for (auto& p : image) { p = static_cast<std::uint8_t>(random()); }
  return image;
}
inline std::vector<std::uint8_t> noise(int width, int height, unsigned seed) {
  return noise(at(width) * at(height), seed);
}

/// A grey image with structure at all scales: flat areas, edges and noise; the same for the same
/// seed.
inline std::vector<std::uint8_t> random_image(int width, int height, unsigned seed) {
  std::mt19937 random(seed);
  std::vector<std::uint8_t> image(at(width) * at(height), 90);
  int const boxes = 40 + width * height / 1500;
  for (int i = 0; i < boxes; ++i) {
    int const w = 1 + static_cast<int>(random() % static_cast<unsigned>(2 + width / (2 + i % 40)));
    int const h = 1 + static_cast<int>(random() % static_cast<unsigned>(2 + height / (2 + i % 40)));
    int const x0 = static_cast<int>(random() % static_cast<unsigned>(width));
    int const y0 = static_cast<int>(random() % static_cast<unsigned>(height));
    auto const grey = static_cast<std::uint8_t>(random());
    for (int y = y0; y < y0 + h && y < height; ++y) {
      for (int x = x0; x < x0 + w && x < width; ++x) { image[at(y) * at(width) + at(x)] = grey; }
    }
  }
  for (auto& p : image) {
    p = static_cast<std::uint8_t>(
        std::min(255, std::max(0, static_cast<int>(p) + static_cast<int>(random() % 9) - 4)));
  }
  return image;
}

}  // namespace test
