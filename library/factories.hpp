// SPDX-License-Identifier: Apache-2.0
/// @file What the units of the library make: those of the C++ compiler in `host`, those of nvcc in
/// `cuda`; of another descriptor with its name.
#pragma once

#include "ft/any_odometry.hpp"
#include "ft/core/config.hpp"

#if defined(FT_DESCRIPTOR)
#define FT_LIBRARY_DEVICE FT_JOINED(FT_BACKEND, _, FT_DESCRIPTOR)
#else
#define FT_LIBRARY_DEVICE FT_BACKEND
#endif

// A unit with FT_STAGES_ALONE has the stages that a factory needs, not the factory.
#if defined(FT_STAGES_ALONE)
#define FT_LIBRARY_FACTORY inline
#else
#define FT_LIBRARY_FACTORY
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

// The units with FT_DESCRIPTOR.
#define FT_LIBRARY_DESCRIBED(where)                     \
  namespace where {                                     \
  any_odometry make_described(odometry_request const&); \
  }
FT_LIBRARY_DESCRIBED(host_ft_bits_512)
FT_LIBRARY_DESCRIBED(cuda_ft_bits_512)
FT_LIBRARY_DESCRIBED(host_ft_int8_128)
FT_LIBRARY_DESCRIBED(cuda_ft_int8_128)
#undef FT_LIBRARY_DESCRIBED

}  // namespace ft::library
