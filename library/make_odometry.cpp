// SPDX-License-Identifier: Apache-2.0
#include <string>

#include "ft/any_odometry.hpp"
#include "library/factories.hpp"

namespace ft {
inline namespace v0 {
namespace {

void require_readouts(rig_description const& rig) {
  constexpr double most = 0.1;
  for (int c = 0; c < rig.cameras; ++c) {
    double const s = rig.camera[c].readout_s;
    if (!(s >= 0 && s <= most)) {
      throw bad_argument("ft: readout_s of camera " + std::to_string(c) + " is " +
                         std::to_string(s) + ", must be in [0, 0.1]");
    }
    if (rig.kind != rig_kind::multi && s != rig.camera[0].readout_s) {
      throw bad_argument("ft: readout_s of the cameras of a " + std::string(name_of(rig.kind)) +
                         " are " + std::to_string(rig.camera[0].readout_s) + " and " +
                         std::to_string(s) + ", must be equal");
    }
  }
}

void require_cameras(rig_description const& rig) {
  bool const pair = rig.kind == rig_kind::distorted_pair || rig.kind == rig_kind::fisheye_pair;
  int const least = pair ? 2 : 1;
  int const most = rig.kind == rig_kind::multi ? most_cameras : least;
  if (rig.cameras < least || rig.cameras > most) {
    throw bad_argument(std::string("ft: a ") + name_of(rig.kind) + " rig has " +
                       std::to_string(rig.cameras) + " cameras, must have " +
                       std::to_string(least) +
                       (most > least ? " to " + std::to_string(most) : std::string()));
  }
  for (int c = 0; c < rig.cameras && rig.kind == rig_kind::multi; ++c) {
    int const right = rig.camera[c].right;
    if (right < -1 || right >= rig.cameras) {
      throw bad_argument("ft: the right camera of camera " + std::to_string(c) + " is " +
                         std::to_string(right) + ", must be below " + std::to_string(rig.cameras) +
                         ", or -1 for none");
    }
  }
}

/// Whether a multi rig has other cameras than pinholes and rectified pairs of them.
bool is_mixed(rig_description const& rig) {
  bool mixed = false;
  for (int c = 0; c < rig.cameras && c < most_cameras; ++c) {
    camera_description const& camera = rig.camera[c];
    mixed =
        mixed || camera.kind != camera_kind::pinhole || camera.right >= 0 || camera.has_depth_image;
  }
  return mixed;
}

using factory = any_odometry(library::odometry_request const&);

#if FT_LIBRARY_HAS_CUDA
#define FT_LIBRARY_CHOOSE_IN(of, name) (gpu ? library::cuda##of::name : library::host##of::name)
#else
#define FT_LIBRARY_CHOOSE_IN(of, name) (library::host##of::name)
#endif
#define FT_LIBRARY_CHOOSE(name) FT_LIBRARY_CHOOSE_IN(, name)

factory& factory_of(descriptor_kind kind, [[maybe_unused]] bool gpu) {
#if FT_LIBRARY_HAS_DESCRIPTORS
  if (kind == descriptor_kind::bits_512) {
    return *FT_LIBRARY_CHOOSE_IN(_ft_bits_512, make_described);
  }
  if (kind == descriptor_kind::int8_128) {
    return *FT_LIBRARY_CHOOSE_IN(_ft_int8_128, make_described);
  }
#endif
  throw bad_argument("ft: descriptors are " + std::to_string(static_cast<int>(kind)) +
                     ", which ft::odometry was built without");
}

factory& factory_of(rig_description const& rig, [[maybe_unused]] bool gpu) {
  switch (rig.kind) {
    case rig_kind::rectified_pair:
    case rig_kind::distorted_pair:
    case rig_kind::rgbd:
      return *FT_LIBRARY_CHOOSE(make_rectified);
    case rig_kind::fisheye_pair:
      return *FT_LIBRARY_CHOOSE(make_fisheye);
    case rig_kind::monocular:
      return *FT_LIBRARY_CHOOSE(make_monocular);
    case rig_kind::multi:
      if (is_mixed(rig)) { return *FT_LIBRARY_CHOOSE(make_mixed); }
      return *FT_LIBRARY_CHOOSE(make_multi);
  }
  throw bad_argument("ft: rig_description::kind is " + std::to_string(static_cast<int>(rig.kind)) +
                     ", must be in [0, " + std::to_string(static_cast<int>(rig_kind::multi)) + "]");
}

}  // namespace

any_odometry make_odometry(device const& where, rig_description const& rig,
                           odometry_params const& params, int batch, place_options const& places,
                           descriptor_kind descriptors) {
  if (where.gpu < device::current_gpu) {
    throw bad_argument("ft: gpu is " + std::to_string(where.gpu) +
                       ", must be the number of a GPU, -1 for the host, or -2 for the current GPU");
  }
  bool const gpu = where.gpu != device::host;
#if !FT_LIBRARY_HAS_CUDA
  if (gpu) {
    throw bad_argument("ft: gpu is " + std::to_string(where.gpu) +
                       ", but ft::odometry was built without CUDA: it has the host, gpu -1");
  }
#endif
  factory& of_rig = factory_of(rig, gpu);  // refuses what is none
  factory& make = descriptors == descriptor_kind::orb ? of_rig : factory_of(descriptors, gpu);
  require_cameras(rig);
  require_readouts(rig);
  return make({where, rig, params, batch, places});
}

#if !FT_LIBRARY_HAS_CUDA
std::vector<std::string> gpu_names() { return {}; }
#endif

}  // namespace v0
}  // namespace ft
