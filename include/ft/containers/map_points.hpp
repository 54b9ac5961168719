// SPDX-License-Identifier: Apache-2.0
/// @file Map points, one array per field, addressed by slot.
#pragma once

#include "ft/containers/keypoints.hpp"
#include "ft/containers/soa.hpp"
#include "ft/core/config.hpp"
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

}  // namespace FT_ABI
}  // namespace ft
