// SPDX-License-Identifier: Apache-2.0
/// @file Stereo matches: per left keypoint the right column and the depth.
#pragma once

#include "ft/containers/soa.hpp"
#include "ft/core/config.hpp"
#include "ft/core/memory.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {

namespace field {
FT_FIELD(right_x, float);  ///< column in the right image, pixels; -1 = no match
FT_FIELD(depth, float);    ///< metres along the left camera's axis; -1 = no match
FT_FIELD(score, int);      ///< sum of absolute differences of the refinement; -1 = no match
/// 1 = another right keypoint, elsewhere on the rows, is as near. Written where right keypoints are
/// compared by rows; of those without a match it means nothing.
FT_FIELD(rival, int);
/// The row of the right keypoint less that of the left one, pixels; written, and meant, likewise.
FT_FIELD(row_difference, float);
}  // namespace field

using stereo_matches_view =
    soa_view<field::right_x, field::depth, field::score, field::rival, field::row_difference>;
template <memory_space Space>
using stereo_matches =
    soa<Space, field::right_x, field::depth, field::score, field::rival, field::row_difference>;

/// What rows say of matches, [pairs][capacity]. Null of pairs that are not rectified.
struct row_facts {
  int const* rival = nullptr;             ///< field::rival
  float const* row_difference = nullptr;  ///< field::row_difference
};

// Stereo partners and points of two cameras without rectification.

/// Stereo partners and points of a batch of pairs. Left keypoint k has the number k, right keypoint
/// k the number capacity + k.
struct fisheye_matches_view {
  int* partner = nullptr;        ///< [batch][2 * capacity] number of the partner, -1 = none
  float* depth = nullptr;        ///< [batch][capacity] of left keypoints, metres, -1 = none
  vec3<float>* point = nullptr;  ///< [batch][capacity] in the left camera's frame, 0 = none
  int capacity = 0;
  int batch = 0;
};

/// Places the arrays into an arena.
inline void carve(carver& c, fisheye_matches_view& v, int capacity, int batch) {
  v.capacity = capacity;
  v.batch = batch;
  c.place({batch, 2, capacity}, v.partner);
  c.place({batch, capacity}, v.depth, v.point);
}

}  // namespace FT_ABI
}  // namespace ft
