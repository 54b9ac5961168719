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

}  // namespace detail

/// Byte `index` of the steered BRIEF descriptor at (x, y) of a blurred level. @param a,b cosine and
/// sine
FT_HOST_DEVICE inline std::uint32_t descriptor_byte(gray_view blurred, int x, int y, float a,
                                                    float b, pattern_pair const* pattern,
                                                    int index) {
  auto const at = [&](int dx, int dy) { return blurred(x + dx, y + dy); };
  std::uint32_t byte = 0;
  for (int bit = 0; bit < 8; ++bit) {
    byte |= static_cast<std::uint32_t>(detail::is_darker(pattern[8 * index + bit], a, b, at))
            << bit;
  }
  return byte;
}

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
    int all = 0;
    for (int l = 0; l < layout.levels; ++l) { all += counts[l]; }
    stereo_overlap const overlap = overlaps[image];
    int before = 0;  // corners in lower slots
    int stereo = 0;  // those of them inside the overlap
    for (int base = 0; base < layout.total; base += g.size()) {
      int const slot = base + g.rank();
      int const l = layout.level_of(slot);
      int const at = image * layout.total + slot;
      bool const valid = slot < layout.total && slot - layout.first[l] < counts[l];
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
      int valid_here = 0;
      int inside_here = 0;
      int const rank = before + g.exclusive_count(valid, valid_here);
      int const stereo_rank = stereo + g.exclusive_count(inside, inside_here);
      if (valid) {
        place[at] = inside ? all - 1 - stereo_rank : rank - stereo_rank;
        int const to = image * out.capacity + place[at];
        get<field::x>(out, to) = x;
        get<field::y>(out, to) = y;
        get<field::response>(out, to) = static_cast<float>(c.response);
        get<field::octave>(out, to) = l;
      }
      before += valid_here;
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
      describe_by_words(g, centre, a, b, pattern, orb);
    } else {
      auto* const bytes = reinterpret_cast<unsigned char*>(&orb);
      for (int i = 0; i < 32; ++i) {
        bytes[i] = static_cast<unsigned char>(descriptor_byte(level, x, y, a, b, pattern, i));
      }
    }
    if (g.rank() == 0) { get<field::angle>(out, to) = angle; }
  }

private:
  /// Bit by bit, neighbouring bits by neighbouring threads. @param centre the keypoint in scratch
  template <typename Group>
  FT_HOST_DEVICE static void describe_by_words(Group g, std::uint8_t const* centre, float a,
                                               float b, pattern_pair const* pattern,
                                               descriptor& orb) {
    auto const at = [&](int dx, int dy) { return centre[dy * 4 * window_words + dx]; };
    if constexpr (Group::max_threads == 32) {
#if defined(__CUDA_ARCH__)
      constexpr int words = 8;
      pattern_pair p[words];
      FT_UNROLL
      for (int k = 0; k < words; ++k) { p[k] = pattern[32 * k + g.rank()]; }
      std::uint32_t mine = 0;  // thread k keeps word k
      FT_UNROLL
      for (int k = 0; k < words; ++k) {
        std::uint32_t const word = __ballot_sync(0xffffffffu, detail::is_darker(p[k], a, b, at));
        mine = g.rank() == k ? word : mine;
      }
      if (g.rank() < words) { orb.words[g.rank()] = mine; }
#endif
    } else {
      auto* const bytes = reinterpret_cast<unsigned char*>(&orb);
      for (int i = g.rank(); i < 32; i += g.size()) {
        unsigned byte = 0;
        for (int bit = 0; bit < 8; ++bit) {
          byte |= static_cast<unsigned>(detail::is_darker(pattern[8 * i + bit], a, b, at)) << bit;
        }
        bytes[i] = static_cast<unsigned char>(byte);
      }
    }
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
