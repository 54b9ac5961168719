// SPDX-License-Identifier: Apache-2.0
/// @file Rigs, poses and undistortion of ft from the plain types of the shim.
#pragma once

#include <type_traits>
#include <utility>

#include "ft/cameras/image_domain.hpp"
#include "ft/cameras/kannala_brandt.hpp"
#include "ft/cameras/stereo_rig.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/pipelines/relocalizer.hpp"
#include "ft/types/poses.hpp"
#include "integration/orbslam3/plain_types.hpp"

namespace ft::orbslam3 {
inline namespace FT_ABI {

using fisheye_rig = stereo_rig<kannala_brandt<float>, kannala_brandt<float>>;

/// Cameras of a pair whose keypoints are searched: of a rectified pair only the left one.
template <typename Rig>
inline constexpr int searched_cameras = Rig::rectified ? 1 : 2;

/// The camera that relocalisation finds points with.
template <typename Rig>
using left_camera_of = std::decay_t<decltype(detail::left_camera(std::declval<Rig const&>()))>;

/// The cameras of the settings. A single kannala_brandt camera becomes a pair without baseline
/// whose right camera has no keypoints.
/// @throws bad_argument
template <typename Rig>
Rig rig_of(settings const& s) {
  float const* const l = s.left.values;
  if constexpr (Rig::rectified) {
    // As rectified_rig::from_bf(), but 0 is allowed, for a monocular camera.
    rectified_rig const rig{{l[0], l[1], l[2], l[3]},
                            static_cast<double>(s.bf) / static_cast<double>(l[0])};
    rig.camera.check();
    if (s.images == 2 || s.bf != 0) { rig.check(); }
    return rig;
  } else {
    float const* const r = s.images == 2 ? s.right.values : l;
    fisheye_rig rig{{l[0], l[1], l[2], l[3], l[4], l[5], l[6], l[7]},
                    {r[0], r[1], r[2], r[3], r[4], r[5], r[6], r[7]},
                    s.T_rl};
    if (s.images == 1) { rig.T_rl = {mat3<float>::identity(), {-1e-6f, 0.0f, 0.0f}}; }
    rig.check();
    require_invertible(rig.left, s.width, s.height, 0.25);
    require_invertible(rig.right, s.width, s.height, 0.25);
    return rig;
  }
}

/// @throws bad_argument naming the setting
template <typename Rig>
settings const& checked(settings const& s) {
  detail::require_range("images", s.images, 1, 2);
  detail::require_range("most_keypoints", s.most_keypoints, 0, 1 << 20);
  detail::require_range("map_points", s.map_points, 1, 1 << 26);
  detail::require_range("local_points", s.local_points, 1, 1 << 24);
  detail::require(s.left.kind == s.right.kind || s.images == 1 || Rig::rectified,
                  "both cameras of a pair are of one kind");
  return s;
}

}  // namespace FT_ABI
}  // namespace ft::orbslam3
