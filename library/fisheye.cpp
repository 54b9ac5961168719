// SPDX-License-Identifier: Apache-2.0
#include "library/made.hpp"
#include "library/rigs.hpp"

namespace ft::library::FT_LIBRARY_DEVICE {

any_odometry make_fisheye(device const& where, rig_description const& rig,
                          odometry_params const& params, int batch) {
  return made(where, fisheye_pair_of(rig), params, batch);
}

}  // namespace ft::library::FT_LIBRARY_DEVICE
