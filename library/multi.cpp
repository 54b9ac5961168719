// SPDX-License-Identifier: Apache-2.0
#include "library/made.hpp"
#include "library/rigs.hpp"

namespace ft::library::FT_LIBRARY_DEVICE {

FT_LIBRARY_FACTORY any_odometry make_multi(odometry_request const& of) {
  rig_description const& rig = of.rig;
  // Two sizes for all numbers: each one takes the compiler a minute.
  if (rig.cameras <= 4) { return made(of, multi_of<4>(rig)); }
  return made(of, multi_of<most_cameras>(rig));
}

}  // namespace ft::library::FT_LIBRARY_DEVICE
