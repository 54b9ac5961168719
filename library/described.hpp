// SPDX-License-Identifier: Apache-2.0
/// @file What a unit with FT_DESCRIPTOR makes: rigs whose keypoints a caller may give.
#pragma once

#include <string>

#include "library/made.hpp"
#include "library/rigs.hpp"

namespace ft::library::FT_LIBRARY_DEVICE {

FT_LIBRARY_FACTORY any_odometry make_described(odometry_request const& of) {
  rig_description const& rig = of.rig;
  if (rig.kind == rig_kind::rectified_pair) { return made_of_features(of, rectified_pair_of(rig)); }
  if (rig.kind == rig_kind::rgbd) { return made_of_features(of, rgbd_of(rig, pinhole_of(rig, 0))); }
  throw bad_argument(std::string("ft: the rig is ") + name_of(rig.kind) +
                     "; with other descriptors than ORB's ft::odometry was compiled for rectified "
                     "pairs and rgbd of pinhole. A unit of your own with FT_DESCRIPTOR takes any "
                     "rig");
}

}  // namespace ft::library::FT_LIBRARY_DEVICE
