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

/// Cosine and sine in double, rounded to float. One argument reduction and no table, with the
/// polynomials of fdlibm's k_cos.c and k_sin.c. Equal to ::cos and ::sin for every float of
/// [0, 2 pi]. Needs fused multiply-add.
FT_HOST_DEVICE inline rotation rotation_by_fma(float radians) {
  int const quarter = round_to_even(radians * 0.636619772f);
  double const q = quarter;
  double const r = ::fma(q, -6.123233995736766e-17, ::fma(q, -1.5707963267948966, double{radians}));
  double const z = r * r;
  double s = 1.58969099521155010221e-10;
  double c = -1.13596475577881948265e-11;
  s = ::fma(s, z, -2.50507602534068634195e-08);
  c = ::fma(c, z, 2.08757232129817482790e-09);
  s = ::fma(s, z, 2.75573137070700676789e-06);
  c = ::fma(c, z, -2.75573143513906633035e-07);
  s = ::fma(s, z, -1.98412698298579493134e-04);
  c = ::fma(c, z, 2.48015872894767294178e-05);
  s = ::fma(s, z, 8.33333333332248946124e-03);
  c = ::fma(c, z, -1.38888888888741095749e-03);
  s = ::fma(s, z, -1.66666666666666324348e-01);
  c = ::fma(c, z, 4.16666666666666019037e-02);
  s = ::fma(s * z, r, r);
  c = ::fma(::fma(c, z, -0.5), z, 1.0);
  bool const odd = (quarter & 1) != 0;
  auto const cosine = static_cast<float>(odd ? s : c);
  auto const sine = static_cast<float>(odd ? c : s);
  return {((quarter + 1) & 2) != 0 ? -cosine : cosine, (quarter & 2) != 0 ? -sine : sine};
}

}  // namespace detail

/// @param angle degrees, from orientation()
FT_HOST_DEVICE inline rotation rotation_by(float angle) {
  float const radians = detail::mul(angle, static_cast<float>(3.14159265358979323846 / 180.0));
#if defined(__CUDA_ARCH__)
  return detail::rotation_by_fma(radians);
#else
  return {static_cast<float>(::cos(double{radians})), static_cast<float>(::sin(double{radians}))};
#endif
}

}  // namespace FT_ABI
}  // namespace ft
