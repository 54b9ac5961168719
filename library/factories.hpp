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

/// The arguments of make_odometry().
struct odometry_request {
  device const& where;
  rig_description const& rig;
  odometry_params const& params;
  int batch;
  place_options const& places;
};

#define FT_LIBRARY_FACTORIES(where)                     \
  namespace where {                                     \
  any_odometry make_rectified(odometry_request const&); \
  any_odometry make_fisheye(odometry_request const&);   \
  any_odometry make_monocular(odometry_request const&); \
  any_odometry make_multi(odometry_request const&);     \
  any_odometry make_mixed(odometry_request const&);     \
  }
FT_LIBRARY_FACTORIES(host)
FT_LIBRARY_FACTORIES(cuda)
#undef FT_LIBRARY_FACTORIES

}  // namespace ft::library
