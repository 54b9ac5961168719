// SPDX-License-Identifier: Apache-2.0
/// @file Stage: keypoints and partners that the caller has found, from staging memory.
#pragma once

#include "ft/containers/image_pyramid.hpp"
#include "ft/containers/keypoints.hpp"
#include "ft/containers/stereo_matches.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"
#include "ft/kernels/images/undistort.hpp"
#include "ft/types/features.hpp"

namespace ft {
inline namespace FT_ABI {

/// A caller's keypoints, in staging memory, which a device reads, or in executor memory.
struct taken_keypoints_view {
  keypoints_view keypoints;
  /// [images] 1 = positions are those of levels, see image_features; otherwise of the image.
  int* of_levels = nullptr;
  /// [rigs][capacity] right columns and depths, as image_features has them.
  float* right_x = nullptr;
  float* depth = nullptr;
  /// [rigs] which of these are given: sum of 1 and 2; 0 = none.
  int* partners = nullptr;
  static constexpr int has_right = 1, has_depth = 2;
  /// Depths are below, metres: what comes of them stays within what a map file may have.
  static constexpr float farthest = 1e10f;
};

/// @param images of all rigs
inline void carve(carver& c, taken_keypoints_view& v, int capacity, int images, int rigs) {
  carve(c, v.keypoints, capacity, images);
  c.place({images}, v.of_levels);
  c.place({rigs, capacity}, v.right_x, v.depth);
  c.place({rigs}, v.partners);
}

/// Where keypoints are: in staging memory, or, of images with image_features::on_device, where
/// gather_features() has written them.
struct taken_sources {
  taken_keypoints_view staged, gathered;
  image_features const* given;  ///< [images]

  FT_HOST_DEVICE taken_keypoints_view const& of(int image) const {
    return given[image].on_device ? gathered : staged;
  }
};

namespace detail {

/// Item: a keypoint.
struct take_keypoint {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int item, pyramid_geometry const& geometry,
                                 taken_sources const& sources, keypoints_view const& to,
                                 pixels_view const& pixels) const {
    int const image = item / to.capacity;
    taken_keypoints_view const& from = sources.of(image);
    int const i = item % to.capacity;
    int const count = from.keypoints.count[image];
    if (i == 0) { to.count[image] = count; }
    if (i >= count) { return; }
    int const octave = from.keypoints.octave(item);
    float const x = from.keypoints.x(item);
    float const y = from.keypoints.y(item);
    bool const as_given = from.of_levels[image] != 0;
    to.x(item) = as_given ? x : geometry.level_column(x, octave);
    to.y(item) = as_given ? y : geometry.level_row(y, octave);
    auto const pixel = [&](float v) {
      auto const of_level = static_cast<float>(round_away(mul(v, geometry.inv_scale[octave])));
      return mul(of_level, geometry.scale[octave]);
    };
    pixels.x(item) = as_given ? pixel(x) : to.x(item);
    pixels.y(item) = as_given ? pixel(y) : to.y(item);
    to.angle(item) = from.keypoints.angle(item);
    to.response(item) = from.keypoints.response(item);
    to.octave(item) = octave;
    to.orb(item) = from.keypoints.orb(item);
  }
};

/// Item: a keypoint of the image of a rig whose keypoints have partners.
struct take_partner {
  using scratch = no_scratch;

  /// @param step images from one of these to the next
  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int item, pyramid_geometry const& geometry,
                                 taken_sources const& sources, keypoints_view const& all, int step,
                                 float bf, stereo_matches_view const& out) const {
    int const rig = item / all.capacity;
    taken_keypoints_view const& from = sources.of(step * rig);
    int const i = item % all.capacity;
    int const given = from.partners[rig];
    if (given == 0) { return; }
    keypoints_view const keypoints = all.slice(step * rig);
    int const count = *keypoints.count;
    if (i == 0) { out.count[rig] = count; }
    float right = -1, depth = -1;
    if (i < count) {
      place const at{geometry, keypoints.x(i), keypoints.octave(i),
                     from.of_levels[step * rig] != 0};
      if ((given & taken_keypoints_view::has_right) != 0) {
        right = at.right_of(from.right_x[item]);
      }
      if ((given & taken_keypoints_view::has_depth) != 0) { depth = at.depth_of(from.depth[item]); }
      if (given == taken_keypoints_view::has_right) {
        depth = at.depth_at(right, bf);
        if (!(depth < taken_keypoints_view::farthest)) { depth = -1; }
        right = depth > 0 ? right : -1;
      }
      if (given == taken_keypoints_view::has_depth) { right = at.right_at(depth, bf); }
    }
    out.right_x(item) = right;
    out.depth(item) = depth;
    out.score(item) = right >= 0 || depth > 0 ? 0 : -1;
    out.rival(item) = 0;
    out.row_difference(item) = 0;
  }

private:
  /// A keypoint, and how its columns and depths are counted.
  struct place {
    pyramid_geometry const& geometry;
    float x;
    int octave;
    bool of_levels;

    /// The column of a level; -1 if it is no partner's.
    FT_HOST_DEVICE float right_of(float given) const {
      if (!(given >= 0)) { return -1; }
      float const column = of_levels ? given : geometry.level_column(given, octave);
      return column < x ? column : -1;
    }
    FT_HOST_DEVICE float depth_of(float given) const {
      if (!(given > 0 && scalar::is_finite(given))) { return -1; }
      return of_levels ? given : geometry.level_depth(given, octave);
    }
    FT_HOST_DEVICE float depth_at(float right, float bf) const {
      if (right < 0) { return -1; }
      if (of_levels) { return (bf / (strict_float(x) - right)).value; }
      strict_float const disparity =
          strict_float(geometry.column(x, octave)) - geometry.column(right, octave);
      if (!(disparity > strict_float(0.0f))) { return -1; }
      return geometry.level_depth((bf / disparity).value, octave);
    }
    /// Below 0 where a virtual right camera does not see the point.
    FT_HOST_DEVICE float right_at(float depth, float bf) const {
      if (!(depth > 0)) { return -1; }
      if (of_levels) { return (strict_float(x) - bf / depth).value; }
      strict_float const z = geometry.depth(depth, octave);
      return geometry.level_column((geometry.column(x, octave) - bf / z).value, octave);
    }
  };
};

}  // namespace detail

/// Copies a caller's keypoints, positions as those of the octaves' levels. Asynchronous on `exec`;
/// allocates nothing; one launch.
/// @param to same shape
/// @param pixels same shape; gets the positions by which keypoints are sorted into grids: as in
///   extraction those of levels at the pixel of the level, before they were refined
template <typename Exec>
void take_keypoints(Exec const& exec, pyramid_geometry const& geometry, taken_sources const& from,
                    keypoints_view const& to, pixels_view const& pixels) {
  for_each_item<per_thread>(exec, to.batch * to.capacity, detail::take_keypoint{}, geometry, from,
                            to, pixels);
}

/// Writes the partners of rigs that have given ones, and leaves those of others. Asynchronous on
/// `exec`; allocates nothing; one launch.
/// @param keypoints as they are searched; image step * b is that of rig b whose keypoints have
///   partners
/// @param bf baseline times fx, metres * pixels
template <typename Exec>
void take_partners(Exec const& exec, pyramid_geometry const& geometry, taken_sources const& from,
                   keypoints_view const& keypoints, int step, float bf,
                   stereo_matches_view const& out) {
  for_each_item<per_thread>(exec, keypoints.batch / step * keypoints.capacity,
                            detail::take_partner{}, geometry, from, keypoints, step, bf, out);
}

}  // namespace FT_ABI
}  // namespace ft
