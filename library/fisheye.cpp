// SPDX-License-Identifier: Apache-2.0
#include "library/made.hpp"
#include "library/rigs.hpp"

namespace ft::library::FT_LIBRARY_DEVICE {

FT_LIBRARY_FACTORY any_odometry make_fisheye(odometry_request const& of) {
  return made(of, fisheye_pair_of(of.rig));
}

}  // namespace ft::library::FT_LIBRARY_DEVICE
