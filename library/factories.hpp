// SPDX-License-Identifier: Apache-2.0
/// @file What the units of the library make: those of the C++ compiler in `host`, those of nvcc in
/// `cuda`.
#pragma once

#include "ft/any_odometry.hpp"

#if defined(__CUDACC__)
#define FT_LIBRARY_DEVICE cuda
#else
#define FT_LIBRARY_DEVICE host
#endif

namespace ft::library {

#define FT_LIBRARY_FACTORIES(where)                                                                \
  namespace where {                                                                                \
  any_odometry make_rectified(device const&, rig_description const&, odometry_params const&, int); \
  any_odometry make_fisheye(device const&, rig_description const&, odometry_params const&, int);   \
  any_odometry make_monocular(device const&, rig_description const&, odometry_params const&, int); \
  any_odometry make_multi(device const&, rig_description const&, odometry_params const&, int);     \
  }
FT_LIBRARY_FACTORIES(host)
FT_LIBRARY_FACTORIES(cuda)
#undef FT_LIBRARY_FACTORIES

}  // namespace ft::library
