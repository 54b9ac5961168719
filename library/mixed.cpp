// SPDX-License-Identifier: Apache-2.0
#include "library/made.hpp"
#include "library/rigs.hpp"

namespace ft::library::FT_LIBRARY_DEVICE {

FT_LIBRARY_FACTORY any_odometry make_mixed(odometry_request const& of) {
  return made(of, mixed_of<most_cameras>(of.rig));
}

}  // namespace ft::library::FT_LIBRARY_DEVICE
