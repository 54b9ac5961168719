// SPDX-License-Identifier: Apache-2.0
/// @file Stage: orientation of a corner by the intensity centroid of a disc. Source: specification
/// section 4; Rosin, "Measuring corner properties", CVIU 1999.
#pragma once

#include <cmath>
#include <cstdint>

#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/group.hpp"
#include "ft/core/views.hpp"
#include "ft/kernels/detail/packed_pixels.hpp"

namespace ft {
inline namespace FT_ABI {

inline constexpr int orientation_radius = 15;

/// Angle of (x, y) in degrees, [0, 360]; (0, 0) gives 0. A polynomial in float with an error of
/// about 0.01 degrees, bit-identical to cv::fastAtan2.
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

/// First moments of grey levels: sums of u * pixel and v * pixel.
struct moments {
  int m10, m01;
  friend FT_HOST_DEVICE moments operator+(moments a, moments b) {
    return {a.m10 + b.m10, a.m01 + b.m01};
  }
};

/// The disc around (x, y) by words, for groups of whole warps. Eight threads read a row, so loads
/// coalesce. The constructor loads and sums() computes, so that loads of the caller in between are
/// in flight together with these. @pre has_word_rows(level)
template <typename Group>
class disc_words {
public:
  disc_words() = default;
  FT_HOST_DEVICE disc_words(Group g, gray_view level, int x, int y) {
    int const first = ((x - radius) & ~3) - x;
    u = first + g.rank() % 8 * 4;
    std::uint8_t const* const column = level.row(y) + x + u;
    FT_UNROLL
    for (int k = 0; k < each; ++k) {
      word[k] = load_word(column + min_of(row(g, k), radius) * level.stride);
    }
    // Only the longest rows reach into a ninth word.
    last_u = first + 32;
    last_v = g.rank() - radius;
    bool const reaches = last_v <= radius && half_width(last_v) >= last_u;
    last = reaches ? load_word(level.row(y + last_v) + x + last_u) : 0;
  }
  /// Moments of the whole disc, in every thread.
  FT_HOST_DEVICE moments sums(Group g) const {
    moments m = of_word(last, last_u, last_v);
    FT_UNROLL
    for (int k = 0; k < each; ++k) { m = m + of_word(word[k], u, row(g, k)); }
    return {g.reduce(m.m10, sum_op{}), g.reduce(m.m01, sum_op{})};
  }

private:
  static constexpr int radius = orientation_radius;
  static constexpr int rows =
      max_of(Group::max_threads / 8, 1);                   ///< rows that a group loads at once
  static constexpr int each = (2 * radius + rows) / rows;  ///< words per thread
  std::uint32_t word[each], last;
  int u, last_u, last_v;  ///< offsets of a word's first pixel from (x, y)

  FT_HOST_DEVICE static int row(Group g, int k) { return g.rank() / 8 + k * rows - radius; }
  FT_HOST_DEVICE static int half_width(int v) { return disc_half_width(v < 0 ? -v : v); }
  FT_HOST_DEVICE static moments of_word(std::uint32_t pixels, int u, int v) {
    if (v > radius) { return {0, 0}; }
    int const reach = half_width(v);
    int const before = min_of(max_of(-reach - u, 0), 4);    // pixels outside, from the left
    int const after = min_of(max_of(u + 3 - reach, 0), 4);  // from the right
    pixels &=
        static_cast<std::uint32_t>(0xffffffffull << (8 * before) & 0xffffffffull >> (8 * after));
    int const sum = static_cast<int>(dot_of_4(pixels, 0x01010101u, 0));
    return {u * sum + static_cast<int>(dot_of_4(pixels, 0x03020100u, 0)), v * sum};
  }
};

/// The moments of the disc around (x, y), by a single thread. Adds columns over the rows of the
/// disc, in loops that vectorise. @pre column x + 16 is in the level, too
FT_HOST_DEVICE FT_INLINE moments moments_by_columns(gray_view level, int x, int y) {
  constexpr int radius = orientation_radius;
  constexpr int columns = 2 * radius + 2;
  std::int16_t sums[columns] = {};
  std::int16_t firsts[columns] = {};  // sums of row * pixel: 255 * (1 + ... + 15) is below 2^15
  for (int v = 0; v <= radius; ++v) {
    auto const reach = static_cast<std::int16_t>(disc_half_width(v));
    auto const row = static_cast<std::int16_t>(v);
    auto const once = static_cast<std::int16_t>(v == 0 ? 0 : -1);  // count the centre's row once
    std::uint8_t const* const above = level.row(y - v) + (x - radius);
    std::uint8_t const* const below = level.row(y + v) + (x - radius);
    for (int i = 0; i < columns; ++i) {
      auto const u = static_cast<std::int16_t>(i < radius ? radius - i : i - radius);
      auto const inside = static_cast<std::int16_t>(u <= reach ? -1 : 0);
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

/// Orientation of the disc of radius 15 around (x, y) of an unblurred level: degrees, in every
/// thread of the group. @pre the disc lies inside the level
template <typename Group>
FT_HOST_DEVICE FT_INLINE float orientation(Group g, gray_view level, int x, int y) {
  detail::moments m{0, 0};
  constexpr int side = 2 * orientation_radius + 1;
  if constexpr (Group::max_threads >= 32) {
    if (detail::has_word_rows(level)) {
      m = detail::disc_words<Group>(g, level, x, y).sums(g);
      return fast_atan2_degrees(static_cast<float>(m.m01), static_cast<float>(m.m10));
    }
  }
  if (g.size() == 1 && x + orientation_radius + 1 < level.width) {
    m = detail::moments_by_columns(level, x, y);
    return fast_atan2_degrees(static_cast<float>(m.m01), static_cast<float>(m.m10));
  }
  for (int r = g.rank(); r < side; r += g.size()) {
    int const v = r - orientation_radius;
    int const reach = detail::disc_half_width(v < 0 ? -v : v);
    std::uint8_t const* const row = level.row(y + v) + x;
    int sum = 0;
    for (int u = -reach; u <= reach; ++u) {
      sum += row[u];
      m.m10 += u * row[u];
    }
    m.m01 += v * sum;
  }
  m = g.reduce(m, sum_op{});
  return fast_atan2_degrees(static_cast<float>(m.m01), static_cast<float>(m.m10));
}

/// Rotation of a descriptor's pattern.
struct rotation {
  float cosine, sine;
};

namespace detail {

/// Cosine and sine of a float of [0, 2 pi], with the algorithm and the coefficients of sincosf() in
/// Arm's Optimized Routines (MIT licence, see NOTICE), which glibc has from 2.28 on: polynomials in
/// double, rounded once. With and without fused multiply-add it gives, for every float of [0, 2
/// pi], what glibc's cosf() and sinf() give with and without.
/// @tparam Fused whether sums are fused with their products: fewer instructions, where they exist
template <bool Fused>
FT_HOST_DEVICE rotation rotation_of(float radians) {
  auto const sum = [](double a, double b, double c) {  // a b + c
    if constexpr (Fused) {
      return ::fma(a, b, c);
    } else {
      return mul(a, b) + c;
    }
  };
  constexpr double quarters = 10680707.430881744;  // 2^24 * 2 / pi
  constexpr double quarter_turn = 1.5707963267948966;
  int const quarter = (static_cast<int>(double{radians} * quarters) + 0x800000) >> 24;
  double const r = sum(-static_cast<double>(quarter), quarter_turn, double{radians});
  double const r2 = r * r;
  double const r3 = r * r2;
  double const r4 = r2 * r2;
  double s = sum(r3, -0.16666654943701084, r);
  double c = sum(r4, 0.041666623324344516, sum(r2, -0.49999999725108224, 1.0));
  s = sum(r3 * r2, sum(r2, -0.00019517298981385725, 0.008332178146138854), s);
  c = sum(r4 * r2, sum(r2, 2.4390450703564542e-05, -0.001388676379437604), c);
  bool const odd = (quarter & 1) != 0;
  auto const cosine = static_cast<float>(odd ? s : c);
  auto const sine = static_cast<float>(odd ? c : s);
  return {((quarter + 1) & 2) != 0 ? -cosine : cosine, (quarter & 2) != 0 ? -sine : sine};
}

}  // namespace detail

/// @param angle degrees of [0, 360], from orientation()
FT_HOST_DEVICE inline rotation rotation_by(float angle) {
  float const radians = detail::mul(angle, static_cast<float>(3.14159265358979323846 / 180.0));
#if defined(__CUDA_ARCH__)
  return detail::rotation_of<true>(radians);
#else
  return detail::rotation_of<false>(radians);
#endif
}

}  // namespace FT_ABI
}  // namespace ft
