// SPDX-License-Identifier: Apache-2.0
#include "library/made.hpp"
#include "library/rigs.hpp"

namespace ft::library::FT_LIBRARY_DEVICE {

any_odometry make_multi(device const& where, rig_description const& rig,
                        odometry_params const& params, int batch) {
  // Two sizes for all numbers: each one takes the compiler a minute.
  if (rig.cameras <= 4) { return made(where, multi_of<4>(rig), params, batch); }
  return made(where, multi_of<most_cameras>(rig), params, batch);
}

}  // namespace ft::library::FT_LIBRARY_DEVICE
