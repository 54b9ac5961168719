// SPDX-License-Identifier: Apache-2.0
#include "ft/cameras/monocular_rig.hpp"
#include "python/src/odometry_of.hpp"

namespace ftpy::FTPY_DEVICE {

std::unique_ptr<odometry> make_monocular_odometry(odometry_options const& o) {
  return translated([&]() -> std::unique_ptr<odometry> {
    auto const with = [&](auto const& camera) -> std::unique_ptr<odometry> {
      using rig_type = ft::monocular_rig<std::decay_t<decltype(camera)>>;
      return std::make_unique<odometry_of<rig_type>>(rig_type::make(camera), o);
    };
    if (o.of.kind == "monocular_fisheye") {
      return with(camera_of<ft::kannala_brandt<float>>(o.of.left, "fisheye"));
    }
    return with(camera_of<ft::pinhole<float>>(o.of.left, "pinhole"));
  });
}

}  // namespace ftpy::FTPY_DEVICE
