// SPDX-License-Identifier: Apache-2.0
/// @file Stage: sorts the rays of keyframes into cells of the image, so that a search along an
/// epipolar line visits those near it.
#pragma once

#include <cstddef>

#include "ft/containers/image_pyramid.hpp"
#include "ft/containers/keyframes.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/atomics.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/group.hpp"
#include "ft/kernels/map/keyframe_input.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {

// Which of a keypoint's matches with several keyframes makes its new point.
//
// Any match along an epipolar line makes a point that both its views agree with, so a wrong one
// looks as good as a right one, and wrong ones with a wide angle are near. Points of right matches
// are the same point. (Consensus of samples: Fischler and Bolles, "Random sample consensus",
// 1981.)

namespace detail {

/// A match with a keyframe, and its point.
struct match_candidate {
  int keyframe = 0;            ///< number; 0 = none
  int keypoint = -1;           ///< of the keyframe
  int distance = 0;            ///< Hamming
  strict_double cosine = 2.0;  ///< of the angle between both rays
  vec3<float> point{0, 0, 0};  ///< in the camera's frame
};

/// Other matches that a point must agree with, where a keypoint is compared with so many keyframes:
/// none with one or two, one with up to five, else two.
FT_HOST_DEVICE constexpr int least_support(int keyframes) {
  return keyframes < 3 ? 0 : keyframes < 6 ? 1 : 2;
}

/// The candidate whose point agrees with most other matches; of equals the one with the widest
/// angle, then the first. Every thread of the group gets it.
/// @param least matches that it agrees with besides its own
/// @param agrees agrees(k, j): whether the point of candidate k is seen where candidate j matched
/// @return its number; -1 = none has that support
template <typename Group, typename Agrees>
FT_HOST_DEVICE int most_supported(Group g, match_candidate const* all, int count, int least,
                                  Agrees const& agrees) {
  int most = -1;
  int own = -1;
  for (int k = g.rank(); k < count; k += g.size()) {
    int support = 0;
    for (int j = 0; j < count; ++j) { support += static_cast<int>(j != k && agrees(k, j)); }
    if (support > most || (support == most && all[k].cosine < all[own].cosine)) {
      most = support;
      own = k;
    }
  }
  int const best = g.reduce(most, max_op{});
  if (best < 0 || best < least) { return -1; }
  double const angle = most == best ? all[own].cosine.value : 2.0;
  double const widest = g.reduce(angle, min_op{});
  return g.reduce(most == best && angle == widest ? own : count, min_op{});
}

}  // namespace detail

/// Inputs of bin_rays.
struct ray_binning {
  keyframe_order const* order = nullptr;  ///< [batch] not none: the newest keyframe is sorted
  keyframes_view keyframes;
  pyramid_geometry geometry;
  float off_line = 0;  ///< distance from an epipolar line at octave 0, share of the focal length
};

namespace detail {

/// Item: a batch entry.
struct bin_newest_rays {
  struct scratch {
    int begin[ray_cells];  ///< counts of the cells, then where their next keypoint goes
  };

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int b, ray_binning const& in,
                                 keyframe_rays_view const& rays) const {
    if (in.order[b] == keyframe_order::none) { return; }
    keyframes_view const& kf = in.keyframes;
    std::ptrdiff_t const row = kf.at(b, kf.position(kf.made[b]));
    std::ptrdiff_t const keypoints = row * kf.numbers();
    int const n = kf.keypoints[row];
    int* const first = rays.first + row * (ray_cells + 1);
    for (int c = g.rank(); c < ray_cells; c += g.size()) { s.begin[c] = 0; }
    g.sync();
    auto const each = [&](auto const& visit) {
      for (int i = g.rank(); i < n; i += g.size()) {
        std::ptrdiff_t const at = keypoints + i;
        if (rays.ray[at].z > 0) { visit(i, cell_of(in.geometry, kf.x[at], kf.y[at])); }
      }
    };
    each([&](int, int c) { atomic_add(s.begin + c, 1); });
    g.sync();
    scan(g, s, first);
    g.sync();
    int* const list = rays.in_cell + keypoints;
    each([&](int i, int c) { list[atomic_add(s.begin + c, 1)] = i; });
    g.sync();
    for (int c = g.rank(); c < ray_cells; c += g.size()) {
      rays.cell[row * ray_cells + c] =
          bounds(in, rays, keypoints, {list + first[c], first[c + 1] - first[c]});
    }
  }

private:
  struct members {
    int const* of;
    int count;
  };

  FT_HOST_DEVICE static int cell_of(pyramid_geometry const& geometry, float x, float y) {
    auto const place = [](float v, int size, int cells) {
      float const at = v * static_cast<float>(cells) / static_cast<float>(size);
      if (!(at > 0)) { return 0; }  // also NaN
      return min_of(static_cast<int>(min_of(at, static_cast<float>(cells))), cells - 1);
    };
    return place(y, geometry.height[0], ray_rows) * ray_columns +
           place(x, geometry.width[0], ray_columns);
  }

  /// From counts to places, in scratch and in the keyframe's row.
  template <typename Group>
  FT_HOST_DEVICE static void scan(Group g, scratch& s, int* first) {
    int before = 0;
    for (int base = 0; base < ray_cells; base += g.size()) {
      int const c = base + g.rank();
      int total = 0;
      int const below = g.exclusive_scan(c < ray_cells ? s.begin[c] : 0, total);
      if (c < ray_cells) { s.begin[c] = first[c] = before + below; }
      before += total;
    }
    if (g.rank() == 0) { first[ray_cells] = before; }
  }

  /// A ball about the rays of a cell, with room for rounding.
  FT_HOST_DEVICE static ray_cell bounds(ray_binning const& in, keyframe_rays_view const& rays,
                                        std::ptrdiff_t keypoints, members const& list) {
    if (list.count == 0) { return {{0, 0, 0}, -1}; }
    vec3<float> low = rays.ray[keypoints + list.of[0]];
    vec3<float> high = low;
    for (int k = 1; k < list.count; ++k) {
      vec3<float> const r = rays.ray[keypoints + list.of[k]];
      low = {min_of(low.x, r.x), min_of(low.y, r.y), min_of(low.z, r.z)};
      high = {max_of(high.x, r.x), max_of(high.y, r.y), max_of(high.z, r.z)};
    }
    ray_cell cell{scaled(low + high, 0.5f), 0};
    for (int k = 0; k < list.count; ++k) {
      std::ptrdiff_t const at = keypoints + list.of[k];
      vec3<float> const d = rays.ray[at] - cell.middle;
      float const off = in.off_line * in.geometry.scale[in.keyframes.octave[at]];
      cell.reach = max_of(cell.reach, scalar::sqrt(dot(d, d)) + off);
    }
    cell.reach = 1.0001f * cell.reach + 1e-5f;
    return cell;
  }
};

}  // namespace detail

/// Sorts the rays of new keyframes into cells, and bounds those of each cell. Asynchronous on
/// `exec`; allocates nothing; one launch.
template <typename Exec>
void bin_rays(Exec const& exec, ray_binning const& in, keyframe_rays_view const& rays) {
  for_each_item<per_block<256>>(exec, in.keyframes.batch, detail::bin_newest_rays{}, in, rays);
}

}  // namespace FT_ABI
}  // namespace ft
