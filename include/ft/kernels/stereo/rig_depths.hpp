// SPDX-License-Identifier: Apache-2.0
/// @file Stages: depths of the keypoints of a mixed_rig, of pairs that are not rectified and of
/// depth images.
#pragma once

#include <cstddef>

#include "ft/cameras/any_camera.hpp"
#include "ft/cameras/mixed_rig.hpp"
#include "ft/cameras/stereo_rig.hpp"
#include "ft/containers/image_pyramid.hpp"
#include "ft/containers/keypoints.hpp"
#include "ft/containers/stereo_matches.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/atomics.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/kernels/images/depth_association.hpp"
#include "ft/kernels/stereo/fisheye.hpp"
#include "ft/kernels/stereo/refine_partners.hpp"

namespace ft {
inline namespace FT_ABI {

using any_pair = stereo_rig<any_camera<float>, any_camera<float>>;

/// A pair of a mixed_rig that is not rectified, and where its depths go. Images 2 c of a rig are
/// those of its cameras.
struct pair_of_rig {
  int left = 0;   ///< camera
  int right = 0;  ///< camera
  int cameras = 1;
  /// [batch][cameras * capacity] number of the partner of a keypoint, as in frame_view; -1 = none
  int* partner = nullptr;
  float* depth = nullptr;  ///< [batch][cameras * capacity] metres at the keypoint's octave

  FT_HOST_DEVICE int image(int b, int camera) const { return 2 * (cameras * b + camera); }
  /// Index of the first keypoint of a rig.
  FT_HOST_DEVICE std::ptrdiff_t first(int b, int capacity) const {
    return static_cast<std::ptrdiff_t>(b) * cameras * capacity;
  }
};

namespace detail {

/// Item: a keypoint of the left cameras. Finds its partner and depth.
struct match_pair_of_rig {
  static constexpr bool wide_on_host = true;
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int item,
                                 fisheye_stereo<any_pair> const& stereo, pair_of_rig const& pair,
                                 keypoints_view const& keypoints) const {
    int const capacity = keypoints.capacity;
    int const b = item / capacity;
    int const i = item % capacity;
    keypoints_view const left = keypoints.slice(pair.image(b, pair.left));
    keypoints_view const right = keypoints.slice(pair.image(b, pair.right));
    if (i >= *left.count) { return; }
    vec3<float> point;
    int const j = match_fisheye_keypoint<any_pair>::find(
        g, stereo, {left, right, i, 0, *right.count}, left.orb(i), point);
    if (j < 0 || g.rank() != 0) { return; }
    std::ptrdiff_t const first = pair.first(b, capacity);
    int const mine = pair.left * capacity + i;
    int const theirs = pair.right * capacity + j;
    pair.partner[first + mine] = theirs;
    atomic_max(pair.partner + first + theirs, mine);  // of several the last one stays
    pair.depth[first + mine] = stereo.geometry.level_depth(point.z, left.octave(i));
  }
};

/// Item: a keypoint of the left cameras. As refine_partner.
struct refine_pair_of_rig {
  static constexpr bool wide_on_host = true;
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int item,
                                 refine_partner<any_pair> const& refining, pair_of_rig const& pair,
                                 image_pyramid_view const& pyramid,
                                 keypoints_view const& keypoints) const {
    int const capacity = keypoints.capacity;
    int const b = item / capacity;
    int const i = item % capacity;
    int const left_image = pair.image(b, pair.left);
    int const right_image = pair.image(b, pair.right);
    keypoints_view const left = keypoints.slice(left_image);
    keypoints_view const right = keypoints.slice(right_image);
    int const* const partner = pair.partner + pair.first(b, capacity);
    int const mine = pair.left * capacity + i;
    if (i >= *left.count || partner[mine] < 0 || partner[partner[mine]] != mine) { return; }
    float& depth = pair.depth[pair.first(b, capacity) + mine];
    int const octave = left.octave(i);
    vec3<float> point{0, 0, pyramid.geometry.depth(depth, octave)};
    int const j = partner[mine] - pair.right * capacity;
    if (!refining.refine(g, pyramid, {left, right, i, j, left_image, right_image}, point)) {
      return;
    }
    depth = pyramid.geometry.level_depth(point.z, octave);
  }
};

/// Item: a keypoint of a camera. Its depth and virtual right column, if the camera has a depth
/// image, as in associate_depth().
template <int N>
struct read_rig_depth {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int item, mixed_rig<N> const& rig,
                                 pyramid_geometry const& geometry, keypoints_view const& keypoints,
                                 depth_sources_view const& images,
                                 stereo_matches_view const& out) const {
    int const entry = item / keypoints.capacity;  // N * b + c
    int const i = item % keypoints.capacity;
    mixed_rig_camera const& camera = rig.of[entry % N];
    keypoints_view const of = keypoints.slice(2 * entry);
    if (!camera.has_depth_image || i >= *of.count) { return; }
    if (images.of[entry].data == nullptr) { return; }  // not in this frame
    int const octave = of.octave(i);
    float const x = geometry.column(of.x(i), octave);
    float const y = geometry.row(of.y(i), octave);
    // Inside after rounding; NaN is outside.
    if (!(x > -0.5f && x < static_cast<float>(images.width) - 0.5f && y > -0.5f &&
          y < static_cast<float>(images.height) - 0.5f)) {
      return;
    }
    float const scale = camera.depth_scale > 0 ? camera.depth_scale : 1.0f;
    strict_float const d = strict_float(images.at(entry, round_away(x), round_away(y))) * scale;
    auto const ray = camera.camera.template cast<strict_float>().unproject({x, y});
    bool const seen = d > 0.0f && d >= camera.min_depth && d <= camera.max_depth &&
                      scalar::is_finite(d) && ray.valid && ray.direction.z > 0.0f;
    if (!seen) { return; }
    strict_float const column = strict_float(x) - camera.bf() / d;
    out.depth(item) = geometry.level_depth(d.value, octave);
    out.right_x(item) = column >= 0.0f ? geometry.level_column(column.value, octave) : -1.0f;
    out.score(item) = 0;
  }
};

}  // namespace detail

/// Depths of the keypoints of a pair's left camera, and their partners, as match_stereo_fisheye().
/// Asynchronous on `exec`; allocates nothing; one launch.
/// @param stereo its rig is the pair; `mono_count` is not read
/// @param pair `partner` was cleared to -1, and `depth`
template <typename Exec>
void match_pair(Exec const& exec, fisheye_stereo<any_pair> const& stereo, pair_of_rig const& pair,
                keypoints_view const& keypoints) {
  int const rigs = keypoints.batch / (2 * pair.cameras);
  for_each_item<per_warp>(exec, rigs * keypoints.capacity, detail::match_pair_of_rig{}, stereo,
                          pair, keypoints);
}

/// Moves the right keypoints of a pair's matches, as refine_partners(). Asynchronous on `exec`;
/// allocates nothing; one launch.
template <typename Exec>
void refine_pair(Exec const& exec, any_pair const& rig, pair_of_rig const& pair,
                 image_pyramid_view const& pyramid, keypoints_view const& keypoints) {
  int const rigs = keypoints.batch / (2 * pair.cameras);
  for_each_item<per_warp>(exec, rigs * keypoints.capacity, detail::refine_pair_of_rig{},
                          detail::refine_partner<any_pair>{rig}, pair, pyramid, keypoints);
}

/// Depths and virtual right columns of the keypoints of the cameras with a depth image; of the
/// others they stay. Asynchronous on `exec`; allocates nothing; one launch.
/// @param images batch entry N b + c is that of camera c of rig b; null = none in this frame
/// @param out [N b + c][capacity]
template <typename Exec, int N>
void read_rig_depths(Exec const& exec, mixed_rig<N> const& rig, pyramid_geometry const& geometry,
                     keypoints_view const& keypoints, depth_sources_view const& images,
                     stereo_matches_view const& out) {
  for_each_item<per_thread>(exec, keypoints.batch / 2 * keypoints.capacity,
                            detail::read_rig_depth<N>{}, rig, geometry, keypoints, images, out);
}

}  // namespace FT_ABI
}  // namespace ft
