// SPDX-License-Identifier: Apache-2.0
/// @file Stages: place of each kept corner in the output, and its orientation and descriptor.
/// Source: specification section 4.
#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>

#include "ft/containers/image_pyramid.hpp"
#include "ft/containers/keypoints.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/kernels/detail/orb_pattern.hpp"
#include "ft/kernels/detail/packed_pixels.hpp"
#include "ft/kernels/distribution.hpp"
#include "ft/kernels/orientation.hpp"

namespace ft {
inline namespace FT_ABI {

/// Pixel columns seen by both cameras of a fisheye pair; keypoints inside go to the end of the
/// list. The default meets no keypoint.
struct stereo_overlap {
  float left = 0;
  float right = 0;
};

/// Points of a descriptor's pattern lie so far from the keypoint at most, rotated and rounded.
inline constexpr int pattern_radius = 18;

namespace detail {

/// Bit of a descriptor's test, rotated. @param a,b cosine and sine @param at the pixel at an offset
/// from the keypoint
template <typename Pixel>
FT_HOST_DEVICE bool is_darker(pattern_pair p, float a, float b, Pixel const& at) {
  strict_float const ca = a;
  strict_float const sb = b;
  auto const sample = [&](int px, int py) {
    strict_float const fx = static_cast<float>(px);
    strict_float const fy = static_cast<float>(py);
    int const dx = round_to_even((fx * ca - fy * sb).value);
    int const dy = round_to_even((fx * sb + fy * ca).value);
    return at(dx, dy);
  };
  return sample(p.x0, p.y0) < sample(p.x1, p.y1);
}

/// Keeps the products in an array apart from the sums that follow, as keep_apart() does.
template <int N>
FT_HOST_DEVICE FT_INLINE void keep_all_apart(float (&values)[N]) {
#if !defined(__CUDA_ARCH__) && ((defined(__FMA__) && defined(__x86_64__)) || defined(__aarch64__))
  asm("" : "+m"(values));
#else
  static_cast<void>(values);
#endif
}

/// Word `index` of the steered BRIEF descriptor at `centre`, by a single thread: the 64 points of
/// its tests are turned in loops that become vectors. @param stride of the level, below 2^15
FT_HOST_DEVICE FT_INLINE std::uint32_t descriptor_word(std::uint8_t const* centre, int stride,
                                                       float a, float b,
                                                       pattern_pair const* pattern, int index) {
  constexpr int points = 64;
  static_assert(sizeof(pattern_pair) == 4, "nothing but the points");
  auto const* const tests = reinterpret_cast<std::int8_t const*>(pattern + 32 * index);
  float xa[points], xb[points], ya[points], yb[points];
  for (int i = 0; i < points; ++i) {
    auto const x = static_cast<float>(tests[2 * i]);
    auto const y = static_cast<float>(tests[2 * i + 1]);
    xa[i] = x * a;
    xb[i] = x * b;
    ya[i] = y * a;
    yb[i] = y * b;
  }
  keep_all_apart(xa);
  keep_all_apart(xb);
  keep_all_apart(ya);
  keep_all_apart(yb);
  // Adding this leaves no bits below 1: the nearest integer, halves to even, as round_to_even().
  constexpr float whole = 12582912.0f;
  auto const pitch = static_cast<float>(stride);
  std::int32_t at[points];
  for (int i = 0; i < points; ++i) {
    float const dx = (xa[i] - yb[i] + whole) - whole;
    float const dy = (xb[i] + ya[i] + whole) - whole;
    at[i] = static_cast<std::int32_t>(dy * pitch + dx);  // whole numbers below 2^24
  }
  std::uint32_t word = 0;
  for (int k = 31; k >= 0; --k) {
    word += word + static_cast<std::uint32_t>(centre[at[2 * k]] < centre[at[2 * k + 1]]);
  }
  return word;
}

/// Steered BRIEF descriptor by several threads: bit by bit, neighbouring bits by neighbouring
/// threads. @param a,b cosine and sine @param at(dx, dy) a pixel beside the keypoint
template <typename Group, typename Sample>
FT_HOST_DEVICE void describe_together(Group g, Sample const& at, float a, float b,
                                      pattern_pair const* pattern, descriptor& orb) {
  if constexpr (Group::max_threads == 32) {
#if defined(__CUDA_ARCH__)
    constexpr int words = 8;
    pattern_pair p[words];
    FT_UNROLL
    for (int k = 0; k < words; ++k) { p[k] = pattern[32 * k + g.rank()]; }
    std::uint32_t mine = 0;  // thread k keeps word k
    FT_UNROLL
    for (int k = 0; k < words; ++k) {
      std::uint32_t const word = __ballot_sync(0xffffffffu, is_darker(p[k], a, b, at));
      mine = g.rank() == k ? word : mine;
    }
    if (g.rank() < words) { orb.words[g.rank()] = mine; }
#endif
  } else {
    auto* const bytes = reinterpret_cast<unsigned char*>(&orb);
    for (int i = g.rank(); i < 32; i += g.size()) {
      unsigned byte = 0;
      for (int bit = 0; bit < 8; ++bit) {
        byte |= static_cast<unsigned>(is_darker(pattern[8 * i + bit], a, b, at)) << bit;
      }
      bytes[i] = static_cast<unsigned char>(byte);
    }
  }
}

}  // namespace detail

/// One image: where each kept corner goes, and what is known of its keypoint. Level by level in
/// list order; inside the overlap from the end of the array backwards.
struct order_image {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int image, pyramid_geometry const& geometry,
                                 distribution_view const& kept, stereo_overlap const* overlaps,
                                 int* place, keypoints_view const& out, int* mono_count) const {
    distribution_layout const& layout = kept.layout;
    int const* const counts = kept.kept_count + image * layout.levels;
    stereo_overlap const overlap = overlaps[image];
    int all = 0;
    int stereo = 0;  // corners in lower slots inside the overlap
    for (int base = 0; base < layout.total; base += g.size()) {
      int const slot = base + g.rank();
      int const l = layout.level_of(slot);
      int const at = image * layout.total + slot;
      int rank = slot - layout.first[l];
      bool valid = false;
      all = 0;
      for (int k = 0; k < layout.levels; ++k) {
        int const count = counts[k];
        if (k == l) {
          valid = slot < layout.total && rank < count;
          rank += all;
        }
        all += count;
      }
      corner c{};
      float x = 0;
      float y = 0;
      bool inside = false;
      if (valid) {
        c = kept.kept[at];
        x = static_cast<float>(c.x + corner_border);
        y = static_cast<float>(c.y + corner_border);
        if (l > 0) {
          x = detail::mul(x, geometry.scale[l]);
          y = detail::mul(y, geometry.scale[l]);
        }
        inside = x >= overlap.left && x <= overlap.right;
      }
      int inside_here = 0;
      int const stereo_rank = stereo + g.exclusive_count(inside, inside_here);
      if (valid) {
        place[at] = inside ? all - 1 - stereo_rank : rank - stereo_rank;
        int const to = image * out.capacity + place[at];
        get<field::x>(out, to) = x;
        get<field::y>(out, to) = y;
        get<field::response>(out, to) = static_cast<float>(c.response);
        get<field::octave>(out, to) = l;
      }
      stereo += inside_here;
    }
    if (g.rank() == 0) {
      out.count[image] = all;
      mono_count[image] = all - stereo;
    }
  }
};

/// One kept corner: the angle and descriptor of its keypoint.
struct describe_corner {
  static constexpr bool wide_on_host = true;
  static constexpr int window = 2 * pattern_radius + 1;
  static constexpr int window_words = (window + 3 + 3) / 4;
  struct scratch {  ///< where threads work together: the window around the keypoint
    std::uint32_t pixels[window * window_words];
  };

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int item, image_pyramid_view const& pyramid,
                                 image_pyramid_view const& blurred, distribution_view const& kept,
                                 pattern_pair const* pattern, int const* place,
                                 keypoints_view const& out) const {
    distribution_layout const& layout = kept.layout;
    int const image = item / layout.total;
    int const slot = item % layout.total;
    int const l = layout.level_of(slot);
    if (slot - layout.first[l] >= kept.kept_count[image * layout.levels + l]) { return; }

    corner const c = kept.kept[item];
    int const x = c.x + corner_border;
    int const y = c.y + corner_border;
    gray_view const level = blurred.level(image, l);
    if (g.size() > 1) {
      detail::stage_rectangle<12>(g, level, x - pattern_radius, y - pattern_radius, window, window,
                                  s.pixels, window_words);
    } else {
      fetch_window(level, x, y);
    }
    float const angle = orientation(g, pyramid.level(image, l), x, y);
    float const radians = detail::mul(angle, static_cast<float>(3.14159265358979323846 / 180.0));
    float const a = static_cast<float>(::cos(static_cast<double>(radians)));
    float const b = static_cast<float>(::sin(static_cast<double>(radians)));

    int const to = image * out.capacity + place[item];
    descriptor& orb = get<field::orb>(out, to);
    if (g.size() > 1) {
      g.sync();
      auto const* const centre = reinterpret_cast<std::uint8_t const*>(s.pixels) +
                                 pattern_radius * (4 * window_words + 1) +
                                 ((x - pattern_radius) & 3);
      auto const at = [&](int dx, int dy) { return centre[dy * 4 * window_words + dx]; };
      detail::describe_together(g, at, a, b, pattern, orb);
    } else {
      for (int i = 0; i < 8; ++i) {
        orb.words[i] = detail::descriptor_word(level.row(y) + x, level.stride, a, b, pattern, i);
      }
    }
    if (g.rank() == 0) { get<field::angle>(out, to) = angle; }
  }

private:
  /// Has a window that is needed soon brought into the caches, on the host.
  FT_HOST_DEVICE static void fetch_window(gray_view level, int x, int y) {
#if defined(__GNUC__) && !defined(__CUDA_ARCH__)
    for (int r = -pattern_radius; r <= pattern_radius; ++r) {
      std::uint8_t const* const row = level.row(y + r) + x;
      __builtin_prefetch(row - pattern_radius);
      __builtin_prefetch(row + pattern_radius);
    }
#else
    static_cast<void>(level);
    static_cast<void>(x);
    static_cast<void>(y);
#endif
  }
};

/// Keypoints of a batch of images from their kept corners, in the contract's order; all but their
/// angles and descriptors. Asynchronous on `exec`; allocates nothing; one launch.
/// @param overlaps [batch] @param mono_count [batch] gets the keypoints outside the overlap
/// @param place [batch][layout.total] gets the place of a kept corner's keypoint; all in executor
/// memory
template <typename Exec>
void order_corners(Exec const& exec, pyramid_geometry const& geometry,
                   distribution_view const& kept, stereo_overlap const* overlaps,
                   keypoints_view const& out, int* mono_count, int* place) {
  for_each_item<per_block<1024>>(exec, out.batch, order_image{}, geometry, kept, overlaps, place,
                                 out, mono_count);
}

/// Angles and descriptors of ordered keypoints. Asynchronous on `exec`; allocates nothing; one
/// launch.
/// @param pattern [256], points within `pattern_radius` @param place from order_corners
template <typename Exec>
void describe_corners(Exec const& exec, image_pyramid_view const& pyramid,
                      image_pyramid_view const& blurred, distribution_view const& kept,
                      pattern_pair const* pattern, int const* place, keypoints_view const& out) {
  for_each_item<per_warp>(exec, pyramid.batch * kept.layout.total, describe_corner{}, pyramid,
                          blurred, kept, pattern, place, out);
}

}  // namespace FT_ABI
}  // namespace ft
