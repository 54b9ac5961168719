// SPDX-License-Identifier: Apache-2.0
/// @file Map points, one array per field, addressed by slot.
#pragma once

#include "ft/containers/keypoints.hpp"
#include "ft/containers/soa.hpp"
#include "ft/core/config.hpp"
#include "ft/core/memory.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {

namespace field {
FT_FIELD(position, vec3<float>);  ///< world frame, metres
FT_FIELD(normal,
         vec3<float>);  ///< mean viewing direction, unit length, from the cameras to the point
FT_FIELD(min_distance, float);  ///< raw, metres; searches accept points from 0.8 times this
FT_FIELD(max_distance, float);  ///< raw, metres; searches accept points up to 1.2 times this
FT_FIELD(observations, int);    ///< number of observations; a point without any does not exclude
                                ///< others from its keypoint
}  // namespace field

using map_points_view = soa_view<field::position, field::normal, field::min_distance,
                                 field::max_distance, field::orb, field::observations>;
template <memory_space Space>
using map_points = soa<Space, field::position, field::normal, field::min_distance,
                       field::max_distance, field::orb, field::observations>;

// Map points seen at keypoints: the input of pose optimisation.

/// A map point seen at a keypoint. Aligned, so that a GPU loads it in two pieces.
struct alignas(16) observation {
  vec3<float> point;  ///< world frame, metres
  float u, v;         ///< pixels
  float right_u;      ///< column in the right image of a rectified pair; negative = none
  float inv_sigma2;   ///< weight, 1 / pixels^2
  int camera;         ///< number in the rig; 1 = the right one of a fisheye pair
};

/// The observations of a batch of frames: every keypoint that holds a map point, in the order of
/// keypoint numbers.
struct observations_view {
  observation* items = nullptr;      ///< [batch][capacity]
  int* number = nullptr;             ///< [batch][capacity] keypoint number of an observation
  unsigned char* outlier = nullptr;  ///< [batch][capacity] 1 = outlier
  int* count = nullptr;              ///< [batch]
  int* inliers = nullptr;            ///< [batch]
  int capacity = 0;
};

inline void carve(carver& c, observations_view& v, int capacity, int batch) {
  v.capacity = capacity;
  c.place({batch, capacity}, v.items, v.number, v.outlier);
  c.place({batch}, v.count, v.inliers);
}

}  // namespace FT_ABI
}  // namespace ft
