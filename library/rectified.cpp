// SPDX-License-Identifier: Apache-2.0
// Rigs whose keypoints are searched as those of a rectified pair: one unit, for they share most of
// what the compiler makes of an odometry.
#include "library/made.hpp"
#include "library/rigs.hpp"

namespace ft::library::FT_LIBRARY_DEVICE {

FT_LIBRARY_FACTORY any_odometry make_rectified(odometry_request const& of) {
  rig_description const& rig = of.rig;
  switch (rig.kind) {
    case rig_kind::rectified_pair:
      return made(of, rectified_pair_of(rig));
    case rig_kind::distorted_pair:
      return made(of, distorted_pair_of(rig));
    default:
      break;
  }
  if (rig.camera[0].kind == camera_kind::pinhole) {
    return made(of, rgbd_of(rig, pinhole_of(rig, 0)));
  }
  return made(of, rgbd_of(rig, camera_of<radtan8<float>>(rig, 0, camera_kind::radtan8,
                                                         "rgbd of pinhole or radtan8")));
}

}  // namespace ft::library::FT_LIBRARY_DEVICE
