// SPDX-License-Identifier: Apache-2.0
/// @file Stage: orientation and descriptor of each kept corner. Source: specification section 4.
#pragma once

#include <cmath>
#include <cstdint>

#include "ft/containers/corners.hpp"
#include "ft/containers/frame_arrivals.hpp"
#include "ft/containers/image_pyramid.hpp"
#include "ft/containers/keypoints.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/core/execution.hpp"
#include "ft/kernels/detail/packed_pixels.hpp"
#include "ft/kernels/distribution/layout.hpp"
#include "ft/kernels/keypoints/descriptor.hpp"
#include "ft/kernels/keypoints/order.hpp"
#include "ft/kernels/keypoints/orientation.hpp"
#include "ft/types/images.hpp"
#include "ft/types/orb_params.hpp"

namespace ft {
inline namespace FT_ABI {

// Stage: orientation and descriptor of keypoints from another detector. Source:
// specification section 4.

/// The columns of a caller's keypoints that are read (x, y, octave) and written (angle, orb).
using described_view = soa_view<field::x, field::y, field::octave, field::angle, field::orb>;

namespace detail {

/// One keypoint: describes the nearest pixel of its level.
struct describe_keypoint {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int item, description_source const& from,
                                 described_view const& keypoints) const {
    int const image = item / keypoints.capacity;
    if (item % keypoints.capacity >= keypoints.count[image]) { return; }
    binary_descriptor<256>& orb = orb_bits(keypoints.orb(item));
    int const l = keypoints.octave(item);
    pixel const at = nearest_pixel(from.pyramid.geometry, keypoints.x(item), keypoints.y(item), l);
    if (!at.valid) {
      if (g.rank() == 0) { keypoints.angle(item) = -1; }
      for (int i = g.rank(); i < 8; i += g.size()) { orb.words[i] = 0; }
      return;
    }
    float const angle = orientation(g, from.pyramid.level(image, l), at.x, at.y);
    rotation const turn = rotation_by(angle);
    gray_view const level = from.blurred.level(image, l);
    if constexpr (Group::max_threads > 1) {
      auto const sample = [&](int dx, int dy) { return level(at.x + dx, at.y + dy); };
      describe_by_warp(g, sample, turn, lane_tests<Group>(g, from.pattern), orb);
    } else {
      describe_alone(level, at.x, at.y, turn, from.pattern, orb);
    }
    if (g.rank() == 0) { keypoints.angle(item) = angle; }
  }

private:
  struct pixel {
    int x, y;
    bool valid;
  };
  /// Invalid if there is no such octave, the position is not finite, or the pattern leaves the
  /// level.
  FT_HOST_DEVICE static pixel nearest_pixel(pyramid_geometry const& g, float x, float y, int l) {
    if (l < 0 || l >= g.levels) { return {0, 0, false}; }
    float const lx = div(x, g.scale[l]);
    float const ly = div(y, g.scale[l]);
    float const border = static_cast<float>(pattern_radius);
    if (!(lx >= border && lx <= static_cast<float>(g.width[l]) - 1 - border && ly >= border &&
          ly <= static_cast<float>(g.height[l]) - 1 - border)) {
      return {0, 0, false};
    }
    return {round_to_even(lx), round_to_even(ly), true};
  }
};

}  // namespace detail

/// Computes angle (degrees, [0, 360]) and descriptor of keypoints given by x, y (pixels of the
/// input image) and octave. A keypoint gets the angle -1 and a descriptor of zeros if it is less
/// than 18 pixels of its level from the border, is not finite, or has no octave of the pyramid.
/// Asynchronous on `exec`; allocates nothing; one launch.
/// @param keypoints one batch entry per image of the pyramid; all in executor memory
template <typename Exec>
void describe_keypoints(Exec const& exec, description_source const& from,
                        described_view const& keypoints) {
  for_each_item<per_warp>(exec, keypoints.batch * keypoints.capacity, detail::describe_keypoint{},
                          from, keypoints);
}

/// Inputs and outputs of the description of a batch's kept corners, all in executor memory. Its
/// last four members are those of order_corners().
struct describing_view {
  description_source from;
  distribution_view kept;
  int const* place = nullptr;  ///< [batch][kept.layout.total] place of each corner's keypoint
  keypoints_view out;          ///< only angles and descriptors are written
  /// Signals of a concurrent order_corners(): images whose places are written.
  frame_arrivals arrivals;
  /// [batch] For an image that is completely inside or outside its overlap, places are computed
  /// without waiting. Without overlaps they are read. Required with `arrivals`.
  stereo_overlap const* overlaps = nullptr;
};

namespace detail {

/// One kept corner: the angle and descriptor of its keypoint.
struct describe_corner {
  static constexpr bool wide_on_host = true;
  static constexpr int window = 2 * pattern_radius + 1;
  static constexpr int window_words = (window + 3 + 3) / 4;
  struct scratch {  ///< device: the window around the keypoint
    std::uint32_t pixels[window * window_words];
  };

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int item, describing_view const& v) const {
    distribution_layout const& layout = v.kept.layout;
    int const image = item / layout.total;
    int const slot = item % layout.total;
    // All loads are in flight together; a slot without a corner holds stale but readable data.
    corner const c = v.kept.kept[item];
    int const* const counts = v.kept.kept_count + image * layout.levels;
    [[maybe_unused]] level_count const own(g, counts, layout.levels);
    [[maybe_unused]] stereo_overlap const overlap =
        Group::max_threads > 1 && v.overlaps != nullptr ? v.overlaps[image] : unknown_overlap();
    int const l = level_of(layout, slot);
    int const count = Group::max_threads > 1 ? g.shuffle(own.count, l) : counts[l];
    g.sync();
    if (slot - layout.first[l] >= count) { return; }

    int const x = c.x + corner_border;
    int const y = c.y + corner_border;
    gray_view const sharp = v.from.pyramid.level(image, l);
    gray_view const level = v.from.blurred.level(image, l);
    int to = image * v.out.capacity;
    float angle = 0;
    if constexpr (Group::max_threads > 1) {
      lane_tests<Group> const tests(g, v.from.pattern);
      angle = stage_and_turn(g, sharp, level, x, y, s.pixels);
      g.sync();
      rotation const turn = rotation_by(angle);
      int const width = v.from.pyramid.geometry.width[0];
      bool const none = overlap.has_none(width);
      if (none || overlap.has_all(width)) {
        int const rank = own.below(g, l) + slot - layout.first[l];
        to += none ? rank : own.all(g) - 1 - rank;
      } else {
        v.arrivals.await_placed(g, image);
        to += v.place[item];
      }
      auto const* const centre = reinterpret_cast<std::uint8_t const*>(s.pixels) +
                                 pattern_radius * (4 * window_words + 1) +
                                 ((x - pattern_radius) & 3);
      auto const at = [&](int dx, int dy) { return centre[dy * 4 * window_words + dx]; };
      describe_by_warp(g, at, turn, tests, orb_bits(v.out.orb(to)));
    } else {
      fetch_window(level, x, y);
      angle = orientation(g, sharp, x, y);
      rotation const turn = rotation_by(angle);
      to += v.place[item];
      describe_alone(level, x, y, turn, v.from.pattern, orb_bits(v.out.orb(to)));
    }
    if (g.rank() == 0) { v.out.angle(to) = angle; }
  }

private:
  /// Numbers of kept corners of an image's levels, one level per thread.
  struct level_count {
    int level, count;

    template <typename Group>
    FT_HOST_DEVICE level_count(Group g, int const* counts, int levels) : level(g.rank()), count(0) {
      static_assert(Group::max_threads == 1 || Group::max_threads >= max_levels, "one a thread");
      if (Group::max_threads > 1 && level < levels) { count = counts[level]; }
    }
    template <typename Group>
    FT_HOST_DEVICE int below(Group g, int l) const {  ///< on levels below l
      return g.reduce(level < l ? count : 0, sum_op{});
    }
    template <typename Group>
    FT_HOST_DEVICE int all(Group g) const {
      return g.reduce(count, sum_op{});
    }
  };

  /// An overlap that is neither empty nor the whole image.
  FT_HOST_DEVICE static stereo_overlap unknown_overlap() { return {1e-30f, 1e-30f}; }
  /// layout.level_of() with independent comparisons.
  FT_HOST_DEVICE static int level_of(distribution_layout const& layout, int slot) {
    int l = 0;
    FT_UNROLL
    for (int k = 1; k < max_levels; ++k) {
      l += static_cast<int>((k < layout.levels) & (slot >= layout.first[k]));
    }
    return l;
  }
  /// Copies the window into scratch and returns the angle. The loads for both are in flight
  /// together.
  template <typename Group>
  FT_HOST_DEVICE static float stage_and_turn(Group g, gray_view sharp, gray_view level, int x,
                                             int y, std::uint32_t* pixels) {
    bool const words = Group::max_threads >= 32 && has_word_rows(sharp);
    disc_words<Group> disc;
    if (words) { disc = disc_words<Group>(g, sharp, x, y); }
    stage_rectangle<12>(g, level, {x - pattern_radius, y - pattern_radius, window, window}, pixels,
                        window_words);
    if (!words) { return orientation(g, sharp, x, y); }
    moments const m = disc.sums(g);
    return fast_atan2_degrees(static_cast<float>(m.m01), static_cast<float>(m.m10));
  }
  /// Prefetches the window into the caches, on the host.
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

}  // namespace detail

/// Computes angles and descriptors of ordered keypoints. Asynchronous on `exec`; allocates nothing;
/// one launch. @throws bad_argument for arrivals without overlaps
template <typename Exec>
void describe_corners(Exec const& exec, describing_view const& v) {
  detail::require(!v.arrivals.overlapping() || v.overlaps != nullptr,
                  "descriptors concurrent with the order need its overlaps");
  for_each_item<per_warp>(exec, v.from.pyramid.batch * v.kept.layout.total,
                          detail::describe_corner{}, v);
}

}  // namespace FT_ABI
}  // namespace ft
