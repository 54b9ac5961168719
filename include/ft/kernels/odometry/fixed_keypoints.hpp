// SPDX-License-Identifier: Apache-2.0
/// @file Stage: which keypoints are of what is fixed to a camera.
#pragma once

#include <cstddef>

#include "ft/containers/frame.hpp"
#include "ft/containers/image_pyramid.hpp"
#include "ft/containers/keypoints.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/kernels/odometry/image_changes.hpp"

namespace ft {
inline namespace FT_ABI {

/// Inputs and output of mark_fixed_keypoints(), in executor memory.
struct fixed_keypoints {
  frame_view frame;
  keypoints_view seen;         ///< the same keypoints where the images have them
  pyramid_geometry geometry;   ///< the position of a keypoint depends on its octave
  image_changes_view changes;  ///< of the frame's images
  float least_disparity = 0;   ///< pixels; of keypoints with a disparity, those with this one
  /// Output, [batch][cameras * capacity] 0 = it is not, 1 = it is, or fixed_for_long
  unsigned char* fixed = nullptr;
};

/// Of keypoints whose part of the image has stayed for many frames while others moved.
inline constexpr unsigned char fixed_for_long = 2;

namespace detail {

/// Item: a keypoint.
struct mark_fixed_keypoint {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int item, fixed_keypoints const& in) const {
    int const b = item / in.frame.numbers();
    int const i = item - b * in.frame.numbers();
    in.fixed[item] = mark_of(in, b, i);
  }

private:
  /// What is far may stay where it is, too; of a keypoint without disparity that takes many frames
  /// to tell, unless much of the image is fixed.
  FT_HOST_DEVICE static unsigned char mark_of(fixed_keypoints const& in, int b, int i) {
    frame_view const& frame = in.frame;
    int const c = i / frame.capacity();
    int const k = i - c * frame.capacity();
    int const image = frame.image(b, c);
    keypoints_view const kp = frame.camera(b, c);
    if (in.changes.of[image].fixed == 0 || k >= *kp.count) { return 0; }
    std::ptrdiff_t const at = static_cast<std::ptrdiff_t>(b) * frame.numbers() + i;
    float const right = frame.right_x != nullptr ? frame.right_x[at] : -1.0f;
    bool const has_disparity = right >= 0;
    if (has_disparity &&
        strict_float(kp.x(k)) - strict_float(right) < strict_float(in.least_disparity)) {
      return 0;
    }
    keypoints_view const seen = in.seen.slice(image);
    float const x = in.geometry.column(seen.x(k), kp.octave(k));
    float const y = in.geometry.row(seen.y(k), kp.octave(k));
    auto const stays = [&](bool for_long) {
      return in.changes.is_fixed(image, x, y, in.geometry.width[0], in.geometry.height[0],
                                 for_long);
    };
    if (stays(true)) { return fixed_for_long; }
    bool const is_near = has_disparity || in.changes.of[image].by_quarters != 0;
    return is_near && stays(false) ? 1 : 0;
  }
};

}  // namespace detail

/// Marks the keypoints of what is fixed to a camera, as watch_images() found it. Asynchronous on
/// `exec`; allocates nothing; one launch.
template <typename Exec>
void mark_fixed_keypoints(Exec const& exec, fixed_keypoints const& in) {
  for_each_item<per_thread>(exec, in.frame.batch * in.frame.numbers(),
                            detail::mark_fixed_keypoint{}, in);
}

}  // namespace FT_ABI
}  // namespace ft
