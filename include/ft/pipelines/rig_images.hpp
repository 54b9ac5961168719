// SPDX-License-Identifier: Apache-2.0
/// @file The images of a frame of an odometry, by the kind of its rig.
#pragma once

#include "ft/core/config.hpp"
#include "ft/core/views.hpp"
#include "ft/kernels/images/depth_association.hpp"

namespace ft {
inline namespace FT_ABI {

/// The images of one camera pair: grey, of the size that the odometry was made for, or of the raw
/// images of a distorted_pair. They are read
/// in place if the executor's threads can read them and if address and stride are multiples of 16,
/// and copied otherwise.
struct stereo_images {
  gray_view left;
  gray_view right;

  gray_view const& operator[](int i) const { return i == 0 ? left : right; }
};
/// The same of a multi_rig: image 2 c is that of camera c, image 2 c + 1 the right one of its pair,
/// not read for a single camera.
template <int N>
struct rig_images {
  gray_view of[N];

  gray_view const& operator[](int i) const { return of[i]; }
};

/// The images of an rgbd_rig. Both have the size that the odometry was made for. The depth image is
/// registered to the grey one: its pixels are depths along the axis of the same camera, in units of
/// rgbd_rig::depth_scale. A pixel that is 0, negative, infinite or NaN has no depth. The executor
/// reads it in place if it can.
struct rgbd_images {
  gray_view gray;
  depth_view depth;
};

}  // namespace FT_ABI
}  // namespace ft
