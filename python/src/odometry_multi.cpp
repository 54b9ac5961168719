// SPDX-License-Identifier: Apache-2.0
#include "ft/cameras/multi_rig.hpp"
#include "python/src/odometry_of.hpp"

namespace ftpy::FTPY_DEVICE {
namespace {

/// @tparam N at least as many as there are; the others are not used
template <int N>
std::unique_ptr<odometry> make(odometry_options const& o) {
  ft::multi_rig<N> rig{};
  for (ft::rig_camera& c : rig.of) { c = ft::rig_camera::none(); }
  for (std::size_t i = 0; i < o.of.cameras.size(); ++i) {
    rig_camera const& given = o.of.cameras[i];
    rig.of[i] = {camera_of<ft::pinhole<float>>(given.camera, "rig's"), given.baseline,
                 to_ft(given.T_camera_body).cast<float>()};
  }
  return std::make_unique<odometry_of<ft::multi_rig<N>>>(rig, o);
}

}  // namespace

std::unique_ptr<odometry> make_multi_odometry(odometry_options const& o) {
  return translated([&]() -> std::unique_ptr<odometry> {
    std::size_t const n = o.of.cameras.size();
    if (n < 1 || n > 16) {
      throw argument_error("the rig has " + std::to_string(n) + " cameras, must have 1 to 16");
    }
    // Two sizes for all numbers: each one takes the compiler a minute.
    return n <= 4 ? make<4>(o) : make<16>(o);
  });
}

}  // namespace ftpy::FTPY_DEVICE
