// SPDX-License-Identifier: Apache-2.0
/// @file Stereo matches: per left keypoint the right column and the depth.
#pragma once

#include "ft/containers/soa.hpp"
#include "ft/core/config.hpp"

namespace ft {
inline namespace FT_ABI {
namespace field {
FT_FIELD(right_x, float);  ///< column in the right image, pixels; -1 = no match
FT_FIELD(depth, float);    ///< metres along the left camera's axis; -1 = no match
FT_FIELD(score, int);      ///< sum of absolute differences of the refinement; -1 = no match
}  // namespace field

using stereo_matches_view = soa_view<field::right_x, field::depth, field::score>;
template <memory_space Space>
using stereo_matches = soa<Space, field::right_x, field::depth, field::score>;

}  // namespace FT_ABI
}  // namespace ft
