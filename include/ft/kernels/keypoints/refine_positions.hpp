// SPDX-License-Identifier: Apache-2.0
/// @file Stage: keypoints between the pixels of their levels.
#pragma once

#include "ft/containers/image_pyramid.hpp"
#include "ft/containers/keypoints.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/core/execution.hpp"
#include "ft/kernels/corners/detail/fast_score.hpp"
#include "ft/kernels/corners/detail/strip_host.hpp"
#include "ft/types/images.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// Item: a keypoint.
struct refine_position {
  using scratch = no_scratch;
  /// Pixels around a keypoint that are read: the corner test's circle of a neighbour.
  static constexpr int reach = 4;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int item, image_pyramid_view const& pyramid,
                                 keypoints_view const& all) const {
    int const image = item / all.capacity;
    keypoints_view const keypoints = all.slice(image);
    int const i = item - image * all.capacity;
    if (i >= *keypoints.count) { return; }
    int const octave = keypoints.octave(i);
    gray_view const level = pyramid.level(image, octave);
    float const inv_scale = pyramid.geometry.inv_scale[octave];
    int const u = round_away(mul(keypoints.x(i), inv_scale));
    int const v = round_away(mul(keypoints.y(i), inv_scale));
    if (u < reach || u + reach >= level.width || v < reach || v + reach >= level.height) { return; }
    scores_around const s = scores_at(level, u, v);
    strict_float const x = strict_float(static_cast<float>(u)) + top(s.left, s.middle, s.right);
    strict_float const y = strict_float(static_cast<float>(v)) + top(s.above, s.middle, s.below);
    keypoints.x(i) = (x * pyramid.geometry.scale[octave]).value;
    keypoints.y(i) = (y * pyramid.geometry.scale[octave]).value;
  }

private:
  struct scores_around {
    int left, middle, right, above, below;
  };
  FT_HOST_DEVICE static scores_around scores_at(gray_view level, int u, int v) {
#if !defined(__CUDA_ARCH__)
    if (level.width >= run + 6) { return scores_by_runs(level, u, v); }
#endif
    fast_circle const circle(level.stride);
    auto const score = [&](int x, int y) {
      return fast_score_of_pairs(level.row(y) + x, circle, 0);
    };
    return {score(u - 1, v), score(u, v), score(u + 1, v), score(u, v - 1), score(u, v + 1)};
  }
  /// The same in vectors of bytes, on the host. @pre the level is at least run + 6 pixels wide
  FT_HOST_DEVICE static scores_around scores_by_runs(gray_view level, int u, int v) {
    int const first = min_of(u - 1, level.width - 3 - run);
    int const at = u - first;
    std::uint8_t s[3][run];
    for (int y = 0; y < 3; ++y) {
      score_run<run>(level.row(v + y - 1) + first, level.stride, 0, s[y]);
    }
    return {s[1][at - 1], s[1][at], s[1][at + 1], s[0][at], s[2][at]};
  }
  static constexpr int run = 16;

  /// Where the parabola through three scores has its maximum, from the middle one, at most half a
  /// pixel away; 0 if it has none.
  FT_HOST_DEVICE static strict_float top(int before, int middle, int after) {
    int const bend = before - 2 * middle + after;
    if (bend >= 0) { return 0.0f; }
    strict_float const at = strict_float(static_cast<float>(before - after)) /
                            strict_float(static_cast<float>(2 * bend));
    return at > 0.5f ? strict_float(0.5f) : (at < -0.5f ? strict_float(-0.5f) : at);
  }
};

}  // namespace detail

/// Moves every keypoint to the maximum of its corner score between the pixels of its level: that of
/// the parabolas through its score and those of the neighbours in its row and in its column. No
/// keypoint moves by more than half a pixel of its level. One within four pixels of a level's
/// border stays. Scores are those of detect_corners(), without a threshold.
/// @param keypoints of detect_corners(), at whole pixels of their levels, a batch entry per image
/// Asynchronous on `exec`; allocates nothing; one launch.
/// @throws bad_argument for another number of images
template <typename Exec>
void refine_positions(Exec const& exec, image_pyramid_view const& pyramid,
                      keypoints_view const& keypoints) {
  detail::require(keypoints.batch == pyramid.batch, "the keypoints are those of other images");
  for_each_item<per_thread>(exec, keypoints.batch * keypoints.capacity, detail::refine_position{},
                            pyramid, keypoints);
}

}  // namespace FT_ABI
}  // namespace ft
