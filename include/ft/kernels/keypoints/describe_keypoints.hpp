// SPDX-License-Identifier: Apache-2.0
/// @file Stage: orientation and descriptor of keypoints from another detector. Source:
/// specification section 4.
#pragma once

#include <cmath>
#include <cstdint>

#include "ft/containers/image_pyramid.hpp"
#include "ft/containers/keypoints.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/kernels/keypoints/descriptor.hpp"
#include "ft/kernels/keypoints/orientation.hpp"
#include "ft/types/images.hpp"

namespace ft {
inline namespace FT_ABI {

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
    descriptor& orb = keypoints.orb(item);
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

}  // namespace FT_ABI
}  // namespace ft
