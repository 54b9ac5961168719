// SPDX-License-Identifier: Apache-2.0
#include "ft/cameras/rgbd_rig.hpp"
#include "python/src/odometry_of.hpp"

namespace ftpy::FTPY_DEVICE {

std::unique_ptr<odometry> make_rgbd_odometry(odometry_options const& o) {
  return translated([&]() -> std::unique_ptr<odometry> {
    auto const with = [&](auto const& camera) -> std::unique_ptr<odometry> {
      using rig_type = ft::rgbd_rig<std::decay_t<decltype(camera)>>;
      return std::make_unique<odometry_of<rig_type>>(
          rig_type::make(camera, o.of.baseline, narrow(o.of.depth_scale)), o);
    };
    if (o.of.left.size() == 4) { return with(camera_of<ft::pinhole<float>>(o.of.left, "depth")); }
    return with(camera_of<ft::radtan8<float>>(o.of.left, "depth"));
  });
}

}  // namespace ftpy::FTPY_DEVICE
