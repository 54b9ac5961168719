// SPDX-License-Identifier: Apache-2.0
/// @file Stage: orientation of a corner by the intensity centroid of a disc. Source: specification
/// section 4; Rosin, "Measuring corner properties", CVIU 1999.
#pragma once

#include <cstdint>

#include "ft/core/config.hpp"
#include "ft/core/group.hpp"
#include "ft/core/math.hpp"
#include "ft/core/views.hpp"
#include "ft/kernels/detail/packed_pixels.hpp"

namespace ft {
inline namespace FT_ABI {

inline constexpr int orientation_radius = 15;

/// Angle of (x, y) in degrees, [0, 360]; a polynomial in float with an error of about 0.01 degrees,
/// bit-identical to cv::fastAtan2. (0, 0) gives 0.
FT_HOST_DEVICE inline float fast_atan2_degrees(float y, float x) {
  constexpr float k = static_cast<float>(180.0 / 3.14159265358979323846);
  constexpr float p1 = 0.9997878412794807f * k;
  constexpr float p3 = -0.3258083974640975f * k;
  constexpr float p5 = 0.1555786518463281f * k;
  constexpr float p7 = -0.04432655554792128f * k;
  constexpr float eps = static_cast<float>(2.2204460492503131e-16);
  float const ax = ::fabsf(x);
  float const ay = ::fabsf(y);
  bool const wide = ax >= ay;
  strict_float const c = wide ? strict_float(ay) / (ax + eps) : strict_float(ax) / (ay + eps);
  strict_float const q = c * c;
  strict_float a = (((p7 * q + p5) * q + p3) * q + p1) * c;
  if (!wide) { a = 90.0f - a; }
  if (x < 0) { a = 180.0f - a; }
  if (y < 0) { a = 360.0f - a; }
  return a.value;
}

namespace detail {

/// Half width of row v of the disc, v in 0..15.
FT_HOST_DEVICE inline int disc_half_width(int v) {
  // 15 15 15 15 14 14 14 13 | 13 12 11 10 9 8 6 3, four bits each
  constexpr std::uint64_t widths = 0x3689abcddeeeffffull;
  return static_cast<int>(widths >> (4 * v) & 15u);
}

struct moments {
  int m10, m01;
  friend FT_HOST_DEVICE moments operator+(moments a, moments b) {
    return {a.m10 + b.m10, a.m01 + b.m01};
  }
};

/// Share of the pixels (x + u .. x + u + 3, y + v) that lie in the disc around (x, y).
/// @param u such that the first pixel is at a whole word
FT_HOST_DEVICE inline moments moments_of_word(gray_view level, int x, int y, int u, int v) {
  int const half = disc_half_width(v < 0 ? -v : v);
  int const before = max_of(-half - u, 0);    // pixels outside, from the left
  int const after = max_of(u + 3 - half, 0);  // from the right
  if (before > 3 || after > 3) { return {0, 0}; }
  std::uint32_t const inside = 0xffffffffu << (8 * before) & 0xffffffffu >> (8 * after);
  std::uint32_t const word = load_word(level.row(y + v) + x + u) & inside;
  int const sum = static_cast<int>(dot_of_4(word, 0x01010101u, 0));
  return {u * sum + static_cast<int>(dot_of_4(word, 0x03020100u, 0)), v * sum};
}

/// The moments of the disc around (x, y), by a single thread: first sums of columns, over the
/// disc's rows, in loops that become vectors. @pre column x + 16 is in the level, too
FT_HOST_DEVICE FT_INLINE moments moments_by_columns(gray_view level, int x, int y) {
  constexpr int radius = orientation_radius;
  constexpr int columns = 2 * radius + 2;
  std::int16_t sums[columns] = {};
  std::int16_t firsts[columns] = {};  // of row times pixel: below 2^15, as 255 * (1 + ... + 15) is
  for (int v = 0; v <= radius; ++v) {
    auto const half = static_cast<std::int16_t>(disc_half_width(v));
    auto const row = static_cast<std::int16_t>(v);
    auto const once = static_cast<std::int16_t>(v == 0 ? 0 : -1);  // of the centre's row
    std::uint8_t const* const above = level.row(y - v) + (x - radius);
    std::uint8_t const* const below = level.row(y + v) + (x - radius);
    for (int i = 0; i < columns; ++i) {
      auto const u = static_cast<std::int16_t>(i < radius ? radius - i : i - radius);
      auto const inside = static_cast<std::int16_t>(u <= half ? -1 : 0);
      sums[i] = static_cast<std::int16_t>(sums[i] + (((above[i] & once) + below[i]) & inside));
      firsts[i] = static_cast<std::int16_t>(firsts[i] + row * ((below[i] - above[i]) & inside));
    }
  }
  moments m{0, 0};
  for (int i = 0; i < columns; ++i) {
    m.m10 += (i - radius) * sums[i];
    m.m01 += firsts[i];
  }
  return m;
}

}  // namespace detail

/// Orientation of the disc of radius 15 around (x, y) of an unblurred level; degrees, the same in
/// every thread of the group. The disc must lie inside the level.
template <typename Group>
FT_HOST_DEVICE FT_INLINE float orientation(Group g, gray_view level, int x, int y) {
  detail::moments m{0, 0};
  constexpr int side = 2 * orientation_radius + 1;
  if (g.size() > 1 && detail::has_word_rows(level)) {
    // By words, so that threads side by side read pixels side by side.
    constexpr int words = 9;  // of a row: side bytes, from any address
    int const first = (x - orientation_radius) & ~3;
    int const steps = (side * words + g.size() - 1) / g.size();
    FT_UNROLL
    for (int k = 0; k < steps; ++k) {
      int const i = g.rank() + k * g.size();
      int const v = i / words - orientation_radius;
      int const u = first + i % words * 4 - x;  // of the word's first pixel
      if (v > orientation_radius) { continue; }
      m = m + detail::moments_of_word(level, x, y, u, v);
    }
    m = g.reduce(m, sum_op{});
    return fast_atan2_degrees(static_cast<float>(m.m01), static_cast<float>(m.m10));
  }
  if (g.size() == 1 && x + orientation_radius + 1 < level.width) {
    m = detail::moments_by_columns(level, x, y);
    return fast_atan2_degrees(static_cast<float>(m.m01), static_cast<float>(m.m10));
  }
  for (int r = g.rank(); r < side; r += g.size()) {
    int const v = r - orientation_radius;
    int const half = detail::disc_half_width(v < 0 ? -v : v);
    std::uint8_t const* const row = level.row(y + v) + x;
    int sum = 0;
    for (int u = -half; u <= half; ++u) {
      sum += row[u];
      m.m10 += u * row[u];
    }
    m.m01 += v * sum;
  }
  m = g.reduce(m, sum_op{});
  return fast_atan2_degrees(static_cast<float>(m.m01), static_cast<float>(m.m10));
}

}  // namespace FT_ABI
}  // namespace ft
